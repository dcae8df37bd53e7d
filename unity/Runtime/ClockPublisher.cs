using Armcell.Logic;
using RosMessageTypes.Rosgraph;
using Unity.Robotics.ROSTCPConnector;
using UnityEngine;

namespace Armcell
{
    /// <summary>Publishes the simulation's time, which all stamps are in.</summary>
    [AddComponentMenu("armcell/Clock Publisher")]
    public class ClockPublisher : MonoBehaviour
    {
        public string topic = "/clock";
        [Tooltip("Hz of the simulation's time")] public double rate = 100.0;

        ROSConnection m_Ros;
        Rate m_Rate;

        void Start()
        {
            m_Ros = ROSConnection.GetOrCreateInstance();
            m_Ros.RegisterPublisher<ClockMsg>(topic);
            m_Rate = new Rate(rate);
        }

        void FixedUpdate()
        {
            double now = Time.fixedTimeAsDouble;
            if (m_Rate.Due(now)) m_Ros.Publish(topic, new ClockMsg(Ros.Time(now)));
        }
    }
}
