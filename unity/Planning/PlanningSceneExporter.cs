using System.Collections.Generic;
using System.Linq;
using Armcell.Logic;
using RosMessageTypes.Geometry;
using RosMessageTypes.Moveit;
using RosMessageTypes.Shape;
using Unity.Robotics.ROSTCPConnector;
using UnityEngine;

namespace Armcell
{
    /// <summary>
    /// Tells the planner what stands in the scene: every collider below the roots becomes a part of a
    /// collision object (topic /collision_object), and again whenever it has moved. The robot, and what
    /// publishes its pose, are left out: armcell knows them.
    /// </summary>
    [AddComponentMenu("armcell/Planning Scene Exporter")]
    public class PlanningSceneExporter : MonoBehaviour
    {
        [Tooltip("The cell's root: ROS's world. Empty: Unity's origin.")] public Transform world;
        [Tooltip("What the planner shall know; each child with colliders is an object.")] public Transform[] roots =
            new Transform[0];
        public string topic = "/collision_object";
        [Tooltip("Hz of looking whether something has moved")] public double rate = 5.0;
        [Tooltip("m")] public float moved = 0.002f;
        [Tooltip("deg")] public float turned = 0.5f;

        class Sent
        {
            public Vector3 position;
            public Quaternion rotation;
        }

        ROSConnection m_Ros;
        Rate m_Rate;
        readonly Dictionary<Transform, Sent> m_Sent = new Dictionary<Transform, Sent>();
        readonly Dictionary<Transform, string> m_Ids = new Dictionary<Transform, string>();

        void Start()
        {
            m_Ros = ROSConnection.GetOrCreateInstance();
            m_Ros.RegisterPublisher<CollisionObjectMsg>(topic, 100);
            m_Rate = new Rate(rate);
        }

        void FixedUpdate()
        {
            if (m_Rate.Due(Time.fixedTimeAsDouble)) Look();
        }

        /// <summary>Send everything again, for a planner that came later.</summary>
        public void SendAll()
        {
            m_Sent.Clear();
        }

        void Look()
        {
            HashSet<Transform> here = new HashSet<Transform>();
            foreach (Transform root in roots.Where(r => r != null && r.gameObject.activeInHierarchy))
                foreach (Collider collider in root.GetComponentsInChildren<Collider>())
                    if (IsObstacle(collider)) here.Add(Owner(collider.transform, root));
            foreach (Transform item in here.Where(HasMoved).ToArray())
            {
                m_Ros.Publish(topic, Message(item));
                m_Sent[item] = new Sent { position = item.position, rotation = item.rotation };
            }
            foreach (Transform gone in m_Sent.Keys.Where(t => t == null || !here.Contains(t)).ToArray())
            {
                CollisionObjectMsg remove = new CollisionObjectMsg();
                remove.header = Ros.Header(Time.fixedTimeAsDouble, Ros.World);
                remove.id = m_Ids[gone];
                remove.operation = CollisionObjectMsg.REMOVE;
                m_Ros.Publish(topic, remove);
                m_Sent.Remove(gone);
            }
        }

        static bool IsObstacle(Collider collider)
        {
            return collider.enabled && !collider.isTrigger
                && collider.GetComponentInParent<ArticulationBody>() == null
                && collider.GetComponentInParent<ObjectPosePublisher>() == null;
        }

        /// <summary>The child of the root that a collider belongs to, or the root itself.</summary>
        static Transform Owner(Transform part, Transform root)
        {
            while (part != root && part.parent != root) part = part.parent;
            return part;
        }

        bool HasMoved(Transform item)
        {
            Sent sent;
            return !m_Sent.TryGetValue(item, out sent) || (item.position - sent.position).magnitude > moved
                || Quaternion.Angle(item.rotation, sent.rotation) > turned;
        }

        CollisionObjectMsg Message(Transform item)
        {
            string id;
            if (!m_Ids.TryGetValue(item, out id))
            {
                id = item.name;
                for (int i = 2; m_Ids.ContainsValue(id); i++) id = item.name + "_" + i;
                m_Ids.Add(item, id);
            }
            List<SolidPrimitiveMsg> solids = new List<SolidPrimitiveMsg>();
            List<PoseMsg> solidPoses = new List<PoseMsg>(), meshPoses = new List<PoseMsg>();
            List<MeshMsg> meshes = new List<MeshMsg>();
            foreach (Collider collider in item.GetComponentsInChildren<Collider>().Where(IsObstacle))
            {
                MeshCollider mesh = collider as MeshCollider;
                if (mesh != null && mesh.sharedMesh != null)
                {
                    meshes.Add(MeshOf(mesh));
                    meshPoses.Add(Ros.Pose(collider.transform, world));
                }
                else if (mesh == null) AddSolids(collider, solids, solidPoses);
            }
            CollisionObjectMsg message = new CollisionObjectMsg();
            message.header = Ros.Header(Time.fixedTimeAsDouble, Ros.World);
            message.id = id;
            message.pose.orientation.w = 1.0;
            message.primitives = solids.ToArray();
            message.primitive_poses = solidPoses.ToArray();
            message.meshes = meshes.ToArray();
            message.mesh_poses = meshPoses.ToArray();
            message.operation = CollisionObjectMsg.ADD;
            return message;
        }

        void AddSolids(Collider collider, List<SolidPrimitiveMsg> solids, List<PoseMsg> poses)
        {
            Vector3 scale = collider.transform.lossyScale;
            scale = new Vector3(Mathf.Abs(scale.x), Mathf.Abs(scale.y), Mathf.Abs(scale.z));
            BoxCollider box = collider as BoxCollider;
            SphereCollider sphere = collider as SphereCollider;
            CapsuleCollider capsule = collider as CapsuleCollider;
            if (box != null)
            {
                Vec3 size = Axes.SizeToRos(Ros.Of(Vector3.Scale(box.size, scale)));
                Add(solids, poses, SolidPrimitiveMsg.BOX, collider.transform, box.center, Quaternion.identity,
                    size.x, size.y, size.z);
            }
            else if (sphere != null)
                Add(solids, poses, SolidPrimitiveMsg.SPHERE, collider.transform, sphere.center, Quaternion.identity,
                    sphere.radius * Mathf.Max(scale.x, Mathf.Max(scale.y, scale.z)));
            else if (capsule != null) AddCapsule(capsule, scale, solids, poses);
            else Debug.LogWarning(collider.name + ": a " + collider.GetType().Name + " is not sent to the planner");
        }

        /// <summary>ROS has no capsule: a cylinder and two balls.</summary>
        void AddCapsule(CapsuleCollider capsule, Vector3 scale, List<SolidPrimitiveMsg> solids, List<PoseMsg> poses)
        {
            int along = capsule.direction;
            float wide = Mathf.Max(scale[(along + 1) % 3], scale[(along + 2) % 3]);
            float radius = capsule.radius * wide;
            float length = Mathf.Max(capsule.height * scale[along] - 2f * radius, 0f);
            Vector3 axis = Vector3.zero;
            axis[along] = 1f;
            Quaternion upright = Quaternion.FromToRotation(Vector3.up, axis);
            foreach (int side in new[] { -1, 1 })
                Add(solids, poses, SolidPrimitiveMsg.SPHERE, capsule.transform,
                    capsule.center + axis * (side * length / 2f / scale[along]), Quaternion.identity, radius);
            if (length > 0f)
                Add(solids, poses, SolidPrimitiveMsg.CYLINDER, capsule.transform, capsule.center, upright, length,
                    radius);
        }

        void Add(List<SolidPrimitiveMsg> solids, List<PoseMsg> poses, byte type, Transform at, Vector3 centre,
            Quaternion turn, params double[] sizes)
        {
            SolidPrimitiveMsg solid = new SolidPrimitiveMsg();
            solid.type = type;
            solid.dimensions = sizes;
            solids.Add(solid);
            Vector3 p = at.TransformPoint(centre);
            Quaternion q = at.rotation * turn;
            if (world != null)
            {
                p = world.InverseTransformPoint(p);
                q = Quaternion.Inverse(world.rotation) * q;
            }
            poses.Add(Ros.Pose(Ros.Of(p), Ros.Of(q)));
        }

        /// <summary>Corners in the collider's frame, scaled; triangles run the other way round in ROS.</summary>
        static MeshMsg MeshOf(MeshCollider collider)
        {
            Vector3 scale = collider.transform.lossyScale;
            MeshMsg message = new MeshMsg();
            message.vertices = collider.sharedMesh.vertices.Select(v =>
            {
                Vec3 p = Axes.ToRos(Ros.Of(Vector3.Scale(v, scale)));
                return new PointMsg(p.x, p.y, p.z);
            }).ToArray();
            int[] corners = collider.sharedMesh.triangles;
            message.triangles = Enumerable.Range(0, corners.Length / 3).Select(i =>
            {
                MeshTriangleMsg triangle = new MeshTriangleMsg();
                triangle.vertex_indices = new[]
                {
                    (uint)corners[3 * i], (uint)corners[3 * i + 2], (uint)corners[3 * i + 1]
                };
                return triangle;
            }).ToArray();
            return message;
        }
    }
}
