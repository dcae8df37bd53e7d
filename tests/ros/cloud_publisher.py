"""A depth sensor in a process of its own: publishes clouds to a ROS-TCP server until it is ended.

Takes the server's port, and a file of points: .npy (n, 3) [m, world]; NaN where nothing was seen. Its framing
(`unity_like`) and its message bytes are written by hand: ROS 1's serialization of sensor_msgs/PointCloud2.
"""

import struct
import sys
import time

import numpy as np
from tests.ros.unity_like import UnityLike

TOPIC = "/camera/depth/points"


def text(value):
    return struct.pack("<I", len(value)) + value.encode()


def cloud(points, frame):
    data = np.ascontiguousarray(points, "<f4").tobytes()
    fields = b"".join(text(n) + struct.pack("<IBI", 4 * i, 7, 1) for i, n in enumerate("xyz"))
    header = struct.pack("<III", 0, 0, 0) + text(frame)
    size = struct.pack("<II", 1, len(points))
    rest = struct.pack("<BII", 0, 12, 12 * len(points)) + struct.pack("<I", len(data)) + data
    return header + size + struct.pack("<I", 3) + fields + rest + struct.pack("<B", 0)


def transform(parent, child, xyz):
    """A tf2_msgs/TFMessage."""
    header = struct.pack("<III", 0, 0, 0) + text(parent)
    return struct.pack("<I", 1) + header + text(child) + struct.pack("<7d", *xyz, 0, 0, 0, 1)


def main(port, file, eye):
    points = np.load(file)
    with UnityLike(("127.0.0.1", int(port))) as unity:
        unity.register("__publish", TOPIC, "sensor_msgs/PointCloud2", queue_size=1, latch=False)
        unity.register("__publish", "/tf_static", "tf2_msgs/TFMessage", queue_size=1, latch=True)
        unity.message("/tf_static", transform("world", "eye", eye))
        body = cloud(points - eye, "eye")
        while True:
            unity.message(TOPIC, body)
            time.sleep(0.1)


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], np.array([float(v) for v in sys.argv[3:6]]))
