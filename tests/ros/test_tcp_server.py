"""The ROS-TCP server, seen by clients that behave as Unity's connector: the wire and its topics."""

import json
import socket
import struct

import pytest
from tests.ros.tcp_helpers import (
    IDS,
    MODES,
    codec,
    frame,
    frames_until_silence,
    joined,
    receive,
    receive_until,
    text,
    wait_for,
)
from tests.ros.unity_like import UnityLike

from armcell.ros import cdr_codec, schema
from armcell.ros.codec import ros1_codec
from armcell.ros.tcp import RosTcpServer, ServerSettings


# --- the wire, byte for byte ---
def test_the_first_frame_is_the_handshake_byte_for_byte(server):
    with socket.create_connection(server.address) as raw:
        raw.sendall(bytes(8) + frame(b"__topic_list", b"{}"))
        body = b'{"version":"v0.7.0","metadata":"{\\"protocol\\": \\"ROS1\\"}"}'
        golden = b"\x0b\0\0\0__handshake" + struct.pack("<I", len(body)) + body
        assert receive(raw, len(golden)) == golden
        metadata = json.loads(body)["metadata"]
        assert json.loads(metadata) == {"protocol": "ROS1"}  # a JSON text inside the JSON


def test_a_message_to_unity_byte_for_byte(bus, server):
    with socket.create_connection(server.address) as raw:
        raw.sendall(frame(b"__subscribe", b'{"topic":"chat","message_name":"std_msgs/String"}'))
        wait_for(lambda: joined(bus, "/chat"))
        bus.advertise("/chat", "std_msgs/String").publish(text("hi"))
        data = receive_until(raw, b"hi")
        assert data.endswith(
            b"\x04\0\0\0chat" + b"\x06\0\0\0" + b"\x02\0\0\0hi"
        )  # the name as Unity spelt it


def test_a_message_to_unity_in_ros2_mode_byte_for_byte(bus, server):
    with socket.create_connection(server.address) as raw:
        raw.sendall(frame(b"__subscribe\0", b'{"topic":"/chat","message_name":"std_msgs/String"}\0'))
        wait_for(lambda: joined(bus, "/chat"))
        bus.advertise("/chat", "std_msgs/String").publish(text("hi"))
        data = receive_until(raw, b"hi\0")
        assert data.endswith(b"\x05\0\0\0/chat" + b"\x0b\0\0\0" + b"\0\1\0\0" + b"\x03\0\0\0hi\0")
        assert b'\\"ROS2\\"' in data


def test_three_byte_pieces_are_put_together(bus, server):
    got = bus.subscribe("/chat", "std_msgs/String")
    stream = frame(b"__publish", b'{"topic":"/chat","message_name":"std_msgs/String"}')
    stream += bytes(8) + frame(b"/chat", b"\x05\0\0\0hello") * 3
    with socket.create_connection(server.address) as raw:
        raw.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        for i in range(0, len(stream), 3):
            raw.sendall(stream[i : i + 3])
        assert [got.get(5).data for _ in range(3)] == ["hello"] * 3


# --- topics ---
@pytest.mark.parametrize("ros2", MODES, ids=IDS)
def test_topics_go_both_ways(bus, server, ros2):
    state = schema().new("sensor_msgs/JointState", name=["a"], position=[0.5])
    got = bus.subscribe("/joint_states", "sensor_msgs/JointState")
    publisher = bus.advertise("/planned_trajectory", "trajectory_msgs/JointTrajectory")
    with UnityLike(server.address, ros2) as unity:
        unity.register("__publish", "/joint_states", "sensor_msgs/JointState", queue_size=10, latch=False)
        unity.register("__subscribe", "/planned_trajectory", "trajectory_msgs/JointTrajectory")
        unity.message("/joint_states", codec(ros2).encode(state))
        assert got.get(5).position.tolist() == [0.5]
        wait_for(lambda: publisher.subscribers == 1)
        publisher.publish(schema().new("trajectory_msgs/JointTrajectory", joint_names=["a", "b"]))
        body = unity.read_until("/planned_trajectory")
        back = codec(ros2).decode("trajectory_msgs/JointTrajectory", body)
        assert back.joint_names == ["a", "b"]


@pytest.mark.parametrize("ros2", MODES, ids=IDS)
def test_registering_twice_is_registering_once_and_keeps_the_latched_message(bus, server, ros2):
    """The connector registers on use and again on connecting."""
    bus.advertise("/map", "std_msgs/String", latch=True).publish(text("latched"))
    with UnityLike(server.address, ros2) as unity:
        for _ in range(2):
            unity.register("__subscribe", "/map", "std_msgs/String")
            unity.register("__publish", "/up", "std_msgs/String", latch=True)
        unity.message("/up", codec(ros2).encode(text("kept")))
        for _ in range(2):
            unity.register("__publish", "/up", "std_msgs/String", latch=True)
        unity.command("__topic_list")
        frames = frames_until_silence(unity)
        assert [name for name, _ in frames].count("/map") == 1
        assert bus.subscribe("/up", "std_msgs/String").get(5).data == "kept"
        assert (joined(bus, "/map").subscribers, joined(bus, "/up").publishers) == (1, 1)
        topics = dict(frames)["__topic_list"]
        assert dict(zip(topics["topics"], topics["types"]))["/up"] == "std_msgs/String"


def test_removing_registrations(bus, server):
    with UnityLike(server.address) as unity:
        unity.register("__subscribe", "/a", "std_msgs/String")
        unity.register("__publish", "/b", "std_msgs/String")
        unity.register("__unity_service", "/c", "std_srvs/Trigger")
        wait_for(lambda: joined(bus, "/a") and joined(bus, "/b") and bus.services())
        unity.command("__remove_subscriber", topic="/a")
        unity.command("__remove_publisher", topic="/b")
        unity.command("__remove_unity_service", topic="/c")
        unity.command("__remove_ros_service", topic="/none")
        wait_for(lambda: not bus.topics() and not bus.services())


def test_a_client_that_goes_takes_its_registrations_with_it(bus, server):
    with UnityLike(server.address) as other:
        other.register("__subscribe", "/a", "std_msgs/String")
        unity = UnityLike(server.address)
        unity.register("__subscribe", "/a", "std_msgs/String")
        unity.register("__publish", "/b", "std_msgs/String", latch=True)
        unity.register("__unity_service", "/c", "std_srvs/Trigger")
        wait_for(lambda: joined(bus, "/a") and joined(bus, "/a").subscribers == 2 and bus.services())
        unity.close()
        wait_for(lambda: not bus.services() and [t.name for t in bus.topics()] == ["/a"])
        assert len(server.clients()) == 1
        bus.advertise("/a", "std_msgs/String").publish(text("still here"))
        assert ros1_codec().decode("std_msgs/String", other.read_until("/a")).data == "still here"


def test_two_clients_publish_and_read_one_topic(bus, server):
    with UnityLike(server.address) as one, UnityLike(server.address, ros2=True) as two:
        for unity in (one, two):
            unity.register("__publish", "/chat", "std_msgs/String")
            unity.register("__subscribe", "/chat", "std_msgs/String")
        wait_for(lambda: joined(bus, "/chat") and joined(bus, "/chat").subscribers == 2)
        one.message("/chat", ros1_codec().encode(text("from one")))
        assert ros1_codec().decode("std_msgs/String", one.read_until("/chat")).data == "from one"
        assert cdr_codec().decode("std_msgs/String", two.read_until("/chat")).data == "from one"
        two.message("/chat", cdr_codec().encode(text("from two")))
        assert ros1_codec().decode("std_msgs/String", one.read_until("/chat")).data == "from two"


def test_a_client_that_says_nothing_is_greeted_all_the_same(server):
    with UnityLike(server.address) as unity:
        assert unity.read(timeout=5)[0] == "__handshake"


def test_a_wrong_guess_is_put_right(bus):
    with (
        RosTcpServer(bus, ServerSettings(port=0, guess_after=0.0)) as server,
        UnityLike(server.address, ros2=True) as unity,
    ):
        assert "ROS1" in unity.read()[1]["metadata"]
        unity.register("__publish", "/chat", "std_msgs/String")
        assert "ROS2" in unity.read()[1]["metadata"]
        got = bus.subscribe("/chat", "std_msgs/String")
        unity.message("/chat", cdr_codec().encode(text("hi")))
        assert got.get(5).data == "hi"


def test_a_fixed_protocol_tells_unity_what_to_change(bus):
    with (
        RosTcpServer(bus, ServerSettings(port=0, protocol="ROS1")) as server,
        UnityLike(server.address, ros2=True) as unity,
    ):
        assert "ROS1" in unity.read()[1]["metadata"]
        unity.register("__subscribe", "/tf", "tf2_msgs/TFMessage")
        assert "Robotics > ROS Settings" in unity.read_until("__error")["text"]


def test_ping(server):
    with UnityLike(server.address) as unity:
        unity.command("__ping", request_time=12.5)
        assert unity.read_until("__ping_response") == {"request_time": 12.5}
