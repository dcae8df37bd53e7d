using System;

namespace Armcell.Logic
{
    /// <summary>Tolerances of a motion, as armcell's executor has them.</summary>
    [Serializable]
    public class ExecutionSettings
    {
        public double startTolerance = 0.01; // [rad or m] measured start against the trajectory's
        public double pathTolerance = 0.1; // [rad or m] tracking error that aborts
        public double goalTolerance = 0.005; // [rad or m]
        public double goalSpeed = 0.02; // [rad/s or m/s] below which the arm counts as at rest
        public double settleTime = 1.0; // [s] to reach the goal after the trajectory's end
        public double blendTime = 0.2; // [s] in which a difference at the start fades out
    }

    /// <summary>Where joints are, and what moves them. Indices are those of the driven joints.</summary>
    public interface IJoints
    {
        double Position(string name);
        double Velocity(string name);
        void Command(string name, double q, double v);
    }

    /// <summary>One trajectory being played, until it has an outcome.</summary>
    public class Motion
    {
        public readonly JointTrajectory trajectory;
        readonly ExecutionSettings m_Settings;
        readonly IJoints m_Joints;
        readonly double m_Began;
        readonly double[] m_Gap; // what was measured less where the trajectory begins, at the start
        readonly double[] m_GapSpeed;
        readonly double[] m_Q, m_V;
        bool m_Commanded;

        /// <summary>"done: ...", "stopped: ...", "failed: ..." or "refused: ..."; null while it runs.</summary>
        public string Outcome { get; private set; }

        public Motion(JointTrajectory trajectory, IJoints joints, ExecutionSettings settings, double now)
        {
            this.trajectory = trajectory;
            m_Joints = joints;
            m_Settings = settings;
            m_Began = now;
            int n = trajectory.names.Length;
            m_Q = new double[n];
            m_V = new double[n];
            m_Gap = new double[n];
            m_GapSpeed = new double[n];
            for (int j = 0; j < n; j++)
            {
                m_Gap[j] = joints.Position(trajectory.names[j]) - trajectory.positions[0][j];
                double moves = trajectory.velocities == null ? 0.0 : trajectory.velocities[0][j];
                m_GapSpeed[j] = joints.Velocity(trajectory.names[j]) - moves;
            }
            int worst = Worst(m_Gap);
            if (worst >= 0 && Math.Abs(m_Gap[worst]) > settings.startTolerance)
                Outcome = "refused: " + trajectory.names[worst] + " is " + Words.F(Math.Abs(m_Gap[worst]), 3)
                    + " from the trajectory's start (tolerance " + Words.G(settings.startTolerance)
                    + "): the robot moved since it was planned; plan again from the current state";
        }

        /// <summary>Look at what was reached, and command where the joints shall be one period later.</summary>
        public void Step(double now, double period)
        {
            if (Outcome != null) return;
            double t = now - m_Began, duration = trajectory.Duration;
            if (m_Commanded && t < duration + period && LeftPath(t)) return;
            if (t < duration - 1e-9)
            {
                Wanted(Math.Min(t + period, duration));
                Command();
                return;
            }
            Wanted(duration);
            Array.Clear(m_V, 0, m_V.Length);
            Command();
            double[] errors = Errors();
            int worst = Worst(errors);
            double error = worst < 0 ? 0.0 : Math.Abs(errors[worst]);
            double speed = 0.0;
            foreach (string name in trajectory.names) speed = Math.Max(speed, Math.Abs(m_Joints.Velocity(name)));
            if (error <= m_Settings.goalTolerance && speed <= m_Settings.goalSpeed)
                Outcome = "done: final error " + Words.F(error, 4);
            else if (t > duration + m_Settings.settleTime)
                Fail(trajectory.names[Math.Max(worst, 0)] + " ended " + Words.F(error, 4)
                    + " from the goal (tolerance " + Words.G(m_Settings.goalTolerance) + ")");
        }

        /// <summary>Stop here.</summary>
        public void Cancel(double now)
        {
            if (Outcome != null) return;
            double t = now - m_Began;
            Hold();
            Outcome = t < trajectory.Duration - 1e-9
                ? "stopped: cancelled at " + Words.F(t, 2) + " of " + Words.F(trajectory.Duration, 2) + " s"
                : "stopped: cancelled at the goal";
        }

        /// <summary>Positions and velocities the joints shall have at a time [s] of the motion: the trajectory's,
        /// and what is left of the difference there was at the start.</summary>
        void Wanted(double t)
        {
            trajectory.Sample(t, m_Q, m_V);
            double blend = Math.Min(m_Settings.blendTime, trajectory.Duration);
            if (t >= blend) return;
            for (int j = 0; j < m_Q.Length; j++)
            {
                double q, v;
                Curves.Quintic(m_Gap[j], m_GapSpeed[j], 0, 0, 0, 0, blend, t, out q, out v);
                m_Q[j] += q;
                m_V[j] += v;
            }
        }

        bool LeftPath(double t)
        {
            double[] errors = Errors();
            int worst = Worst(errors);
            if (worst < 0 || Math.Abs(errors[worst]) <= m_Settings.pathTolerance) return false;
            Fail(trajectory.names[worst] + " left the path by " + Words.F(Math.Abs(errors[worst]), 3) + " at "
                + Words.F(t, 2) + " s (tolerance " + Words.G(m_Settings.pathTolerance) + ")");
            return true;
        }

        double[] Errors()
        {
            double[] errors = new double[m_Q.Length];
            for (int j = 0; j < errors.Length; j++) errors[j] = m_Joints.Position(trajectory.names[j]) - m_Q[j];
            return errors;
        }

        void Fail(string why)
        {
            Hold();
            Outcome = "failed: " + why;
        }

        void Hold()
        {
            foreach (string name in trajectory.names) m_Joints.Command(name, m_Joints.Position(name), 0.0);
        }

        void Command()
        {
            for (int j = 0; j < m_Q.Length; j++) m_Joints.Command(trajectory.names[j], m_Q[j], m_V[j]);
            m_Commanded = true;
        }

        static int Worst(double[] errors)
        {
            int worst = -1;
            for (int j = 0; j < errors.Length; j++)
                if (worst < 0 || Math.Abs(errors[j]) > Math.Abs(errors[worst])) worst = j;
            return worst;
        }
    }
}
