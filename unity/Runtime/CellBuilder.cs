using System.Collections.Generic;
using System.IO;
using System.Linq;
using Armcell.Logic;
using UnityEngine;

namespace Armcell
{
    /// <summary>Builds what `armcell export unity` wrote as GameObjects, with everything that joins them to armcell.</summary>
    public class CellBuilder
    {
        readonly CellFile m_Cell;
        readonly ShapeBuilder m_Shapes;
        readonly GameObject m_Root;
        RobotBuilder m_Robot;

        CellBuilder(CellFile cell, string folder, IKeepAssets keep)
        {
            m_Cell = cell;
            m_Shapes = new ShapeBuilder(folder, keep);
            m_Root = new GameObject(cell.name);
        }

        /// <summary>Build a cell at the origin of the open scene.</summary>
        /// <param name="file">scene.json, with the URDF and meshes beside it</param>
        /// <param name="keep">keeps meshes and materials as assets; null: they live in memory</param>
        /// <returns>the cell's root: its frame is ROS's world</returns>
        public static GameObject Build(string file, IKeepAssets keep = null)
        {
            CellFile cell = CellFile.Read(File.ReadAllText(file));
            string folder = Path.GetDirectoryName(Path.GetFullPath(file));
            CellBuilder builder = new CellBuilder(cell, folder, keep);
            Urdf urdf = Urdf.Read(File.ReadAllText(Path.Combine(folder, cell.urdf)));
            builder.AddPhysics();
            builder.AddRobot(urdf);
            foreach (ObjectData item in cell.objects) builder.AddObject(item);
            return builder.m_Root;
        }

        void AddPhysics()
        {
            PhysicsSetup physics = m_Root.AddComponent<PhysicsSetup>();
            physics.fixedTimestep = (float)m_Cell.fixedTimestep;
            physics.solverIterations = m_Cell.solverIterations;
            physics.solverVelocityIterations = m_Cell.solverVelocityIterations;
            physics.gravity = Ros.ToVector3(Axes.ToUnity(m_Cell.gravity));
            m_Root.AddComponent<ClockPublisher>();
        }

        void AddRobot(Urdf urdf)
        {
            m_Robot = new RobotBuilder(urdf, m_Cell, m_Shapes);
            m_Robot.Build(m_Root.transform);
            JointMap map = m_Root.AddComponent<JointMap>();
            map.joints = m_Robot.Joints;
            JointStatePublisher states = m_Root.AddComponent<JointStatePublisher>();
            states.map = map;
            states.rate = m_Cell.rate;
            TrajectoryExecutor executor = m_Root.AddComponent<TrajectoryExecutor>();
            executor.map = map;
            executor.settings = m_Cell.execution;
            executor.grippers = m_Cell.grippers.Select(g => AddGripper(g, map)).ToArray();
            MayTouch may = m_Root.AddComponent<MayTouch>();
            may.pairs = m_Cell.mayTouch.Where(p => p.All(m_Robot.Links.ContainsKey))
                .Select(p => new MayTouch.Pair { a = m_Robot.Links[p[0]], b = m_Robot.Links[p[1]] }).ToArray();
            foreach (GameObject link in m_Robot.Links.Values) link.AddComponent<ContactPublisher>().world = m_Root.transform;
        }

        GripperController AddGripper(GripperData data, JointMap map)
        {
            GripperController gripper = m_Root.AddComponent<GripperController>();
            gripper.map = map;
            gripper.joint = data.joint;
            gripper.topic = data.topic;
            if (m_Cell.grippers.Count > 1) gripper.statusTopic = "/" + data.name + gripper.statusTopic;
            gripper.settings = data.settings;
            gripper.tcp = m_Robot.Links[data.tcpLink].transform;
            gripper.hand = m_Robot.Links[data.tcpLink].GetComponent<ArticulationBody>();
            gripper.fingers = data.fingerLinks.Select(n => m_Robot.Links[n]).ToArray();
            return gripper;
        }

        void AddObject(ObjectData item)
        {
            GameObject made = new GameObject(item.name);
            made.transform.SetParent(m_Root.transform, false);
            Ros.Place(made.transform, item.pose);
            foreach (ShapeData shape in item.shapes)
                m_Shapes.Add(made.transform, shape, item);
            if (!item.movable) return;
            Rigidbody body = made.AddComponent<Rigidbody>();
            body.mass = (float)item.mass;
            body.collisionDetectionMode = CollisionDetectionMode.ContinuousSpeculative;
            ObjectPosePublisher pose = made.AddComponent<ObjectPosePublisher>();
            pose.world = m_Root.transform;
            pose.topic = item.topic;
            pose.rate = m_Cell.rate;
            made.AddComponent<ContactPublisher>().world = m_Root.transform;
        }
    }
}
