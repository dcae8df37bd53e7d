using System.Collections.Generic;
using System.IO;
using System.Linq;
using Armcell.Logic;
using UnityEngine;
using UnityEngine.Rendering;
#if UNITY_6000_0_OR_NEWER
using PhysicMaterial = UnityEngine.PhysicsMaterial;
using PhysicMaterialCombine = UnityEngine.PhysicsMaterialCombine;
#endif

namespace Armcell
{
    /// <summary>Keeps what a scene refers to, so that it is there when the scene is opened again.</summary>
    public interface IKeepAssets
    {
        void Keep(Object asset, string name);
    }

    /// <summary>Colliders and looks of shapes, each a child of its own.</summary>
    public class ShapeBuilder
    {
        const float k_PlaneExtent = 100f; // [m]

        readonly string m_Folder;
        readonly IKeepAssets m_Keep;
        readonly Dictionary<string, Mesh> m_Meshes = new Dictionary<string, Mesh>();
        readonly Dictionary<string, Material> m_Materials = new Dictionary<string, Material>();
        readonly Dictionary<string, PhysicMaterial> m_Frictions = new Dictionary<string, PhysicMaterial>();

        public ShapeBuilder(string folder, IKeepAssets keep)
        {
            m_Folder = folder;
            m_Keep = keep;
        }

        public void AddVisual(Transform link, UrdfGeometry shape)
        {
            GameObject made = Child(link, "visual", shape.pose);
            Show(made, MeshOf(shape.type, shape.size, shape.radius, shape.length, shape.file), shape.color);
        }

        public void AddCollider(Transform link, UrdfGeometry shape)
        {
            GameObject made = Child(link, "collision", shape.pose);
            Collide(made, shape.type, shape.size, shape.radius, shape.length, shape.file, FrictionOf(0.0, 0.0));
        }

        /// <summary>Adds a shape of an object. A fixed object has no friction of its own: that of a movable object
        /// which touches it decides.</summary>
        public void Add(Transform item, ShapeData shape, ObjectData of)
        {
            GameObject made = Child(item, shape.type, shape.pose);
            Show(made, MeshOf(shape.type, shape.size, shape.radius, shape.length, shape.visual), of.color);
            PhysicMaterial friction = of.movable
                ? FrictionOf(of.staticFriction, of.dynamicFriction) : FrictionOf(0.0, 0.0);
            if (shape.type != "mesh")
                Collide(made, shape.type, shape.size, shape.radius, shape.length, null, friction);
            foreach (string hull in shape.hulls)
                Collide(made, "mesh", shape.size, shape.radius, shape.length, hull, friction);
        }

        static GameObject Child(Transform parent, string name, PoseData pose)
        {
            GameObject made = new GameObject(name);
            made.transform.SetParent(parent, false);
            Ros.Place(made.transform, pose);
            return made;
        }

        void Show(GameObject made, Mesh mesh, double[] color)
        {
            made.AddComponent<MeshFilter>().sharedMesh = mesh;
            made.AddComponent<MeshRenderer>().sharedMaterial = MaterialOf(color ?? new[] { 0.75, 0.75, 0.77, 1.0 });
        }

        void Collide(
            GameObject made, string type, Vec3 size, double radius, double length, string file,
            PhysicMaterial friction)
        {
            Collider collider;
            if (type == "box")
            {
                BoxCollider box = made.AddComponent<BoxCollider>();
                box.size = Ros.ToVector3(Axes.SizeToUnity(size));
                collider = box;
            }
            else if (type == "plane")
            {
                BoxCollider box = made.AddComponent<BoxCollider>();
                box.size = new Vector3(k_PlaneExtent, 1f, k_PlaneExtent);
                box.center = new Vector3(0f, -0.5f, 0f);
                collider = box;
            }
            else if (type == "sphere")
            {
                SphereCollider sphere = made.AddComponent<SphereCollider>();
                sphere.radius = (float)radius;
                collider = sphere;
            }
            else if (type == "capsule")
            {
                CapsuleCollider capsule = made.AddComponent<CapsuleCollider>();
                capsule.direction = 1; // ROS's z is Unity's y
                capsule.radius = (float)radius;
                capsule.height = (float)(length + 2.0 * radius);
                collider = capsule;
            }
            else
            {
                MeshCollider hull = made.AddComponent<MeshCollider>();
                hull.convex = true;
                hull.sharedMesh = MeshOf(type, size, radius, length, file);
                collider = hull;
            }
            collider.sharedMaterial = friction;
        }

        Mesh MeshOf(string type, Vec3 size, double radius, double length, string file)
        {
            string key = type == "mesh" ? file : type + " " + Words.G(size.x) + " " + Words.G(size.y) + " "
                + Words.G(size.z) + " " + Words.G(radius) + " " + Words.G(length);
            Mesh mesh;
            if (m_Meshes.TryGetValue(key, out mesh)) return mesh;
            mesh = ToMesh(TrianglesOf(type, size, radius, length, file), key);
            m_Meshes.Add(key, mesh);
            if (m_Keep != null) m_Keep.Keep(mesh, key);
            return mesh;
        }

        Triangles TrianglesOf(string type, Vec3 size, double radius, double length, string file)
        {
            switch (type)
            {
                case "box": return Solids.Box(size);
                case "plane": return Solids.Box(new Vec3(k_PlaneExtent, k_PlaneExtent, 1e-4));
                case "sphere": return Solids.Sphere(radius);
                case "cylinder": return Solids.Cylinder(radius, length);
                case "capsule": return Solids.Capsule(radius, length);
                case "cone": return Solids.Cone(radius, length);
                case "mesh": return Solids.ReadStl(File.ReadAllBytes(Path.Combine(m_Folder, file)));
                default: throw new System.FormatException("unknown shape '" + type + "'");
            }
        }

        /// <summary>In Unity's axes. It draws triangles that run clockwise: the order of corners is turned.</summary>
        static Mesh ToMesh(Triangles triangles, string name)
        {
            Mesh mesh = new Mesh();
            mesh.name = name;
            if (triangles.corners.Count > 65000) mesh.indexFormat = IndexFormat.UInt32;
            mesh.vertices = triangles.corners.Select(c => Ros.ToVector3(Axes.ToUnity(c))).ToArray();
            mesh.normals = triangles.normals.Select(n => Ros.ToVector3(Axes.ToUnity(n))).ToArray();
            int[] indices = triangles.indices.ToArray();
            for (int i = 0; i < indices.Length; i += 3)
            {
                int second = indices[i + 1];
                indices[i + 1] = indices[i + 2];
                indices[i + 2] = second;
            }
            mesh.triangles = indices;
            mesh.RecalculateBounds();
            return mesh;
        }

        Material MaterialOf(double[] rgba)
        {
            string key = "color " + string.Join(" ", rgba.Select(c => Words.G(c, 3)).ToArray());
            Material material;
            if (m_Materials.TryGetValue(key, out material)) return material;
            RenderPipelineAsset pipeline = GraphicsSettings.currentRenderPipeline;
            material = new Material(pipeline == null ? Shader.Find("Standard") : pipeline.defaultShader);
            material.name = key;
            material.color = new Color((float)rgba[0], (float)rgba[1], (float)rgba[2], (float)rgba[3]);
            m_Materials.Add(key, material);
            if (m_Keep != null) m_Keep.Keep(material, key);
            return material;
        }

        /// <summary>The larger coefficient of a pair counts, and only movable objects have one: theirs decides.</summary>
        PhysicMaterial FrictionOf(double staticFriction, double dynamicFriction)
        {
            string key = "friction " + Words.G(staticFriction, 4) + " " + Words.G(dynamicFriction, 4);
            PhysicMaterial material;
            if (m_Frictions.TryGetValue(key, out material)) return material;
            material = new PhysicMaterial(key);
            material.staticFriction = (float)staticFriction;
            material.dynamicFriction = (float)dynamicFriction;
            material.bounciness = 0f;
            material.frictionCombine = PhysicMaterialCombine.Maximum;
            m_Frictions.Add(key, material);
            if (m_Keep != null) m_Keep.Keep(material, key);
            return material;
        }
    }
}
