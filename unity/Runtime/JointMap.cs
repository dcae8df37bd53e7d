using System;
using System.Collections.Generic;
using Armcell.Logic;
using UnityEngine;

namespace Armcell
{
    /// <summary>
    /// The robot's joints by their URDF names. Positions are radians or metres here; ArticulationBody's drives
    /// want degrees. Joints that follow others (URDF's mimic) are driven along with them.
    /// </summary>
    [DefaultExecutionOrder(-200)]
    [AddComponentMenu("armcell/Joint Map")]
    public class JointMap : MonoBehaviour, IJoints
    {
        [Serializable]
        public class MappedJoint
        {
            public JointSpec spec = new JointSpec();
            public ArticulationBody body;
            [NonSerialized] public AngleTracker tracker;
        }

        public MappedJoint[] joints = new MappedJoint[0];

        readonly Dictionary<string, MappedJoint> m_ByName = new Dictionary<string, MappedJoint>();
        readonly Dictionary<string, List<MappedJoint>> m_Followers = new Dictionary<string, List<MappedJoint>>();
        readonly Dictionary<string, Action<double>> m_Takers = new Dictionary<string, Action<double>>();

        public JointTable Table { get; private set; }

        void Awake()
        {
            List<JointSpec> specs = new List<JointSpec>();
            foreach (MappedJoint joint in joints)
            {
                joint.tracker = new AngleTracker();
                specs.Add(joint.spec);
                m_ByName[joint.spec.name] = joint;
            }
            Table = new JointTable(specs);
            foreach (string name in Table.Driven)
            {
                List<MappedJoint> followers = new List<MappedJoint>();
                foreach (JointSpec spec in Table.Followers(name)) followers.Add(m_ByName[spec.name]);
                m_Followers[name] = followers;
            }
        }

        /// <summary>The robot stands where the cell says, at once and not by its drives.</summary>
        void Start()
        {
            foreach (string name in Table.Driven)
            {
                double start = m_ByName[name].spec.start;
                Put(m_ByName[name], start);
                foreach (MappedJoint follower in m_Followers[name]) Put(follower, Follow(name, follower, start, false));
                Lead(name, start, 0.0);
            }
        }

        public double Position(string name)
        {
            MappedJoint joint = Find(name);
            ArticulationReducedSpace q = joint.body.jointPosition;
            double value = q.dofCount > 0 ? q[0] : joint.spec.start;
            return joint.spec.kind == JointKind.Continuous ? joint.tracker.Track(value) : value;
        }

        public double Velocity(string name)
        {
            ArticulationReducedSpace v = Find(name).body.jointVelocity;
            return v.dofCount > 0 ? v[0] : 0.0;
        }

#if UNITY_2022_2_OR_NEWER
        /// <summary>What its drive presses with [Nm or N]. Older Unitys do not tell.</summary>
        public double Effort(string name)
        {
            ArticulationReducedSpace force = Find(name).body.driveForce;
            return force.dofCount > 0 ? force[0] : 0.0;
        }
#endif

        /// <summary>Lead a joint to a position with a velocity; a gripper's by way of its controller.</summary>
        public void Command(string name, double q, double v)
        {
            Action<double> taker;
            if (m_Takers.TryGetValue(name, out taker)) taker(q);
            else Lead(name, q, v);
        }

        /// <summary>Let somebody else do what a joint is commanded: a gripper knows more than its joint.</summary>
        public void Redirect(string name, Action<double> taker)
        {
            m_Takers[name] = taker;
        }

        /// <summary>Lead a joint's drive, and those of the joints that follow it.</summary>
        public void Lead(string name, double q, double v)
        {
            MappedJoint joint = Find(name);
            Drive(joint, q, v);
            foreach (MappedJoint follower in m_Followers[name])
                Drive(follower, Follow(name, follower, q, false), Follow(name, follower, v, true));
        }

        /// <summary>The largest force [N] or torque [Nm] of a joint and of those that follow it.</summary>
        public void LimitForce(string name, double force)
        {
            SetForce(Find(name).body, force);
            foreach (MappedJoint follower in m_Followers[name]) SetForce(follower.body, force);
        }

        MappedJoint Find(string name)
        {
            MappedJoint joint;
            if (m_ByName.TryGetValue(name, out joint)) return joint;
            throw new RefusedException("unknown joint '" + name + "'");
        }

        /// <summary>A follower's position or speed. It may follow one that follows.</summary>
        double Follow(string driven, MappedJoint follower, double value, bool isSpeed)
        {
            JointSpec spec = follower.spec;
            if (spec.mimic != driven) value = Follow(driven, m_ByName[spec.mimic], value, isSpeed);
            return Table.Followed(spec, value, isSpeed);
        }

        static void Drive(MappedJoint joint, double q, double v)
        {
            ArticulationDrive drive = joint.body.xDrive;
            drive.target = (float)joint.spec.ToDrive(q - joint.tracker.Turns);
            drive.targetVelocity = (float)joint.spec.ToDrive(v);
            joint.body.xDrive = drive;
        }

        static void SetForce(ArticulationBody body, double force)
        {
            ArticulationDrive drive = body.xDrive;
            drive.forceLimit = (float)force;
            body.xDrive = drive;
        }

        static void Put(MappedJoint joint, double q)
        {
            joint.body.jointPosition = new ArticulationReducedSpace((float)q);
            joint.body.jointVelocity = new ArticulationReducedSpace(0f);
        }
    }
}
