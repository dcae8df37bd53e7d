"""A bus in a ROS 2 domain with eProsima's Fast DDS on the other side: the library of ROS 2's default rmw.

Debian's Fast DDS 2.9; `fastdds/peer.cpp` is compiled here. rosbags' own ROS 2 classes encode the messages,
Fast CDR one of them. Services and actions are not tried: rmw_fastrtps_cpp correlates their calls by RTPS's
related sample identity, which Cyclone DDS does not offer, so that real ROS 2's two rmws do not meet either.
"""

from __future__ import annotations

import shutil
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore
from tests.ros.ros2.conftest import DOMAINS

from armcell.ros import Bus, schema
from armcell.ros.ros2 import DomainScope, Ros2Bridge, Ros2Settings

pytestmark = [pytest.mark.interop, pytest.mark.slow]
S = schema()
STORE = get_typestore(Stores.ROS2_JAZZY)
SOURCE = Path(__file__).parent / "fastdds" / "peer.cpp"
HEADERS = Path("/usr/include/fastdds/dds/domain/DomainParticipant.hpp")
STRING, STATE = "std_msgs::msg::dds_::String_", "sensor_msgs::msg::dds_::JointState_"
IMAGE = "sensor_msgs::msg::dds_::Image_"
IN_TIME = 2.0  # [s] nodes must find each other


class Peer:
    """A Fast DDS process: each command gives its one line of answer."""

    def __init__(self, program, domain, reach):
        self.process = subprocess.Popen(
            [program, str(domain), reach], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        assert self.process.stdout.readline() == "ready\n"

    def __call__(self, *words):
        self.process.stdin.write(" ".join(map(str, words)) + "\n")
        self.process.stdin.flush()
        return self.process.stdout.readline().strip()

    def wait_matched(self, topic, timeout=10.0):
        """Seconds until the topic's endpoint has met another."""
        began = time.monotonic()
        while self("matched", topic) == "0":
            assert time.monotonic() - began < timeout, f"{topic} met nothing"
            time.sleep(0.02)
        return time.monotonic() - began

    def take(self, topic, type_name, timeout=5.0):
        """The next sample as one of rosbags' messages."""
        answer = self("take", topic, int(timeout * 1000))
        assert answer != "none", f"nothing on {topic}"
        return STORE.deserialize_cdr(bytes.fromhex(answer), type_name)

    def publish(self, topic, type_name, message):
        assert self("publish", topic, bytes(STORE.serialize_cdr(message, type_name)).hex()) == "1"

    def close(self):
        self.process.stdin.close()
        self.process.wait(10)


@pytest.fixture(scope="module")
def program(tmp_path_factory):
    pytest.importorskip("cyclonedds", reason="cyclonedds is not installed (pip install 'armcell[ros2]')")
    if not (HEADERS.exists() and shutil.which("g++")):
        pytest.skip("Fast DDS is not installed (apt-get install libfastrtps-dev g++)")
    target = tmp_path_factory.mktemp("fastdds") / "peer"
    command = [
        "g++",
        "-std=c++17",
        "-w",
        "-o",
        str(target),
        str(SOURCE),
        "-lfastrtps",
        "-lfastcdr",
        "-pthread",
    ]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr[-2000:]
    return str(target)


@pytest.fixture(params=["LOCALHOST", "SUBNET"])
def bridge(request):
    """A bus in a domain of its own: Fast DDS has no discovery tags."""
    made = Ros2Bridge(
        Bus(), Ros2Settings(DomainScope(100 + next(DOMAINS) % 100, request.param), distro="jazzy")
    )
    with made:
        yield made


@pytest.fixture
def peer(program, bridge):
    """A node in the range LOCALHOST, as `ROS_AUTOMATIC_DISCOVERY_RANGE` there."""
    process = Peer(program, bridge.settings.reach.domain, "lo")
    yield process
    process.close()


def joint_state(name, *position):
    types = STORE.types
    header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](5, 6), "base")
    empty = np.zeros(0)
    return types["sensor_msgs/msg/JointState"](header, [name], np.array(position), empty, empty)


def test_topics_both_ways_and_type_hashes(bridge, peer):
    bus = bridge.bus
    publisher = bus.advertise("/joint_states", "sensor_msgs/JointState")
    peer("subscribe", "rt/joint_states", STATE)
    assert peer.wait_matched("rt/joint_states") < IN_TIME
    time.sleep(0.3)  # our side may learn of the match a little later
    for i in range(3):
        header = S.new("std_msgs/Header", 9, S.new("builtin_interfaces/Time", 5, 6), "base")
        publisher.publish(S.new("sensor_msgs/JointState", header, ["żółw"], [float(i), -1.5]))
    got = [peer.take("rt/joint_states", "sensor_msgs/msg/JointState") for _ in range(3)]
    assert [g.position.tolist() for g in got] == [[float(i), -1.5] for i in range(3)]
    assert got[0].name == ["żółw"] and got[0].header.stamp.sec == 5 and got[0].header.frame_id == "base"
    user = peer("found", "rt/joint_states")
    assert (
        user.startswith(f"{STATE} ")
        and f"typehash={bridge._context.codec.type_hash('sensor_msgs/JointState')};" in user
    )
    assert "typehash=RIHS01_" in peer("found", "ros_discovery_info")

    inbox = bus.subscribe("/measured", "sensor_msgs/JointState")
    peer("advertise", "rt/measured", STATE)
    peer.wait_matched("rt/measured")
    peer.publish("rt/measured", "sensor_msgs/msg/JointState", joint_state("elbow", 0.25))
    assert peer("joint_state", "rt/measured", "wrist", -0.5) == "1"  # Fast CDR's own bytes
    first, second = inbox.get(5), inbox.get(5)
    assert (first.name, list(first.position), first.header.frame_id) == (["elbow"], [0.25], "base")
    assert (second.name, list(second.position), second.header.stamp.nanosec) == (["wrist"], [-0.5], 6)


def test_latched_topics_reach_those_who_come_later(bridge, peer):
    bus = bridge.bus
    publisher = bus.advertise("/robot_description", "std_msgs/String", latch=True)
    publisher.publish(S.new("std_msgs/String", "<robot/>"))
    time.sleep(0.5)
    peer("subscribe", "rt/robot_description", STRING, "latched")
    assert peer.take("rt/robot_description", "std_msgs/msg/String").data == "<robot/>"
    peer("advertise", "rt/map", STRING, "latched")
    peer.publish("rt/map", "std_msgs/msg/String", STORE.types["std_msgs/msg/String"]("here"))
    time.sleep(0.5)
    assert bus.subscribe("/map", "std_msgs/String").get(5).data == "here"


@pytest.mark.parametrize("quality", ["reliable", "best_effort"])
def test_images_arrive_whole(bridge, peer, quality):
    """A megabyte in many fragments, for either kind of subscriber."""
    publisher = bridge.bus.advertise("/camera/image", "sensor_msgs/Image")
    peer("subscribe", "rt/camera/image", IMAGE, quality)
    peer.wait_matched("rt/camera/image")
    time.sleep(0.5)
    pixels = np.arange(640 * 480 * 3, dtype=np.uint32).astype(np.uint8)
    image = S.new("sensor_msgs/Image", height=480, width=640, encoding="rgb8", step=1920, data=pixels)
    for _ in range(20):  # without reliability, a fragment that is lost takes its image along
        publisher.publish(image)
        answer = peer("take", "rt/camera/image", 10_000 if quality == "reliable" else 1000)
        if answer != "none":
            break
    got = STORE.deserialize_cdr(bytes.fromhex(answer), "sensor_msgs/msg/Image")
    assert (got.height, got.encoding) == (480, "rgb8") and np.array_equal(got.data, pixels)


def test_a_node_of_each_range_that_starts_late_is_found_in_time(program, bridge):
    """Cyclone gives up silent addresses after 30 s unless configured otherwise."""
    bridge.bus.advertise("/late", "std_msgs/String")
    time.sleep(35.0)
    took = {}
    for reach in ("lo", "all"):
        late = Peer(program, bridge.settings.reach.domain, reach)
        try:
            late("subscribe", "rt/late", STRING)
            took[reach] = late.wait_matched("rt/late")
        finally:
            late.close()
    assert max(took.values()) < IN_TIME, took
