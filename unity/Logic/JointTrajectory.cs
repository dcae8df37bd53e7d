using System;

namespace Armcell.Logic
{
    /// <summary>
    /// Timed motion of named joints. Between points: quintic where accelerations are given, cubic where
    /// velocities are, else linear (the rule of ROS's joint_trajectory_controller).
    /// </summary>
    public class JointTrajectory
    {
        public readonly string[] names;
        public readonly double[] times; // [s], increasing
        public readonly double[][] positions; // [point][joint]
        public readonly double[][] velocities; // null: not given
        public readonly double[][] accelerations; // null: not given

        public JointTrajectory(
            string[] names, double[] times, double[][] positions, double[][] velocities = null,
            double[][] accelerations = null)
        {
            this.names = names;
            this.times = times;
            this.positions = positions;
            this.velocities = velocities;
            this.accelerations = velocities == null ? null : accelerations; // without velocities they say nothing
        }

        public double Duration
        {
            get { return times.Length == 0 ? 0.0 : times[times.Length - 1]; }
        }

        /// <summary>Positions and velocities at a time [s]; at rest before the first point and after the last.</summary>
        public void Sample(double t, double[] q, double[] v)
        {
            int last = times.Length - 1;
            if (last < 0) throw new RefusedException("an empty trajectory has no position at any time");
            if (t <= times[0] || t >= times[last])
            {
                Array.Copy(positions[t <= times[0] ? 0 : last], q, q.Length);
                Array.Clear(v, 0, v.Length);
                return;
            }
            int i = Array.BinarySearch(times, t);
            if (i < 0) i = ~i - 1;
            double h = times[i + 1] - times[i], s = t - times[i];
            for (int j = 0; j < q.Length; j++)
            {
                double p0 = positions[i][j], p1 = positions[i + 1][j];
                if (velocities == null)
                {
                    v[j] = (p1 - p0) / h;
                    q[j] = p0 + v[j] * s;
                }
                else if (accelerations == null)
                    Curves.Cubic(p0, velocities[i][j], p1, velocities[i + 1][j], h, s, out q[j], out v[j]);
                else
                    Curves.Quintic(
                        p0, velocities[i][j], accelerations[i][j],
                        p1, velocities[i + 1][j], accelerations[i + 1][j], h, s, out q[j], out v[j]);
            }
        }
    }

    /// <summary>Polynomials through given ends.</summary>
    public static class Curves
    {
        /// <summary>Position and velocity at s of the cubic from (p0, v0) to (p1, v1) in h seconds.</summary>
        public static void Cubic(
            double p0, double v0, double p1, double v1, double h, double s, out double q, out double v)
        {
            double c2 = (3 * (p1 - p0) / h - 2 * v0 - v1) / h;
            double c3 = (v0 + v1 - 2 * (p1 - p0) / h) / (h * h);
            q = p0 + s * (v0 + s * (c2 + s * c3));
            v = v0 + s * (2 * c2 + 3 * s * c3);
        }

        /// <summary>Position and velocity at s of the quintic from (p0, v0, a0) to (p1, v1, a1) in h seconds.</summary>
        public static void Quintic(
            double p0, double v0, double a0, double p1, double v1, double a1, double h, double s,
            out double q, out double v)
        {
            double d = p1 - p0, h2 = h * h, h3 = h2 * h;
            double c3 = (20 * d - (8 * v1 + 12 * v0) * h - (3 * a0 - a1) * h2) / (2 * h3);
            double c4 = (-30 * d + (14 * v1 + 16 * v0) * h + (3 * a0 - 2 * a1) * h2) / (2 * h3 * h);
            double c5 = (12 * d - 6 * (v1 + v0) * h + (a1 - a0) * h2) / (2 * h3 * h2);
            q = p0 + s * (v0 + s * (a0 / 2 + s * (c3 + s * (c4 + s * c5))));
            v = v0 + s * (a0 + s * (3 * c3 + s * (4 * c4 + s * 5 * c5)));
        }
    }
}
