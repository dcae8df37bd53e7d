using Armcell.Logic;
using RosMessageTypes.Sensor;
using Unity.Robotics.ROSTCPConnector;
using UnityEngine;

namespace Armcell
{
    /// <summary>Publishes the driven joints' positions, velocities and efforts, fingers too.</summary>
    [AddComponentMenu("armcell/Joint State Publisher")]
    public class JointStatePublisher : MonoBehaviour
    {
        public JointMap map;
        public string topic = "/joint_states";
        [Tooltip("Hz of the simulation's time")] public double rate = 30.0;

        ROSConnection m_Ros;
        Rate m_Rate;

        void Start()
        {
            m_Ros = ROSConnection.GetOrCreateInstance();
            m_Ros.RegisterPublisher<JointStateMsg>(topic);
            m_Rate = new Rate(rate);
        }

        void FixedUpdate()
        {
            double now = Time.fixedTimeAsDouble;
            if (!m_Rate.Due(now)) return;
            string[] names = map.Table.Driven;
            JointStateMsg message = new JointStateMsg();
            message.header = Ros.Header(now, Ros.World);
            message.name = names;
            message.position = new double[names.Length];
            message.velocity = new double[names.Length];
            for (int i = 0; i < names.Length; i++)
            {
                message.position[i] = map.Position(names[i]);
                message.velocity[i] = map.Velocity(names[i]);
            }
#if UNITY_2022_2_OR_NEWER
            message.effort = System.Array.ConvertAll(names, map.Effort);
#endif
            m_Ros.Publish(topic, message);
        }
    }
}
