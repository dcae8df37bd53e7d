using System;
using System.Collections.Generic;
using System.IO;

namespace Armcell.Logic
{
    /// <summary>Triangles with a normal per corner, in ROS's axes; corners of a triangle run anticlockwise seen
    /// from outside.</summary>
    public class Triangles
    {
        public readonly List<Vec3> corners = new List<Vec3>();
        public readonly List<Vec3> normals = new List<Vec3>();
        public readonly List<int> indices = new List<int>();

        public void Add(Vec3 corner, Vec3 normal)
        {
            corners.Add(corner);
            normals.Add(normal);
        }
    }

    /// <summary>Solids as triangles. Each is centred on its own frame; axes are along z.</summary>
    public static class Solids
    {
        const int k_Sides = 32;

        public static Triangles Box(Vec3 size)
        {
            Triangles found = new Triangles();
            for (int axis = 0; axis < 3; axis++)
            {
                foreach (int side in new[] { 1, -1 })
                {
                    double[] n = new double[3];
                    n[axis] = side;
                    int u = (axis + 1) % 3, v = (axis + 2) % 3, first = found.corners.Count;
                    foreach (int[] at in new[] { new[] { -1, -1 }, new[] { 1, -1 }, new[] { 1, 1 }, new[] { -1, 1 } })
                    {
                        double[] p = new double[3];
                        p[axis] = side;
                        p[u] = at[0];
                        p[v] = at[1];
                        found.Add(new Vec3(p[0] * size.x / 2, p[1] * size.y / 2, p[2] * size.z / 2),
                            new Vec3(n[0], n[1], n[2]));
                    }
                    int[] order = side > 0 ? new[] { 0, 1, 2, 0, 2, 3 } : new[] { 0, 2, 1, 0, 3, 2 };
                    foreach (int i in order) found.indices.Add(first + i);
                }
            }
            return found;
        }

        public static Triangles Cylinder(double radius, double length)
        {
            return Lathe(new[] { new[] { 0, -length / 2 }, new[] { radius, -length / 2 }, new[] { radius, length / 2 },
                new[] { 0, length / 2 } }, false);
        }

        public static Triangles Cone(double radius, double length)
        {
            return Lathe(new[] { new[] { 0, -length / 2 }, new[] { radius, -length / 2 }, new[] { 0, length / 2 } },
                false);
        }

        public static Triangles Sphere(double radius)
        {
            return Capsule(radius, 0.0);
        }

        /// <param name="length">of the cylindrical part</param>
        public static Triangles Capsule(double radius, double length)
        {
            List<double[]> outline = new List<double[]>();
            for (int i = 0; i <= k_Sides; i++)
            {
                double angle = Math.PI * (i / (double)k_Sides - 0.5);
                double up = i * 2 < k_Sides ? -length / 2 : length / 2;
                if (i * 2 == k_Sides && length > 0) outline.Add(new[] { radius, -length / 2 });
                outline.Add(new[] { radius * Math.Cos(angle), up + radius * Math.Sin(angle) });
            }
            return Lathe(outline.ToArray(), true);
        }

        /// <summary>An outline of (radius, height), from below upwards, turned about z.</summary>
        static Triangles Lathe(double[][] outline, bool round)
        {
            Triangles found = new Triangles();
            for (int k = 0; k + 1 < outline.Length; k++)
            {
                double[] low = outline[k], high = outline[k + 1];
                double nr = high[1] - low[1], nz = low[0] - high[0];
                double size = Math.Sqrt(nr * nr + nz * nz);
                if (size < 1e-12) continue;
                int first = found.corners.Count;
                for (int i = 0; i <= k_Sides; i++)
                {
                    double c = Math.Cos(2 * Math.PI * i / k_Sides), s = Math.Sin(2 * Math.PI * i / k_Sides);
                    foreach (double[] at in new[] { low, high })
                        found.Add(new Vec3(at[0] * c, at[0] * s, at[1]),
                            new Vec3(nr / size * c, nr / size * s, nz / size));
                }
                for (int i = 0; i < k_Sides; i++)
                {
                    int a = first + 2 * i; // low, high, next low, next high
                    if (low[0] > 1e-12) found.indices.AddRange(new[] { a, a + 2, a + 1 });
                    if (high[0] > 1e-12) found.indices.AddRange(new[] { a + 1, a + 2, a + 3 });
                }
            }
            if (round) Smooth(found, Math.PI);
            return found;
        }

        /// <summary>A binary STL file's triangles; edges flatter than 40 degrees are drawn smooth.</summary>
        /// <exception cref="FormatException">it is no binary STL</exception>
        public static Triangles ReadStl(byte[] data)
        {
            const int head = 84, row = 50;
            if (data.Length < head || data.Length != head + (long)BitConverter.ToUInt32(data, 80) * row)
                throw new FormatException("not a binary STL file");
            Triangles found = new Triangles();
            using (BinaryReader reader = new BinaryReader(new MemoryStream(data)))
            {
                reader.ReadBytes(head);
                for (int count = (data.Length - head) / row; count > 0; count--)
                {
                    Read(reader); // the normal: made anew from the corners
                    Vec3 a = Read(reader), b = Read(reader), c = Read(reader);
                    reader.ReadUInt16();
                    Vec3 n = Normal(a, b, c);
                    foreach (Vec3 corner in new[] { a, b, c })
                    {
                        found.indices.Add(found.corners.Count);
                        found.Add(corner, n);
                    }
                }
            }
            Smooth(found, 40.0 * Math.PI / 180.0);
            return found;
        }

        static Vec3 Read(BinaryReader reader)
        {
            float x = reader.ReadSingle(), y = reader.ReadSingle(), z = reader.ReadSingle();
            return new Vec3(x, y, z);
        }

        static Vec3 Normal(Vec3 a, Vec3 b, Vec3 c)
        {
            double ux = b.x - a.x, uy = b.y - a.y, uz = b.z - a.z, vx = c.x - a.x, vy = c.y - a.y, vz = c.z - a.z;
            return Unit(new Vec3(uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx));
        }

        static Vec3 Unit(Vec3 v)
        {
            double size = Math.Sqrt(v.x * v.x + v.y * v.y + v.z * v.z);
            return size > 0 ? new Vec3(v.x / size, v.y / size, v.z / size) : v;
        }

        /// <summary>Each corner's normal becomes the mean of those at its place that are turned by less.</summary>
        static void Smooth(Triangles mesh, double crease)
        {
            Dictionary<Vec3, List<int>> at = new Dictionary<Vec3, List<int>>();
            for (int i = 0; i < mesh.corners.Count; i++)
            {
                Vec3 p = mesh.corners[i];
                Vec3 key = new Vec3(Math.Round(p.x, 6), Math.Round(p.y, 6), Math.Round(p.z, 6));
                List<int> here;
                if (!at.TryGetValue(key, out here)) at.Add(key, here = new List<int>());
                here.Add(i);
            }
            Vec3[] before = mesh.normals.ToArray();
            double least = Math.Cos(crease) - 1e-9;
            foreach (List<int> here in at.Values)
            {
                foreach (int i in here)
                {
                    double x = 0, y = 0, z = 0;
                    foreach (int j in here)
                    {
                        Vec3 n = before[j];
                        if (n.x * before[i].x + n.y * before[i].y + n.z * before[i].z < least) continue;
                        x += n.x;
                        y += n.y;
                        z += n.z;
                    }
                    mesh.normals[i] = Unit(new Vec3(x, y, z));
                }
            }
        }
    }
}
