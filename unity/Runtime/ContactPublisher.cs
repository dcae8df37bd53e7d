using Armcell.Logic;
using RosMessageTypes.Std;
using Unity.Robotics.ROSTCPConnector;
using UnityEngine;

namespace Armcell
{
    /// <summary>
    /// Tells when this body begins and ends to touch another: "begin cube panda_leftfinger 0.400 0.100 0.025
    /// 3.2" (the two names, where in the cell [m], force [N]) and "end cube panda_leftfinger".
    /// </summary>
    [AddComponentMenu("armcell/Contact Publisher")]
    public class ContactPublisher : MonoBehaviour
    {
        [Tooltip("The cell's root: ROS's world. Empty: Unity's origin.")] public Transform world;
        public string topic = "/contacts";

        ROSConnection m_Ros;

        void Start()
        {
            m_Ros = ROSConnection.GetOrCreateInstance();
            m_Ros.RegisterPublisher<StringMsg>(topic, 100);
        }

        void OnCollisionEnter(Collision collision)
        {
            string other = Other(collision);
            if (m_Ros == null || other == null || collision.contactCount == 0) return;
            Vector3 at = collision.GetContact(0).point;
            Vec3 p = Axes.ToRos(Ros.Of(world == null ? at : world.InverseTransformPoint(at)));
            double force = collision.impulse.magnitude / Time.fixedDeltaTime;
            m_Ros.Publish(topic, new StringMsg("begin " + name + " " + other + " " + Words.F(p.x, 3) + " "
                + Words.F(p.y, 3) + " " + Words.F(p.z, 3) + " " + Words.F(force, 1)));
        }

        void OnCollisionExit(Collision collision)
        {
            string other = Other(collision);
            if (m_Ros != null && other != null) m_Ros.Publish(topic, new StringMsg("end " + name + " " + other));
        }

        /// <summary>The other body's name; null where that one tells of the pair itself.</summary>
        string Other(Collision collision)
        {
            ContactPublisher other = collision.collider.GetComponentInParent<ContactPublisher>();
            if (other != null) return string.CompareOrdinal(name, other.name) < 0 ? other.name : null;
            Transform body = collision.collider.transform;
            while (body.parent != null && body.parent != world) body = body.parent;
            return body.name;
        }
    }
}
