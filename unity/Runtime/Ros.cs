using System;
using Armcell.Logic;
using RosMessageTypes.BuiltinInterfaces;
using RosMessageTypes.Geometry;
using RosMessageTypes.Std;
using UnityEngine;

namespace Armcell
{
    /// <summary>Between Unity's values and ROS's messages.</summary>
    public static class Ros
    {
        public const string World = "world";

        public static Vector3 ToVector3(Vec3 unity)
        {
            return new Vector3((float)unity.x, (float)unity.y, (float)unity.z);
        }

        public static Quaternion ToQuaternion(Quat unity)
        {
            return new Quaternion((float)unity.x, (float)unity.y, (float)unity.z, (float)unity.w);
        }

        public static Vec3 Of(Vector3 v)
        {
            return new Vec3(v.x, v.y, v.z);
        }

        public static Quat Of(Quaternion q)
        {
            return new Quat(q.x, q.y, q.z, q.w);
        }

        /// <summary>Put a transform at a pose of ROS's axes in its parent.</summary>
        public static void Place(Transform transform, PoseData pose)
        {
            transform.localPosition = ToVector3(Axes.ToUnity(pose.position));
            transform.localRotation = ToQuaternion(Axes.ToUnity(pose.rotation));
        }

        /// <summary>Where a transform is in a frame (null: Unity's own origin), in ROS's axes.</summary>
        public static PoseMsg Pose(Transform transform, Transform frame)
        {
            Vector3 p = frame == null ? transform.position : frame.InverseTransformPoint(transform.position);
            Quaternion q = frame == null ? transform.rotation : Quaternion.Inverse(frame.rotation) * transform.rotation;
            return Pose(Of(p), Of(q));
        }

        /// <summary>A pose of Unity's axes.</summary>
        public static PoseMsg Pose(Vec3 unity, Quat rotation)
        {
            Vec3 p = Axes.ToRos(unity);
            Quat q = Axes.ToRos(rotation);
            return new PoseMsg(new PointMsg(p.x, p.y, p.z), new QuaternionMsg(q.x, q.y, q.z, q.w));
        }

        /// <summary>The simulation's time [s] as a stamp.</summary>
        public static TimeMsg Time(double seconds)
        {
            long nanoseconds = (long)Math.Round(seconds * 1e9);
            TimeMsg time = new TimeMsg();
#if ROS2
            time.sec = (int)(nanoseconds / 1000000000);
#else
            time.sec = (uint)(nanoseconds / 1000000000);
#endif
            time.nanosec = (uint)(nanoseconds % 1000000000);
            return time;
        }

        public static HeaderMsg Header(double seconds, string frame)
        {
            HeaderMsg header = new HeaderMsg();
            header.stamp = Time(seconds);
            header.frame_id = frame;
            return header;
        }

        /// <summary>[s]</summary>
        public static double Seconds(DurationMsg duration)
        {
            return duration.sec + duration.nanosec * 1e-9;
        }
    }
}
