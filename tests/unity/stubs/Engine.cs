// Unity's loop for the tests: Awake, Start, FixedUpdate, physics, Update, in the order of DefaultExecutionOrder.
// Physics is kinematic: joints go where their drives lead them; fingers stop at an object between them, which is
// then carried; what is not carried falls to where it stood.
using System;
using System.Collections.Generic;
using System.Linq;
using System.Reflection;
using Armcell;
using UnityEngine;

public class Engine
{
    const BindingFlags k_Any = BindingFlags.Instance | BindingFlags.Public | BindingFlags.NonPublic;
    const float k_Pad = 0.0095f; // [m] half a pad's size about the tcp, across the closing direction

    class Grasped
    {
        public Rigidbody body;
        public Vector3 position; // in the tcp
        public Quaternion rotation;
    }

    readonly HashSet<MonoBehaviour> m_Started = new HashSet<MonoBehaviour>();
    readonly Dictionary<GripperController, Grasped> m_Grasped = new Dictionary<GripperController, Grasped>();
    readonly Dictionary<Rigidbody, float> m_Floor = new Dictionary<Rigidbody, float>();
    readonly Dictionary<Rigidbody, float> m_Falling = new Dictionary<Rigidbody, float>(); // [m/s]
    MonoBehaviour[] m_Behaviours = new MonoBehaviour[0];
    ArticulationBody[] m_Bodies;
    Rigidbody[] m_Items;

    /// <summary>[m/s] that what is held by friction slips down.</summary>
    public float Slip;

    public void Play()
    {
        Find();
        foreach (MonoBehaviour behaviour in m_Behaviours) Call(behaviour, "Awake");
        StartNew();
        m_Bodies = All<ArticulationBody>();
        m_Items = All<Rigidbody>();
        foreach (Rigidbody item in m_Items)
        {
            m_Floor[item] = item.transform.position.y;
            m_Falling[item] = 0f;
        }
    }

    public void Step()
    {
        StartNew();
        foreach (MonoBehaviour behaviour in m_Behaviours) Call(behaviour, "FixedUpdate");
        GripperController[] grippers = m_Behaviours.OfType<GripperController>().ToArray();
        Dictionary<GripperController, Rigidbody> between = grippers.ToDictionary(g => g, Block);
        foreach (ArticulationBody body in m_Bodies) body.Simulate(Time.fixedDeltaTime);
        foreach (GripperController gripper in grippers) Hold(gripper, between[gripper]);
        foreach (Rigidbody item in m_Items.Where(i => m_Grasped.Values.All(g => g.body != i))) Fall(item);
        Time.Pass();
    }

    public static T[] All<T>() where T : class
    {
        return GameObject.All.SelectMany(o => o.Components).OfType<T>().ToArray();
    }

    void Find()
    {
        m_Behaviours = All<MonoBehaviour>().OrderBy(b =>
        {
            object[] order = b.GetType().GetCustomAttributes(typeof(DefaultExecutionOrder), true);
            return order.Length == 0 ? 0 : ((DefaultExecutionOrder)order[0]).order;
        }).ToArray();
    }

    void StartNew()
    {
        if (m_Started.Count == All<MonoBehaviour>().Length) return;
        Find();
        foreach (MonoBehaviour behaviour in m_Behaviours)
            if (m_Started.Add(behaviour)) Call(behaviour, "Start");
        Find();
    }

    static void Call(object target, string method, params object[] arguments)
    {
        MethodInfo found = target.GetType().GetMethod(method, k_Any, null, arguments.Select(a => a.GetType()).ToArray(), null);
        if (found != null) found.Invoke(target, arguments);
    }

    // --- gripping: along the tcp's y in ROS's axes, x in Unity's ---
    Rigidbody Block(GripperController gripper)
    {
        Rigidbody item = m_Items.FirstOrDefault(i =>
        {
            if (i.gameObject.GetComponentsInChildren<BoxCollider>().Length == 0) return false; // boxes only
            Vector3 p = gripper.tcp.InverseTransformPoint(i.transform.position);
            return Math.Abs(p.y) < Half(i, gripper.tcp, Vector3.up) + k_Pad
                && Math.Abs(p.z) < Half(i, gripper.tcp, new Vector3(0, 0, 1)) + k_Pad
                && Math.Abs(p.x) < gripper.Width() / 2f;
        });
        foreach (GameObject finger in gripper.fingers)
        {
            ArticulationBody body = finger.GetComponent<ArticulationBody>();
            body.Blocked = null;
            if (item == null) continue;
            double least = gripper.settings.Joint(2.0 * Half(item, gripper.tcp, Vector3.right));
            body.Blocked = q => Math.Max(q, least);
        }
        return item;
    }

    void Hold(GripperController gripper, Rigidbody item)
    {
        Grasped grasped;
        m_Grasped.TryGetValue(gripper, out grasped);
        bool welded = grasped != null && All<FixedJoint>().Any(j => j.gameObject == grasped.body.gameObject);
        bool pressed = item != null && gripper.Width() <= 2.0 * Half(item, gripper.tcp, Vector3.right) + 1e-5;
        if (!pressed && !welded)
        {
            m_Grasped.Remove(gripper);
            return;
        }
        if (grasped == null)
        {
            Vector3 p = gripper.tcp.InverseTransformPoint(item.transform.position);
            grasped = m_Grasped[gripper] = new Grasped
            {
                body = item, position = new Vector3(0f, p.y, p.z), // pushed to the middle
                rotation = Quaternion.Inverse(gripper.tcp.rotation) * item.transform.rotation
            };
            foreach (GameObject finger in gripper.fingers) Tell("OnCollisionEnter", finger, item);
        }
        if (!welded) grasped.position -= Quaternion.Inverse(gripper.tcp.rotation) * Vector3.up * (Slip * Time.fixedDeltaTime);
        grasped.body.transform.position = gripper.tcp.TransformPoint(grasped.position);
        grasped.body.transform.rotation = gripper.tcp.rotation * grasped.rotation;
        m_Falling[grasped.body] = 0f;
        foreach (GameObject finger in gripper.fingers) Tell("OnCollisionStay", finger, grasped.body);
    }

    static void Tell(string what, GameObject finger, Rigidbody item)
    {
        Collider own = finger.GetComponentsInChildren<Collider>().First();
        Collider other = item.gameObject.GetComponentsInChildren<Collider>().First();
        Vector3 at = item.transform.position;
        foreach (MonoBehaviour behaviour in finger.GetComponentsInChildren<MonoBehaviour>())
            Call(behaviour, what, new Collision { rigidbody = item, collider = other, point = at });
        foreach (MonoBehaviour behaviour in item.gameObject.GetComponentsInChildren<MonoBehaviour>())
            Call(behaviour, what, new Collision { collider = own, point = at });
    }

    void Fall(Rigidbody item)
    {
        Vector3 p = item.transform.position;
        m_Falling[item] -= Physics.gravity.y * Time.fixedDeltaTime;
        p.y = Math.Max(p.y - m_Falling[item] * Time.fixedDeltaTime, m_Floor[item]);
        if (p.y <= m_Floor[item]) m_Falling[item] = 0f;
        item.transform.position = p;
    }

    /// <summary>Half an object's size [m] along a direction of the tcp.</summary>
    static float Half(Rigidbody item, Transform tcp, Vector3 direction)
    {
        BoxCollider box = item.gameObject.GetComponentsInChildren<BoxCollider>().First();
        Vector3 along = tcp.rotation * direction;
        float half = 0f;
        for (int i = 0; i < 3; i++)
        {
            Vector3 axis = Vector3.zero;
            axis[i] = 1f;
            half += Math.Abs(Vector3.Dot(along, box.transform.rotation * axis)) * box.size[i] / 2f;
        }
        return half;
    }
}
