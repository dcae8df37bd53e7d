using System.Collections.Generic;
using System.Linq;
using Armcell.Logic;
using RosMessageTypes.Std;
using RosMessageTypes.Trajectory;
using Unity.Robotics.ROSTCPConnector;
using UnityEngine;

namespace Armcell
{
    /// <summary>
    /// Plays trajectories in the simulation's time. What it does with them, and the words it says about them,
    /// are armcell's own (see Logic/Executor.cs).
    /// </summary>
    [DefaultExecutionOrder(-100)]
    [AddComponentMenu("armcell/Trajectory Executor")]
    public class TrajectoryExecutor : MonoBehaviour
    {
        public JointMap map;
        [Tooltip("Move finger joints, where a trajectory names nothing else.")] public GripperController[] grippers =
            new GripperController[0];
        public string topic = "/planned_trajectory";
        public string statusTopic = "/trajectory_status";
        public ExecutionSettings settings = new ExecutionSettings();

        ROSConnection m_Ros;
        Executor m_Executor;

        public bool IsMoving
        {
            get { return m_Executor != null && m_Executor.IsMoving; }
        }

        void Start()
        {
            m_Ros = ROSConnection.GetOrCreateInstance();
            m_Ros.RegisterPublisher<StringMsg>(statusTopic, 10, true);
            m_Executor = new Executor(map.Table, map, settings, Say);
            m_Executor.Fingers = MoveFinger;
            m_Ros.Subscribe<JointTrajectoryMsg>(topic, Take);
        }

        void FixedUpdate()
        {
            m_Executor.Step(Time.fixedTimeAsDouble, Time.fixedDeltaTime);
        }

        /// <summary>Play a trajectory from the next step on, as if it had come over the wire.</summary>
        public void Take(JointTrajectoryMsg message)
        {
            m_Executor.Take(Points(message));
        }

        /// <summary>Stop all joints where they are.</summary>
        public void Stop()
        {
            m_Executor.Stop(Time.fixedTimeAsDouble);
        }

        public static TrajectoryPoints Points(JointTrajectoryMsg message)
        {
            TrajectoryPoints points = new TrajectoryPoints();
            points.names = message.joint_names;
            points.times = message.points.Select(p => Ros.Seconds(p.time_from_start)).ToArray();
            points.positions = message.points.Select(p => p.positions).ToArray();
            points.velocities = message.points.Select(p => p.velocities).ToArray();
            points.accelerations = message.points.Select(p => p.accelerations).ToArray();
            return points;
        }

        void MoveFinger(string joint, double q, System.Action<string> ended)
        {
            GripperController gripper = grippers.FirstOrDefault(g => g.joint == joint);
            if (gripper != null) gripper.MoveJoint(q, ended);
            else ended("failed: no GripperController moves " + joint);
        }

        void Say(string text)
        {
            Debug.Log("trajectory: " + text);
            m_Ros.Publish(statusTopic, new StringMsg(text));
        }
    }
}
