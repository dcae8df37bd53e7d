using System;
using System.Collections.Generic;
using System.Linq;

namespace Armcell.Logic
{
    public enum JointKind { Revolute, Continuous, Prismatic }

    /// <summary>What a joint is. Positions are radians, of prismatic joints metres.</summary>
    [Serializable]
    public class JointSpec
    {
        public string name = "";
        public JointKind kind;
        public double lower = double.NegativeInfinity;
        public double upper = double.PositiveInfinity;
        /// <summary>The joint it follows; empty for a joint that is driven itself.</summary>
        public string mimic = "";
        public double multiplier = 1.0;
        public double offset;
        /// <summary>Belongs to a gripper: blocked by what it holds, it has not failed.</summary>
        public bool finger;
        /// <summary>Position at the start.</summary>
        public double start;

        public bool Follows
        {
            get { return !string.IsNullOrEmpty(mimic); }
        }

        /// <summary>As ArticulationBody.xDrive wants it: degrees, of prismatic joints metres.</summary>
        public double ToDrive(double value)
        {
            return kind == JointKind.Prismatic ? value : value * (180.0 / Math.PI);
        }

        public double FromDrive(double value)
        {
            return kind == JointKind.Prismatic ? value : value * (Math.PI / 180.0);
        }
    }

    /// <summary>The joints of a robot by name; those that follow others are not commanded by name.</summary>
    public class JointTable
    {
        const double k_Margin = 1e-4; // [rad or m] beyond a limit that is still taken

        readonly Dictionary<string, JointSpec> m_ByName = new Dictionary<string, JointSpec>();
        readonly string[] m_Driven;

        public JointTable(IEnumerable<JointSpec> joints)
        {
            foreach (JointSpec joint in joints)
            {
                if (m_ByName.ContainsKey(joint.name))
                    throw new RefusedException("joint '" + joint.name + "' is named twice");
                m_ByName.Add(joint.name, joint);
            }
            m_Driven = m_ByName.Values.Where(j => !j.Follows).Select(j => j.name).ToArray();
            foreach (JointSpec joint in m_ByName.Values)
                Source(joint);
        }

        /// <summary>Joints that are driven themselves, in the robot's order.</summary>
        public string[] Driven
        {
            get { return m_Driven; }
        }

        public JointSpec this[string name]
        {
            get
            {
                JointSpec joint;
                if (m_ByName.TryGetValue(name, out joint)) return joint;
                throw new RefusedException("unknown joint '" + name + "'; known: " + Known());
            }
        }

        /// <summary>Refuses names that are unknown, follow others, or come twice.</summary>
        public void CheckNames(string[] names)
        {
            foreach (string name in names)
            {
                if (!m_Driven.Contains(name))
                    throw new RefusedException("unknown joint '" + name + "'; known: " + Known());
            }
            foreach (string name in names)
            {
                if (names.Count(n => n == name) > 1)
                    throw new RefusedException("joint '" + name + "' is named twice");
            }
        }

        public void CheckLimits(string[] names, double[] q)
        {
            for (int i = 0; i < names.Length; i++)
            {
                JointSpec joint = this[names[i]];
                if (q[i] < joint.lower - k_Margin || q[i] > joint.upper + k_Margin)
                    throw new RefusedException("joint '" + names[i] + "' at " + Words.G(q[i], 4)
                        + " is outside its limits [" + Words.G(joint.lower, 4) + ", " + Words.G(joint.upper, 4) + "]");
            }
        }

        /// <summary>Where a joint that follows another belongs when that one is at q (speeds: no offset).</summary>
        public double Followed(JointSpec joint, double q, bool isSpeed = false)
        {
            return joint.multiplier * q + (isSpeed ? 0.0 : joint.offset);
        }

        /// <summary>The joints that follow a driven one, those that follow followers included, with what they
        /// multiply and add.</summary>
        public IEnumerable<JointSpec> Followers(string driven)
        {
            return m_ByName.Values.Where(j => j.Follows && Source(j) == driven);
        }

        /// <summary>The driven joint that a joint follows in the end.</summary>
        public string Source(JointSpec joint)
        {
            for (int hops = 0; hops <= m_ByName.Count; hops++)
            {
                if (!joint.Follows) return joint.name;
                JointSpec next;
                if (!m_ByName.TryGetValue(joint.mimic, out next))
                    throw new RefusedException("joint '" + joint.name + "' mimics unknown joint '" + joint.mimic + "'");
                joint = next;
            }
            throw new RefusedException("joint '" + joint.name + "' mimics itself");
        }

        string Known()
        {
            IEnumerable<string> sorted = m_Driven.OrderBy(n => n, StringComparer.Ordinal);
            return string.Join(", ", sorted.Take(30).ToArray()) + (m_Driven.Length > 30 ? ", ..." : "");
        }
    }

    /// <summary>Counts the turns of a joint whose reading may jump by whole turns.</summary>
    public class AngleTracker
    {
        double m_Last;
        bool m_Known;

        /// <summary>Whole turns [rad] that the last value is beyond the last reading.</summary>
        public double Turns { get; private set; }

        /// <summary>The value next to the last one that is the reading up to whole turns [rad].</summary>
        public double Track(double reading)
        {
            Turns = m_Known ? Nearest(reading, m_Last) - reading : 0.0;
            m_Known = true;
            m_Last = reading + Turns;
            return m_Last;
        }

        /// <summary>The angle [rad] that is `angle` up to whole turns and nearest to `to`.</summary>
        public static double Nearest(double angle, double to)
        {
            return angle + 2.0 * Math.PI * Math.Round((to - angle) / (2.0 * Math.PI));
        }
    }
}
