using System.Linq;
using Armcell.Logic;
using RosMessageTypes.Std;
using Unity.Robotics.ROSTCPConnector;
using UnityEngine;

namespace Armcell
{
    /// <summary>
    /// Opens and closes a parallel gripper: 0 or more on its topic is a width in metres, below 0 closes with
    /// that force in newtons per finger. What holds the object is the mode's affair: friction, a joint as soon
    /// as both fingers press (weld), or a joint only when it slips (hybrid). Every joint is told on the status
    /// topic.
    /// </summary>
    [DefaultExecutionOrder(-90)]
    [AddComponentMenu("armcell/Gripper Controller")]
    public class GripperController : MonoBehaviour
    {
        public JointMap map;
        [Tooltip("The driven finger joint; others follow it.")] public string joint = "";
        public Transform tcp;
        [Tooltip("The body that an object is fixed to.")] public ArticulationBody hand;
        public GameObject[] fingers = new GameObject[0];
        public string topic = "/gripper_command";
        public string statusTopic = "/gripper_status";
        public GripSettings settings = new GripSettings();
        [Tooltip("N; what a joint of the mode hybrid bears before it breaks.")] public float hybridBreakForce = 60f;

        ROSConnection m_Ros;
        Grip m_Grip;
        FingerContact[] m_Contacts;
        Rigidbody m_Watched;
        FixedJoint m_Weld;
        Vector3 m_Place;
        Quaternion m_Turn;

        /// <summary>The object that is held; null: none.</summary>
        public string Held
        {
            get { return m_Grip == null ? null : m_Grip.Held; }
        }

        void Start()
        {
            m_Contacts = fingers.Select(Contact).ToArray();
            m_Grip = new Grip(settings, settings.Width(map.Table[joint].start), Say);
            map.Redirect(joint, q => m_Grip.Lead(settings.Width(q), Width()));
            m_Ros = ROSConnection.GetOrCreateInstance();
            m_Ros.RegisterPublisher<StringMsg>(statusTopic, 10, true);
            m_Ros.Subscribe<Float64Msg>(topic, message => Command(message.data));
        }

        static FingerContact Contact(GameObject finger)
        {
            FingerContact contact = finger.GetComponent<FingerContact>();
            return contact != null ? contact : finger.AddComponent<FingerContact>();
        }

        /// <summary>As the topic means it.</summary>
        public void Command(double value)
        {
            m_Grip.Command(value, Time.fixedTimeAsDouble, Width());
        }

        /// <summary>Lead the finger joint to a position; what is in the way is held.</summary>
        /// <param name="ended">told "done: ..." or "stopped: ..."</param>
        public void MoveJoint(double q, System.Action<string> ended)
        {
            m_Grip.Move(settings.Width(q), 0.0, Time.fixedTimeAsDouble, Width(), ended);
        }

        public double Width()
        {
            return settings.Width(map.Position(joint));
        }

        void FixedUpdate()
        {
            if (m_Grip.IsWelded && m_Weld == null) m_Grip.Broken();
            Rigidbody pressed = Pressed();
            GripAction action = m_Grip.Step(Time.fixedTimeAsDouble, Time.fixedDeltaTime, Width(),
                pressed == null ? null : pressed.name, Slip(), Turned());
            if (action == GripAction.Remember)
            {
                m_Watched = pressed;
                m_Place = tcp.InverseTransformPoint(pressed.transform.position);
                m_Turn = Quaternion.Inverse(tcp.rotation) * pressed.transform.rotation;
            }
            else if (action == GripAction.Weld) Weld(pressed != null ? pressed : m_Watched);
            else if (action == GripAction.Release)
            {
                if (m_Weld != null) Destroy(m_Weld);
                m_Weld = null;
            }
            map.LimitForce(joint, settings.JointForce(m_Grip.Force));
            map.Lead(joint, settings.Joint(m_Grip.SetPoint), 0.0);
        }

        /// <summary>What every finger touches.</summary>
        Rigidbody Pressed()
        {
            return m_Contacts.Length == 0 ? null
                : m_Contacts[0].Touched.FirstOrDefault(b => m_Contacts.All(c => c.Touches(b)));
        }

        double Slip()
        {
            return m_Watched == null ? 0.0
                : (tcp.InverseTransformPoint(m_Watched.transform.position) - m_Place).magnitude;
        }

        double Turned()
        {
            return m_Watched == null ? 0.0 : Quat.Angle(
                Ros.Of(Quaternion.Inverse(tcp.rotation) * m_Watched.transform.rotation), Ros.Of(m_Turn));
        }

        void Weld(Rigidbody body)
        {
            m_Weld = body.gameObject.AddComponent<FixedJoint>();
            m_Weld.connectedArticulationBody = hand;
            m_Weld.breakForce = settings.mode == GripMode.Hybrid ? hybridBreakForce : float.PositiveInfinity;
        }

        void Say(string text)
        {
            Debug.Log("gripper: " + text);
            if (m_Ros != null) m_Ros.Publish(statusTopic, new StringMsg(text));
        }
    }
}
