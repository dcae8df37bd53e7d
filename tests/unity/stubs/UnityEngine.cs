// What the package uses of Unity's API, written anew from the public scripting reference, so that Mono can
// compile and run it. Values are Unity's floats. Articulations are kinematic: a joint is where its drive leads
// it within its limits; no forces.
using System;
using System.Collections.Generic;
using System.Linq;

namespace UnityEngine
{
    [AttributeUsage(AttributeTargets.Class)]
    public class DefaultExecutionOrder : Attribute
    {
        public readonly int order;
        public DefaultExecutionOrder(int order) { this.order = order; }
    }

    public class AddComponentMenu : Attribute { public AddComponentMenu(string menu) { } }
    public class TooltipAttribute : Attribute { public TooltipAttribute(string text) { } }

    public class Object
    {
        string m_Name = "";
        bool m_Destroyed;

        public virtual string name { get { return m_Name; } set { m_Name = value; } }
        public static void Destroy(Object o)
        {
            Component component = o as Component;
            if (component != null) component.gameObject.Remove(component);
            o.m_Destroyed = true;
        }
        static bool Gone(Object o) { return ReferenceEquals(o, null) || o.m_Destroyed; }
        public static bool operator ==(Object a, Object b)
        {
            return Gone(a) || Gone(b) ? Gone(a) && Gone(b) : ReferenceEquals(a, b);
        }
        public static bool operator !=(Object a, Object b) { return !(a == b); }
        public override bool Equals(object o) { return this == o as Object; }
        public override int GetHashCode() { return System.Runtime.CompilerServices.RuntimeHelpers.GetHashCode(this); }
    }

    public class Component : Object
    {
        public GameObject gameObject { get; internal set; }
        public Transform transform { get { return gameObject.transform; } }
        public override string name { get { return gameObject.name; } set { gameObject.name = value; } }
        public T GetComponent<T>() where T : class { return gameObject.GetComponent<T>(); }
        public T GetComponentInParent<T>() where T : class
        {
            for (Transform at = transform; !ReferenceEquals(at, null); at = at.parent)
            {
                T found = at.gameObject.GetComponent<T>();
                if (found != null) return found;
            }
            return null;
        }
        public T[] GetComponentsInChildren<T>() where T : class { return gameObject.GetComponentsInChildren<T>(); }
    }

    public class Behaviour : Component { public bool enabled = true; }
    public class MonoBehaviour : Behaviour { }

    public sealed class GameObject : Object
    {
        public static readonly List<GameObject> All = new List<GameObject>();
        readonly List<Component> m_Components = new List<Component>();

        public GameObject(string name)
        {
            this.name = name;
            transform = AddComponent<Transform>();
            All.Add(this);
        }

        public Transform transform { get; private set; }
        public bool activeInHierarchy { get { return true; } }
        public IEnumerable<Component> Components { get { return m_Components; } }
        public T AddComponent<T>() where T : Component, new()
        {
            T made = new T();
            made.gameObject = this;
            m_Components.Add(made);
            return made;
        }
        internal void Remove(Component component) { m_Components.Remove(component); }
        public T GetComponent<T>() where T : class { return m_Components.OfType<T>().FirstOrDefault(); }
        public T[] GetComponentsInChildren<T>() where T : class
        {
            return m_Components.OfType<T>()
                .Concat(transform.Children.SelectMany(c => c.gameObject.GetComponentsInChildren<T>())).ToArray();
        }
    }

    public class Transform : Component
    {
        readonly List<Transform> m_Children = new List<Transform>();

        public Vector3 localPosition = Vector3.zero;
        public Quaternion localRotation = Quaternion.identity;
        public Vector3 localScale = Vector3.one;
        public Transform parent { get; private set; }
        public IEnumerable<Transform> Children { get { return m_Children; } }

        public void SetParent(Transform to, bool worldPositionStays)
        {
            if (worldPositionStays) throw new NotSupportedException();
            if (!ReferenceEquals(parent, null)) parent.m_Children.Remove(this);
            parent = to;
            to.m_Children.Add(this);
        }
        public Vector3 lossyScale
        {
            get { return parent == null ? localScale : Vector3.Scale(parent.lossyScale, localScale); }
        }
        public Quaternion rotation
        {
            get { return parent == null ? localRotation : parent.rotation * localRotation; }
            set { localRotation = parent == null ? value : Quaternion.Inverse(parent.rotation) * value; }
        }
        public Vector3 position
        {
            get { return parent == null ? localPosition : parent.TransformPoint(localPosition); }
            set { localPosition = parent == null ? value : parent.InverseTransformPoint(value); }
        }
        public Vector3 TransformPoint(Vector3 p) { return position + rotation * Vector3.Scale(lossyScale, p); }
        public Vector3 InverseTransformPoint(Vector3 p)
        {
            Vector3 q = Quaternion.Inverse(rotation) * (p - position), s = lossyScale;
            return new Vector3(q.x / s.x, q.y / s.y, q.z / s.z);
        }
    }

    public struct Vector3
    {
        public float x, y, z;
        public Vector3(float x, float y, float z) { this.x = x; this.y = y; this.z = z; }
        public static Vector3 zero { get { return new Vector3(0, 0, 0); } }
        public static Vector3 one { get { return new Vector3(1, 1, 1); } }
        public static Vector3 right { get { return new Vector3(1, 0, 0); } }
        public static Vector3 up { get { return new Vector3(0, 1, 0); } }
        public static Vector3 operator +(Vector3 a, Vector3 b) { return new Vector3(a.x + b.x, a.y + b.y, a.z + b.z); }
        public static Vector3 operator -(Vector3 a, Vector3 b) { return new Vector3(a.x - b.x, a.y - b.y, a.z - b.z); }
        public static Vector3 operator -(Vector3 a) { return new Vector3(-a.x, -a.y, -a.z); }
        public static Vector3 operator *(Vector3 a, float f) { return new Vector3(a.x * f, a.y * f, a.z * f); }
        public static Vector3 Scale(Vector3 a, Vector3 b) { return new Vector3(a.x * b.x, a.y * b.y, a.z * b.z); }
        public static Vector3 Cross(Vector3 a, Vector3 b)
        {
            return new Vector3(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x);
        }
        public static float Dot(Vector3 a, Vector3 b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
        public float magnitude { get { return (float)Math.Sqrt(Dot(this, this)); } }
        public float this[int i]
        {
            get { return i == 0 ? x : i == 1 ? y : z; }
            set
            {
                if (i == 0) x = value;
                else if (i == 1) y = value;
                else z = value;
            }
        }
    }

    public struct Quaternion
    {
        public float x, y, z, w;
        public Quaternion(float x, float y, float z, float w) { this.x = x; this.y = y; this.z = z; this.w = w; }
        public static Quaternion identity { get { return new Quaternion(0, 0, 0, 1); } }
        public static Quaternion Inverse(Quaternion q) { return new Quaternion(-q.x, -q.y, -q.z, q.w); }
        public static Quaternion operator *(Quaternion a, Quaternion b)
        {
            return Normal(
                (double)a.w * b.x + (double)a.x * b.w + (double)a.y * b.z - (double)a.z * b.y,
                (double)a.w * b.y - (double)a.x * b.z + (double)a.y * b.w + (double)a.z * b.x,
                (double)a.w * b.z + (double)a.x * b.y - (double)a.y * b.x + (double)a.z * b.w,
                (double)a.w * b.w - (double)a.x * b.x - (double)a.y * b.y - (double)a.z * b.z);
        }
        public static Vector3 operator *(Quaternion q, Vector3 v)
        {
            Vector3 u = new Vector3(q.x, q.y, q.z), t = Vector3.Cross(u, v) * 2f;
            return v + t * q.w + Vector3.Cross(u, t);
        }
        public static Quaternion AngleAxis(float degrees, Vector3 axis)
        {
            double half = degrees * Math.PI / 360.0, s = Math.Sin(half) / axis.magnitude;
            return new Quaternion((float)(axis.x * s), (float)(axis.y * s), (float)(axis.z * s), (float)Math.Cos(half));
        }
        public static Quaternion FromToRotation(Vector3 a, Vector3 b)
        {
            a = a * (1f / a.magnitude);
            b = b * (1f / b.magnitude);
            float w = 1f + Vector3.Dot(a, b);
            Vector3 n = Vector3.Cross(a, b);
            if (w < 1e-6f) // opposite: half a turn about whatever is square to them
            {
                n = Vector3.Cross(a, Math.Abs(a.x) < 0.9f ? Vector3.right : Vector3.up);
                w = 0f;
            }
            return Normal(n.x, n.y, n.z, w);
        }
        public static float Angle(Quaternion a, Quaternion b)
        {
            double dot = Math.Abs((double)a.x * b.x + (double)a.y * b.y + (double)a.z * b.z + (double)a.w * b.w);
            return (float)(2.0 * Math.Acos(Math.Min(dot, 1.0)) * 180.0 / Math.PI);
        }
        static Quaternion Normal(double x, double y, double z, double w)
        {
            double n = Math.Sqrt(x * x + y * y + z * z + w * w);
            return new Quaternion((float)(x / n), (float)(y / n), (float)(z / n), (float)(w / n));
        }
    }

    public struct Color
    {
        public float r, g, b, a;
        public Color(float r, float g, float b, float a) { this.r = r; this.g = g; this.b = b; this.a = a; }
    }

    public static class Mathf
    {
        public static float Max(float a, float b) { return Math.Max(a, b); }
        public static float Abs(float a) { return Math.Abs(a); }
    }

    public static class Time
    {
        public static double fixedTimeAsDouble { get; internal set; }
        public static float fixedDeltaTime = 0.02f;
        public static float timeScale = 1f;
        internal static void Pass() { fixedTimeAsDouble += fixedDeltaTime; }
    }

    public static class Debug
    {
        public static void Log(object message) { Console.Error.WriteLine(message); }
        public static void LogWarning(object message) { Console.Error.WriteLine(message); }
        public static void LogException(Exception error) { Console.Error.WriteLine(error); }
    }

    // --- physics ---
    public enum ArticulationJointType { FixedJoint, PrismaticJoint, RevoluteJoint, SphericalJoint }
    public enum ArticulationDofLock { LockedMotion, LimitedMotion, FreeMotion }
    public enum CollisionDetectionMode { Discrete, Continuous, ContinuousDynamic, ContinuousSpeculative }

    public struct ArticulationDrive
    {
        public float lowerLimit, upperLimit, stiffness, damping, forceLimit, target, targetVelocity;
    }

    public struct ArticulationReducedSpace
    {
        readonly float m_Value;
        public readonly int dofCount;
        public ArticulationReducedSpace(float a) { m_Value = a; dofCount = 1; }
        public float this[int i]
        {
            get
            {
                if (i >= dofCount) throw new IndexOutOfRangeException();
                return m_Value;
            }
        }
    }

    public class ArticulationBody : Behaviour
    {
        public static double MaxSpeed = double.PositiveInfinity; // [rad/s or m/s] of every joint
        public ArticulationJointType jointType;
        public ArticulationDrive xDrive;
        public ArticulationDofLock linearLockX, linearLockY, linearLockZ, twistLock;
        public Vector3 anchorPosition, centerOfMass, inertiaTensor;
        public Quaternion anchorRotation = Quaternion.identity, inertiaTensorRotation;
        public float mass = 1, jointFriction, linearDamping, angularDamping;
        public bool immovable, useGravity = true, automaticCenterOfMass = true, automaticInertiaTensor = true;
        public int solverIterations, solverVelocityIterations;
        public Func<double, double> Blocked; // where a joint gets that wants somewhere; null: there
        double m_Q, m_V;
        Vector3 m_RestPosition;
        Quaternion m_RestRotation;
        bool m_Known;

        int Dofs { get { return jointType == ArticulationJointType.FixedJoint ? 0 : 1; } }
        bool Slides { get { return jointType == ArticulationJointType.PrismaticJoint; } }
        public ArticulationReducedSpace jointPosition
        {
            get { return Dofs == 0 ? new ArticulationReducedSpace() : new ArticulationReducedSpace((float)m_Q); }
            set { Put(value[0]); }
        }
        public ArticulationReducedSpace jointVelocity
        {
            get { return Dofs == 0 ? new ArticulationReducedSpace() : new ArticulationReducedSpace((float)m_V); }
            set { m_V = value[0]; }
        }
        public ArticulationReducedSpace driveForce
        {
            get { return Dofs == 0 ? new ArticulationReducedSpace() : new ArticulationReducedSpace(0f); }
        }

        /// <summary>One step: degrees become radians here, as in the real one.</summary>
        public void Simulate(double period)
        {
            if (Dofs == 0) return;
            double unit = Slides ? 1.0 : Math.PI / 180.0, goal = xDrive.target;
            bool limited = (Slides ? linearLockX : twistLock) == ArticulationDofLock.LimitedMotion;
            if (limited) goal = Math.Min(Math.Max(goal, xDrive.lowerLimit), xDrive.upperLimit);
            goal = m_Q + Math.Max(Math.Min(goal * unit - m_Q, MaxSpeed * period), -MaxSpeed * period);
            if (Blocked != null) goal = Blocked(goal);
            m_V = (goal - m_Q) / period;
            Put(goal);
        }

        void Put(double q)
        {
            if (!m_Known)
            {
                m_Known = true;
                m_RestPosition = transform.localPosition;
                m_RestRotation = transform.localRotation;
            }
            m_Q = q;
            Vector3 axis = anchorRotation * Vector3.right;
            if (Slides) transform.localPosition = m_RestPosition + m_RestRotation * axis * (float)q;
            else transform.localRotation = m_RestRotation * Quaternion.AngleAxis((float)(q * 180.0 / Math.PI), axis);
        }
    }

    public class Rigidbody : Component
    {
        public float mass = 1, sleepThreshold;
        public CollisionDetectionMode collisionDetectionMode;
        public int solverIterations, solverVelocityIterations;
    }

    public class Joint : Component
    {
        public ArticulationBody connectedArticulationBody;
        public float breakForce = float.PositiveInfinity;
    }

    public class FixedJoint : Joint { }

    public class Collider : Component
    {
        public bool enabled = true, isTrigger;
        public PhysicMaterial sharedMaterial;
    }

    public class BoxCollider : Collider { public Vector3 size = Vector3.one, center; }
    public class SphereCollider : Collider { public float radius = 0.5f; public Vector3 center; }
    public class CapsuleCollider : Collider
    {
        public float radius = 0.5f, height = 1f;
        public int direction = 1;
        public Vector3 center;
    }
    public class MeshCollider : Collider { public bool convex; public Mesh sharedMesh; }

    public struct ContactPoint { public Vector3 point { get; set; } }

    public class Collision
    {
        public Rigidbody rigidbody;
        public Collider collider;
        public Vector3 impulse, point;
        public int contactCount { get { return 1; } }
        public ContactPoint GetContact(int i) { return new ContactPoint { point = point }; }
    }

    public static class Physics
    {
        public static int defaultSolverIterations, defaultSolverVelocityIterations;
        public static Vector3 gravity;
        public static readonly List<Tuple<Collider, Collider>> Ignored = new List<Tuple<Collider, Collider>>();
        public static void IgnoreCollision(Collider a, Collider b) { Ignored.Add(Tuple.Create(a, b)); }
    }

    public enum PhysicMaterialCombine { Average, Multiply, Minimum, Maximum }

    public class PhysicMaterial : Object
    {
        public float staticFriction, dynamicFriction, bounciness;
        public PhysicMaterialCombine frictionCombine;
        public PhysicMaterial(string name) { this.name = name; }
    }

    // --- looks ---
    public class Mesh : Object
    {
        public Vector3[] vertices, normals;
        public int[] triangles;
        public Rendering.IndexFormat indexFormat;
        public void RecalculateBounds() { }
    }

    public class Renderer : Component { public Material sharedMaterial; }
    public class MeshRenderer : Renderer { }
    public class MeshFilter : Component { public Mesh sharedMesh; }
    public class Shader : Object { public static Shader Find(string name) { return new Shader(); } }

    public class Material : Object
    {
        public Color color;
        public Material(Shader shader) { }
    }
}

namespace UnityEngine.Rendering
{
    public enum IndexFormat { UInt16, UInt32 }
    public class RenderPipelineAsset : Object { public Shader defaultShader; }
    public static class GraphicsSettings { public static RenderPipelineAsset currentRenderPipeline; }
}

namespace UnityEngine.SceneManagement
{
    public struct Scene { }
    public static class SceneManager { public static Scene GetActiveScene() { return new Scene(); } }
}
