"""What the tests of the ROS-TCP wire share."""

import struct
import time

from armcell.ros import cdr_codec, schema
from armcell.ros.codec import ros1_codec
from armcell.ros.tcp import ServerSettings

ANY_PORT = ServerSettings(port=0)
MODES = [False, True]
IDS = ["ROS1", "ROS2"]


def codec(ros2):
    return cdr_codec() if ros2 else ros1_codec()


def text(value):
    return schema().new("std_msgs/String", data=value)


def wait_for(condition, timeout=5.0):
    end = time.monotonic() + timeout
    while not condition() and time.monotonic() < end:
        time.sleep(0.002)
    assert condition()


def joined(bus, topic):
    return next((t for t in bus.topics() if t.name == topic), None)


def frame(name, body):
    return struct.pack("<I", len(name)) + name + struct.pack("<I", len(body)) + body


def receive(raw, count):
    data = b""
    raw.settimeout(5)
    while len(data) < count:
        data += raw.recv(count - len(data))
    return data


def receive_until(raw, end):
    data = b""
    raw.settimeout(5)
    while not data.endswith(end):
        data += raw.recv(4096)
    return data


def frames_until_silence(unity, silence=0.3):
    frames = []
    while True:
        try:
            frames.append(unity.read(timeout=silence))
        except TimeoutError:
            return frames
