using System;
using System.Linq;

namespace Armcell.Logic
{
    /// <summary>A trajectory as it came: unchecked. Rows of a point may be null or empty.</summary>
    public class TrajectoryPoints
    {
        const double k_TimeGap = 1e-9; // [s] two points closer than that are at one time

        public string[] names = new string[0];
        public double[] times = new double[0]; // [s]
        public double[][] positions = new double[0][];
        public double[][] velocities = new double[0][];
        public double[][] accelerations = new double[0][];

        /// <summary>
        /// The trajectory, checked. One whose first point lies ahead in time begins where the robot is.
        /// Continuous joints are turned by whole turns to begin nearest to where they are.
        /// </summary>
        /// <param name="joints">the robot's</param>
        /// <param name="q">measured positions of `names`</param>
        /// <param name="v">measured velocities of `names`</param>
        /// <exception cref="RefusedException">what is wrong with it</exception>
        public JointTrajectory Checked(JointTable joints, Func<string, double> q, Func<string, double> v)
        {
            joints.CheckNames(names);
            if (times.Length == 0) return new JointTrajectory(names, times, new double[0][]);
            for (int i = 0; i < times.Length; i++)
            {
                bool bad = !Words.IsFinite(times[i]) || (i == 0 ? times[0] < 0 : times[i] - times[i - 1] < k_TimeGap);
                if (bad)
                    throw new RefusedException("point " + i + " is at " + Words.G(times[i])
                        + " s: time must begin at 0 or later, and increase");
            }
            double[][] p = Rows(positions, "positions");
            if (p == null) throw new RefusedException("the points have no positions");
            double[][] speeds = Rows(velocities, "velocities");
            double[][] accelerated = Rows(accelerations, "accelerations");
            for (int i = 0; i < p.Length; i++)
            {
                try
                {
                    joints.CheckLimits(names, p[i]);
                }
                catch (RefusedException error)
                {
                    throw new RefusedException("point " + i + ": " + error.Message);
                }
            }
            double[] here = names.Select(q).ToArray();
            Unwrap(joints, p, here);
            double[] at = times;
            if (times[0] > k_TimeGap)
            {
                at = new[] { 0.0 }.Concat(times).ToArray();
                p = Before(here, p);
                speeds = speeds == null ? null : Before(names.Select(v).ToArray(), speeds);
                accelerated = accelerated == null ? null : Before(new double[names.Length], accelerated);
            }
            return new JointTrajectory(names, at, p, speeds, accelerated);
        }

        void Unwrap(JointTable joints, double[][] p, double[] here)
        {
            for (int j = 0; j < names.Length; j++)
            {
                if (joints[names[j]].kind != JointKind.Continuous) continue;
                double turns = AngleTracker.Nearest(p[0][j], here[j]) - p[0][j];
                if (turns == 0.0) continue;
                foreach (double[] row in p) row[j] += turns;
            }
        }

        static double[][] Before(double[] first, double[][] rows)
        {
            return new[] { first }.Concat(rows).ToArray();
        }

        /// <summary>A copy of one field's rows; null when no point has it.</summary>
        double[][] Rows(double[][] rows, string field)
        {
            if (rows == null || rows.All(r => r == null || r.Length == 0)) return null;
            double[][] copy = new double[times.Length][];
            for (int i = 0; i < times.Length; i++)
            {
                double[] row = i < rows.Length && rows[i] != null ? rows[i] : new double[0];
                if (row.Length != names.Length)
                    throw new RefusedException(
                        "point " + i + " has " + row.Length + " " + field + " for " + names.Length + " joints");
                if (!row.All(Words.IsFinite))
                    throw new RefusedException("point " + i + ": " + field + " has a value that is not finite");
                copy[i] = (double[])row.Clone();
            }
            return copy;
        }
    }
}
