using System.Collections.Generic;
using System.Linq;
using Armcell.Logic;
using UnityEngine;

namespace Armcell
{
    /// <summary>A robot as a tree of ArticulationBodies, from a flattened URDF.</summary>
    public class RobotBuilder
    {
        readonly Urdf m_Urdf;
        readonly CellFile m_Cell;
        readonly ShapeBuilder m_Shapes;
        readonly List<JointMap.MappedJoint> m_Joints = new List<JointMap.MappedJoint>();

        public readonly Dictionary<string, GameObject> Links = new Dictionary<string, GameObject>();

        public JointMap.MappedJoint[] Joints
        {
            get { return m_Joints.ToArray(); }
        }

        public RobotBuilder(Urdf urdf, CellFile cell, ShapeBuilder shapes)
        {
            m_Urdf = urdf;
            m_Cell = cell;
            m_Shapes = shapes;
        }

        /// <summary>Build all links below a parent. The root link stands fast.</summary>
        public GameObject Build(Transform parent)
        {
            GameObject root = AddLink(m_Urdf.Root, parent);
            root.GetComponent<ArticulationBody>().immovable = true;
            return root;
        }

        GameObject AddLink(UrdfLink link, Transform parent)
        {
            GameObject made = new GameObject(link.name);
            made.transform.SetParent(parent, false);
            Links.Add(link.name, made);
            foreach (UrdfGeometry visual in link.visuals) m_Shapes.AddVisual(made.transform, visual);
            foreach (UrdfGeometry collision in link.collisions) m_Shapes.AddCollider(made.transform, collision);
            UrdfJoint joint = m_Urdf.joints.FirstOrDefault(j => j.child == link.name);
            if (joint != null) Ros.Place(made.transform, joint.origin);
            ArticulationBody body = made.AddComponent<ArticulationBody>();
            body.mass = (float)link.mass;
            body.useGravity = false; // arms take off their own weight
            AddInertia(made, link);
            if (joint != null) SetJoint(body, joint);
            foreach (UrdfJoint below in m_Urdf.joints.Where(j => j.parent == link.name))
                AddLink(m_Urdf.links[below.child], made.transform);
            return made;
        }

        static void AddInertia(GameObject made, UrdfLink link)
        {
            LinkInertia inertia = made.AddComponent<LinkInertia>();
            inertia.centerOfMass = Ros.ToVector3(Axes.ToUnity(link.centre.position));
            inertia.axes = Ros.ToQuaternion(Axes.ToUnity(link.centre.rotation));
            inertia.moments = Ros.ToVector3(Axes.SizeToUnity(link.moments));
        }

        void SetJoint(ArticulationBody body, UrdfJoint joint)
        {
            if (!joint.IsMovable)
            {
                body.jointType = ArticulationJointType.FixedJoint;
                return;
            }
            JointSpec spec = joint.Spec();
            bool slides = spec.kind == JointKind.Prismatic, free = double.IsInfinity(spec.upper - spec.lower);
            body.jointType = slides ? ArticulationJointType.PrismaticJoint : ArticulationJointType.RevoluteJoint;
            // The drive's axis is the anchor's x. Turning is the other way round in left-handed axes.
            Vector3 axis = Ros.ToVector3(Axes.ToUnity(joint.axis));
            body.anchorPosition = Vector3.zero;
            body.anchorRotation = Quaternion.FromToRotation(Vector3.right, slides ? axis : -axis);
            ArticulationDofLock motion = free ? ArticulationDofLock.FreeMotion : ArticulationDofLock.LimitedMotion;
            if (slides)
            {
                body.linearLockX = motion;
                body.linearLockY = ArticulationDofLock.LockedMotion;
                body.linearLockZ = ArticulationDofLock.LockedMotion;
            }
            else body.twistLock = motion;
            body.jointFriction = 0f; // URDF's is a torque, PhysX's a share of the load
            body.linearDamping = 0f;
            body.angularDamping = 0f;
            DriveData gains = m_Cell.drives[joint.name];
            ArticulationDrive drive = body.xDrive;
            drive.stiffness = (float)gains.stiffness;
            drive.damping = (float)gains.damping;
            drive.forceLimit = double.IsInfinity(gains.forceLimit) ? float.MaxValue : (float)gains.forceLimit;
            if (!free)
            {
                drive.lowerLimit = (float)spec.ToDrive(spec.lower);
                drive.upperLimit = (float)spec.ToDrive(spec.upper);
            }
            double start;
            m_Cell.start.TryGetValue(joint.name, out start);
            spec.start = start;
            spec.finger = m_Cell.grippers.Any(g => g.joint == joint.name || g.joint == joint.mimic);
            drive.target = (float)spec.ToDrive(start);
            body.xDrive = drive;
            m_Joints.Add(new JointMap.MappedJoint { spec = spec, body = body });
        }
    }
}
