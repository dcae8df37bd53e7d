using System;
using System.Collections.Generic;
using System.Globalization;
using System.IO;
using System.Linq;
using System.Xml;

namespace Armcell.Logic
{
    public class UrdfGeometry
    {
        public PoseData pose; // in the link
        public string type; // box, sphere, cylinder, mesh
        public Vec3 size; // [m]
        public double radius, length; // [m]
        public string file; // of a mesh, from the URDF's folder
        public double[] color; // RGBA 0 to 1; null: not given
    }

    public class UrdfLink
    {
        public string name;
        public double mass; // [kg]
        public PoseData centre; // of mass, along the principal axes
        public Vec3 moments; // [kg m^2] about them
        public List<UrdfGeometry> visuals = new List<UrdfGeometry>();
        public List<UrdfGeometry> collisions = new List<UrdfGeometry>();
    }

    public class UrdfJoint
    {
        public string name, type, parent, child;
        public PoseData origin;
        public Vec3 axis = new Vec3(1, 0, 0);
        public double lower, upper, velocity, effort; // infinite where not given
        public string mimic = "";
        public double multiplier = 1.0, offset;

        public bool IsMovable
        {
            get { return type != "fixed"; }
        }

        public JointSpec Spec()
        {
            return new JointSpec
            {
                name = name,
                kind = type == "prismatic" ? JointKind.Prismatic
                    : type == "continuous" ? JointKind.Continuous : JointKind.Revolute,
                lower = lower, upper = upper, mimic = mimic, multiplier = multiplier, offset = offset
            };
        }
    }

    /// <summary>A robot from a flattened URDF, as armcell writes it: inertias in principal axes, no mesh scale.</summary>
    public class Urdf
    {
        public string name;
        public readonly Dictionary<string, UrdfLink> links = new Dictionary<string, UrdfLink>();
        public readonly List<UrdfJoint> joints = new List<UrdfJoint>();

        public UrdfLink Root
        {
            get { return links.Values.First(l => joints.All(j => j.child != l.name)); }
        }

        /// <exception cref="FormatException">what is wrong with it</exception>
        public static Urdf Read(string text)
        {
            XmlDocument document = new XmlDocument();
            document.XmlResolver = null;
            XmlReaderSettings settings = new XmlReaderSettings();
            settings.DtdProcessing = DtdProcessing.Prohibit;
            try
            {
                using (XmlReader reader = XmlReader.Create(new StringReader(text), settings)) document.Load(reader);
            }
            catch (XmlException error)
            {
                throw new FormatException("URDF: " + error.Message);
            }
            Urdf robot = new Urdf();
            robot.name = document.DocumentElement.GetAttribute("name");
            foreach (XmlElement element in document.DocumentElement.SelectNodes("link"))
            {
                UrdfLink link = Link(element);
                robot.links.Add(link.name, link);
            }
            foreach (XmlElement element in document.DocumentElement.SelectNodes("joint"))
            {
                UrdfJoint joint = Joint(element);
                foreach (string end in new[] { joint.parent, joint.child })
                    if (!robot.links.ContainsKey(end))
                        throw new FormatException("URDF: joint '" + joint.name + "' has unknown link '" + end + "'");
                robot.joints.Add(joint);
            }
            if (robot.links.Count == 0) throw new FormatException("URDF: it has no links");
            return robot;
        }

        static UrdfLink Link(XmlElement element)
        {
            UrdfLink link = new UrdfLink { name = element.GetAttribute("name") };
            XmlElement inertial = Child(element, "inertial");
            if (inertial != null)
            {
                XmlElement inertia = Child(inertial, "inertia");
                link.mass = Number(Child(inertial, "mass"), "value", 0);
                link.centre = Origin(inertial);
                link.moments = new Vec3(
                    Number(inertia, "ixx", 0), Number(inertia, "iyy", 0), Number(inertia, "izz", 0));
            }
            foreach (XmlElement visual in element.SelectNodes("visual")) link.visuals.Add(Geometry(visual));
            foreach (XmlElement collision in element.SelectNodes("collision"))
                link.collisions.Add(Geometry(collision));
            return link;
        }

        static UrdfGeometry Geometry(XmlElement element)
        {
            UrdfGeometry found = new UrdfGeometry { pose = Origin(element) };
            XmlElement geometry = Child(element, "geometry");
            XmlElement shape = geometry == null ? null : geometry.ChildNodes.OfType<XmlElement>().FirstOrDefault();
            if (shape == null) throw new FormatException("URDF: a <" + element.Name + "> has no geometry");
            found.type = shape.Name;
            found.radius = Number(shape, "radius", 0);
            found.length = Number(shape, "length", 0);
            found.file = shape.GetAttribute("filename");
            if (shape.Name == "box") found.size = Vector(shape, "size", "0 0 0");
            XmlElement color = (XmlElement)element.SelectSingleNode("material/color");
            if (color != null) found.color = Numbers(color, "rgba", "1 1 1 1", 4);
            return found;
        }

        static UrdfJoint Joint(XmlElement element)
        {
            UrdfJoint joint = new UrdfJoint
            {
                name = element.GetAttribute("name"),
                type = element.GetAttribute("type"),
                parent = Required(element, "parent").GetAttribute("link"),
                child = Required(element, "child").GetAttribute("link"),
                origin = Origin(element)
            };
            if (!new[] { "revolute", "continuous", "prismatic", "fixed" }.Contains(joint.type))
                throw new FormatException("URDF: joint '" + joint.name + "' is of type '" + joint.type
                    + "': export it with armcell, which makes single joints of it");
            XmlElement axis = Child(element, "axis"), limit = Child(element, "limit"), mimic = Child(element, "mimic");
            if (axis != null) joint.axis = Vector(axis, "xyz", "1 0 0");
            bool bounded = joint.type == "revolute" || joint.type == "prismatic";
            joint.lower = bounded ? Number(limit, "lower", double.NegativeInfinity) : double.NegativeInfinity;
            joint.upper = bounded ? Number(limit, "upper", double.PositiveInfinity) : double.PositiveInfinity;
            joint.velocity = Number(limit, "velocity", double.PositiveInfinity);
            joint.effort = Number(limit, "effort", double.PositiveInfinity);
            if (mimic != null)
            {
                joint.mimic = mimic.GetAttribute("joint");
                joint.multiplier = Number(mimic, "multiplier", 1);
                joint.offset = Number(mimic, "offset", 0);
            }
            return joint;
        }

        static PoseData Origin(XmlElement element)
        {
            XmlElement origin = Child(element, "origin");
            if (origin == null) return new PoseData { rotation = new Quat(0, 0, 0, 1) };
            Vec3 rpy = Vector(origin, "rpy", "0 0 0");
            return new PoseData
            {
                position = Vector(origin, "xyz", "0 0 0"), rotation = Quat.FromRpy(rpy.x, rpy.y, rpy.z)
            };
        }

        static XmlElement Child(XmlElement element, string name)
        {
            return element.ChildNodes.OfType<XmlElement>().FirstOrDefault(c => c.Name == name);
        }

        static XmlElement Required(XmlElement element, string name)
        {
            XmlElement child = Child(element, name);
            if (child != null) return child;
            throw new FormatException("URDF: <" + element.Name + " '" + element.GetAttribute("name") + "'> has no <" + name + ">");
        }

        static Vec3 Vector(XmlElement element, string name, string otherwise)
        {
            double[] v = Numbers(element, name, otherwise, 3);
            return new Vec3(v[0], v[1], v[2]);
        }

        static double Number(XmlElement element, string name, double otherwise)
        {
            if (element == null || !element.HasAttribute(name)) return otherwise;
            return Numbers(element, name, "", 1)[0];
        }

        static double[] Numbers(XmlElement element, string name, string otherwise, int count)
        {
            string text = element.HasAttribute(name) ? element.GetAttribute(name) : otherwise;
            string[] parts = text.Split(new[] { ' ', '\t', '\n' }, StringSplitOptions.RemoveEmptyEntries);
            double[] found = new double[parts.Length];
            bool good = parts.Length == count;
            for (int i = 0; good && i < count; i++)
                good = double.TryParse(parts[i], NumberStyles.Float, CultureInfo.InvariantCulture, out found[i]);
            if (good) return found;
            throw new FormatException("URDF: " + name + "=\"" + text + "\" of <" + element.Name + "> must be " + count
                + " number(s)");
        }
    }
}
