using Armcell.Logic;
using RosMessageTypes.Geometry;
using Unity.Robotics.ROSTCPConnector;
using UnityEngine;

namespace Armcell
{
    /// <summary>Publishes where this object is, in the cell's frame, so that armcell can grasp it.</summary>
    [AddComponentMenu("armcell/Object Pose Publisher")]
    public class ObjectPosePublisher : MonoBehaviour
    {
        [Tooltip("The cell's root: ROS's world. Empty: Unity's origin.")] public Transform world;
        public string topic = "/object_pose";
        [Tooltip("Hz of the simulation's time")] public double rate = 30.0;

        ROSConnection m_Ros;
        Rate m_Rate;

        void Start()
        {
            m_Ros = ROSConnection.GetOrCreateInstance();
            m_Ros.RegisterPublisher<PoseStampedMsg>(topic);
            m_Rate = new Rate(rate);
        }

        void FixedUpdate()
        {
            double now = Time.fixedTimeAsDouble;
            if (!m_Rate.Due(now)) return;
            m_Ros.Publish(topic, new PoseStampedMsg(Ros.Header(now, Ros.World), Ros.Pose(transform, world)));
        }
    }
}
