using System;
using System.Collections.Generic;
using System.Linq;

namespace Armcell.Logic
{
    /// <summary>
    /// Plays trajectories as armcell's own simulator does, and says the same words about them: a newer
    /// trajectory of the same joints takes over, one without points stops, those of other joints run beside.
    /// </summary>
    public class Executor
    {
        readonly JointTable m_Table;
        readonly IJoints m_Joints;
        readonly ExecutionSettings m_Settings;
        readonly Action<string> m_Say;
        readonly List<Motion> m_Motions = new List<Motion>();
        readonly Queue<TrajectoryPoints> m_Waiting = new Queue<TrajectoryPoints>();

        /// <summary>Moves a finger joint to a position and says how that ended; null: fingers are joints like
        /// others.</summary>
        public Action<string, double, Action<string>> Fingers;

        /// <param name="say">told of every trajectory: executing, done, stopped, failed, refused</param>
        public Executor(JointTable table, IJoints joints, ExecutionSettings settings, Action<string> say)
        {
            m_Table = table;
            m_Joints = joints;
            m_Settings = settings;
            m_Say = say;
        }

        public bool IsMoving
        {
            get { return m_Motions.Count > 0 || m_Waiting.Count > 0; }
        }

        /// <summary>Check a trajectory; it begins with the next step.</summary>
        public void Take(TrajectoryPoints points)
        {
            try
            {
                points.Checked(m_Table, m_Joints.Position, m_Joints.Velocity);
                m_Waiting.Enqueue(points);
            }
            catch (RefusedException error)
            {
                m_Say("refused: " + error.Message);
            }
        }

        /// <summary>One period of physics [s], before it is simulated.</summary>
        public void Step(double now, double period)
        {
            while (m_Waiting.Count > 0) Begin(m_Waiting.Dequeue(), now);
            foreach (Motion motion in m_Motions.ToArray())
            {
                motion.Step(now, period);
                if (motion.Outcome != null) End(motion);
            }
        }

        /// <summary>Stop everything where it is.</summary>
        public void Stop(double now)
        {
            m_Waiting.Clear();
            Cancel(m_Table.Driven, now);
        }

        void Begin(TrajectoryPoints points, double now)
        {
            if (points.times.Length == 0)
            {
                Halt(points.names.Length == 0 ? m_Table.Driven : points.names, now);
                return;
            }
            JointTrajectory trajectory;
            try
            {
                // Where it is now decides, not where it was when the message came.
                trajectory = points.Checked(m_Table, m_Joints.Position, m_Joints.Velocity);
            }
            catch (RefusedException error)
            {
                m_Say("refused: " + error.Message);
                return;
            }
            bool fingers = Fingers != null && trajectory.names.All(n => m_Table[n].finger);
            Motion motion = fingers ? null : new Motion(trajectory, m_Joints, m_Settings, now); // as it moves still
            Cancel(points.names, now);
            if (motion != null && motion.Outcome != null) // it failed at its start
            {
                m_Say(motion.Outcome);
                return;
            }
            m_Say("executing " + trajectory.times.Length + " points, " + Words.F(trajectory.Duration, 2) + " s");
            if (fingers)
            {
                Close(trajectory);
                return;
            }
            m_Motions.Add(motion);
        }

        void Halt(string[] names, double now)
        {
            Cancel(names, now);
            m_Say("stop");
            foreach (string name in names)
                if (!m_Table[name].finger) m_Joints.Command(name, m_Joints.Position(name), 0.0);
            m_Say("done: empty trajectory: stopped");
        }

        /// <summary>Fingers that meet something before they are where they should be hold it: that is no failure.</summary>
        void Close(JointTrajectory trajectory)
        {
            double[] end = trajectory.positions[trajectory.positions.Length - 1];
            for (int j = 0; j < end.Length; j++)
                Fingers(trajectory.names[j], end[j], j == end.Length - 1 ? m_Say : text => { });
        }

        void Cancel(string[] joints, double now)
        {
            foreach (Motion motion in m_Motions.Where(m => m.trajectory.names.Intersect(joints).Any()).ToArray())
            {
                motion.Cancel(now);
                End(motion);
            }
        }

        void End(Motion motion)
        {
            m_Motions.Remove(motion);
            m_Say(motion.Outcome);
        }
    }
}
