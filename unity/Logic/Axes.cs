using System;

namespace Armcell.Logic
{
    /// <summary>Three numbers in double precision: a position or a direction.</summary>
    public struct Vec3
    {
        public double x, y, z;

        public Vec3(double x, double y, double z)
        {
            this.x = x;
            this.y = y;
            this.z = z;
        }
    }

    /// <summary>A rotation as a unit quaternion.</summary>
    public struct Quat
    {
        public double x, y, z, w;

        public Quat(double x, double y, double z, double w)
        {
            this.x = x;
            this.y = y;
            this.z = z;
            this.w = w;
        }

        /// <summary>From roll, pitch, yaw [rad] about fixed axes, as URDF means them.</summary>
        public static Quat FromRpy(double roll, double pitch, double yaw)
        {
            double cr = Math.Cos(roll / 2), sr = Math.Sin(roll / 2);
            double cp = Math.Cos(pitch / 2), sp = Math.Sin(pitch / 2);
            double cy = Math.Cos(yaw / 2), sy = Math.Sin(yaw / 2);
            return new Quat(
                sr * cp * cy - cr * sp * sy,
                cr * sp * cy + sr * cp * sy,
                cr * cp * sy - sr * sp * cy,
                cr * cp * cy + sr * sp * sy);
        }

        /// <summary>Angle [rad], 0 to pi, between two rotations.</summary>
        public static double Angle(Quat a, Quat b)
        {
            double dot = Math.Abs(a.x * b.x + a.y * b.y + a.z * b.z + a.w * b.w);
            return 2.0 * Math.Acos(Math.Min(dot, 1.0));
        }
    }

    /// <summary>
    /// Between ROS's axes (x forward, y left, z up, right-handed) and Unity's (x right, y up, z forward,
    /// left-handed). Quaternions are the same rotation up to sign.
    /// </summary>
    public static class Axes
    {
        public static Vec3 ToRos(Vec3 unity)
        {
            return new Vec3(unity.z, -unity.x, unity.y);
        }

        public static Vec3 ToUnity(Vec3 ros)
        {
            return new Vec3(-ros.y, ros.z, ros.x);
        }

        public static Quat ToRos(Quat unity)
        {
            return new Quat(unity.z, -unity.x, unity.y, -unity.w);
        }

        public static Quat ToUnity(Quat ros)
        {
            return new Quat(-ros.y, ros.z, ros.x, -ros.w);
        }

        /// <summary>Sizes along axes have no sign.</summary>
        public static Vec3 SizeToUnity(Vec3 ros)
        {
            return new Vec3(ros.y, ros.z, ros.x);
        }

        public static Vec3 SizeToRos(Vec3 unity)
        {
            return new Vec3(unity.z, unity.x, unity.y);
        }
    }
}
