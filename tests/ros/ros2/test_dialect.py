"""ROS 2's definitions and bytes, against what ROS 2 itself says of them: type hashes and recorded samples."""

import queue

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from armcell.core import UnknownNameError
from armcell.ros import Schema, WireError, schema
from armcell.ros.distros import DISTROS
from armcell.ros.ros2 import names
from armcell.ros.ros2.codec import ros2_codec

S = schema()

# From the C code that rosidl generated in Jazzy workspaces; of one the beginning.
JAZZY_HASHES = {
    "builtin_interfaces/Time": "b106235e25a4c5ed35098aa0a61a3ee9c9b18d197f398b0e4206cea9acf9c197",
    "control_msgs/JointComponentTolerance": "739ea7566931944d33830fa10f1bf5e7a7fb",
    "geometry_msgs/Pose": "d501954e9476cea2996984e812054b68026ae0bfae789d9a10b23daf35cc90fa",
    "geometry_msgs/TransformStamped": "0a241f87d04668d94099cbb5ba11691d5ad32c2f29682e4eb5653424bd275206",
    "moveit_msgs/AllowedCollisionMatrix": "ac0159eec0d99f73158c7349c9d1c01b3dc7f749d75a2ea22e74a2a1091a9b05",
    "moveit_msgs/AttachedCollisionObject": "7fdfe7951a33a857f20fc42c9ed410a38d06dd0c209ac774ecea746dc487dc41",
    "moveit_msgs/CollisionObject": "74b0acd6d56be032bf4f764b2c2633f50588b5fb2bd71e97206c59052747cf7e",
    "moveit_msgs/LinkPadding": "864762d9e19f758b0385427f75691374cae830495727c96405f2bad0eb20c766",
    "moveit_msgs/ObjectColor": "4f937f7b22942a9c4a6409c20255aaad1b5d9a003ae3c0edb779698be443c127",
    "moveit_msgs/PlanningScene": "0f58540ad5eab4b9ea827d53b763c793d8cabd202b3b301fcee25afa4ce1bd80",
    "moveit_msgs/PlanningSceneWorld": "e08e6a4a81ca6b6a6953ac758dadc2c949555093efea6a9a22d9accf62c2c099",
    "moveit_msgs/RobotState": "7c516dc15713e545cb2836c5ca745fbdcfcc10de4855a41c83e6b4bf1afc3f83",
    "moveit_msgs/RobotTrajectory": "af1dc87fb94d13e5f233e9c210d2662fa06143a8b3c6aec47c57ad45074fcce8",
    "object_recognition_msgs/ObjectType": "5eb3ee3976403366d7c50d7dbee8bec96b3bced1e752674a7194a35841632134",
    "octomap_msgs/OctomapWithPose": "e65f8760aa96a2acef86b6d206175cfc78420082b6159dd3fa6ebf93f5f81979",
    "sensor_msgs/JointState": "a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e",
    "shape_msgs/SolidPrimitive": "2802a15190aadc3f496584df4b0b4c5824d8a0b31aaef839faa75bc34dda38ac",
    "std_msgs/Header": "f49fb3ae2cf070f793645ff749683ac6b06203e41c891e17701b1cb597ce6a01",
    "trajectory_msgs/JointTrajectory": "179b33eba59d676f6d967ac71fe35e7ca2f64b2f3928f4a018cec115e213796e",
}


@pytest.mark.parametrize("name", JAZZY_HASHES)
def test_definitions_have_the_hashes_that_ros2_has(name):
    assert ros2_codec(S, "jazzy").type_hash(name).startswith(f"RIHS01_{JAZZY_HASHES[name]}")


def test_humble_has_no_hashes_and_larger_ids():
    assert ros2_codec(S, "humble").type_hash("std_msgs/String") is None
    assert len(ros2_codec(S, "humble").new("rmw_dds_common/Gid").data) == 24
    assert len(ros2_codec(S, "jazzy").new("rmw_dds_common/Gid").data) == 16
    assert "message" not in ros2_codec(S, "humble").wire_class("moveit_msgs/MoveItErrorCodes")._fields
    assert "message" in ros2_codec(S, "jazzy").wire_class("moveit_msgs/MoveItErrorCodes")._fields


def test_humbles_discovery_info_as_rosbags_reads_it(reach):
    """Its ids have eight more bytes; a peer of our hand-written types has Jazzy's."""
    from armcell.ros.ros2.dds import Participant
    from armcell.ros.ros2.graph import Announcer
    from armcell.ros.ros2.qos import DISCOVERY_READER

    codec, heard = ros2_codec(S, "humble"), queue.Queue()
    one, other = Participant(reach, codec), Participant(reach, codec)
    try:
        other.reader(names.DISCOVERY, DISCOVERY_READER, heard.put)
        announcer = Announcer(one, codec, "/lab/armcell")
        announcer.add(bytes(range(16)), True)
        announcer.announce()
        store = get_typestore(Stores.ROS2_HUMBLE)
        info = store.deserialize_cdr(heard.get(timeout=5).data, "rmw_dds_common/msg/ParticipantEntitiesInfo")
        node = info.node_entities_info_seq[0]
        assert (node.node_namespace, node.node_name) == ("/lab", "armcell")
        assert list(node.writer_gid_seq[0].data) == [*range(16), *[0] * 8]
        assert bytes(info.gid.data[:16]) == one.guid
    finally:
        one.close()
        other.close()


# --- bytes ---
def theirs(distro, type_name, /, **fields):
    """A message of rosbags' own ROS 2 classes, and its bytes by rosbags' own definitions."""
    store = get_typestore(DISTROS[distro].store)
    message = store.types[type_name](**fields)
    return bytes(store.serialize_cdr(message, type_name))


@pytest.mark.parametrize("distro", ["humble", "jazzy", "kilted", "lyrical"])
def test_bytes_are_rosbags_bytes(distro):
    types = get_typestore(DISTROS[distro].store).types
    codec = ros2_codec(S, distro)
    time = types["builtin_interfaces/msg/Time"](12, 34)
    header = types["std_msgs/msg/Header"](time, "world")
    numbers = np.array([0.5, -1.25])
    expected = theirs(
        distro, "sensor_msgs/msg/JointState", header=header, name=["a", "żółw"], position=numbers,
        velocity=np.zeros(0), effort=numbers,
    )  # fmt: skip
    ours = S.new(
        "sensor_msgs/JointState",
        S.new("std_msgs/Header", 9, S.new("builtin_interfaces/Time", 12, 34), "world"),
        ["a", "żółw"], [0.5, -1.25], [], [0.5, -1.25],
    )  # fmt: skip
    assert bytes(codec.encode(ours)) == expected
    back = codec.decode("sensor_msgs/JointState", expected)
    assert back.header.frame_id == "world" and back.header.seq == 0 and list(back.effort) == [0.5, -1.25]

    polygon = types["geometry_msgs/msg/Polygon"]([])
    expected = theirs(
        distro, "shape_msgs/msg/SolidPrimitive", type=3, dimensions=np.array([0.1, 0.02]), polygon=polygon
    )
    ours = S.new("shape_msgs/SolidPrimitive", 3, [0.1, 0.02])
    assert bytes(codec.encode(ours)) == expected
    assert codec.decode("shape_msgs/SolidPrimitive", expected) == S.new(
        "shape_msgs/SolidPrimitive", 3, np.array([0.1, 0.02])
    )

    roi = types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
    expected = theirs(
        distro, "sensor_msgs/msg/CameraInfo", header=header, height=480, width=640,
        distortion_model="plumb_bob", d=np.zeros(5), k=np.arange(9.0), r=np.eye(3).ravel(),
        p=np.arange(12.0), binning_x=0, binning_y=0, roi=roi,
    )  # fmt: skip
    back = codec.decode("sensor_msgs/CameraInfo", expected)
    assert list(back.K) == list(range(9)) and back.width == 640
    assert bytes(codec.encode(back)) == expected


def test_big_endian_samples_are_read():
    store = get_typestore(Stores.ROS2_JAZZY)
    message = store.types["std_msgs/msg/Float64"](0.75)
    data = bytes(store.serialize_cdr(message, "std_msgs/msg/Float64", little_endian=False))
    assert ros2_codec(S, "jazzy").decode("std_msgs/Float64", data).data == 0.75


@pytest.mark.slow
def test_every_type_goes_there_and_back():
    """Whatever only ROS 2 has comes back as its default, whatever only we have is lost: once, not twice."""
    from tests.ros.helpers import random_message

    rng = np.random.default_rng(3)
    codec = ros2_codec(S, "jazzy")
    for name in S.messages:
        data = bytes(codec.encode(random_message(S, name, rng)))
        back = codec.decode(name, data)
        assert type(back) is S.message(name)
        assert bytes(codec.encode(back)) == data, name


def test_what_is_no_message_is_refused():
    codec = ros2_codec(S, "jazzy")
    good = bytes(codec.encode(S.new("std_msgs/String", "hello")))
    for bad in (b"", good[:3], good[:6], good[:-3], b"\0\7" + good[2:], good + bytes(8)):
        with pytest.raises(WireError):
            codec.decode("std_msgs/String", bad)


def test_unknown_distribution():
    with pytest.raises(UnknownNameError, match="did you mean 'jazzy'"):
        ros2_codec(S, "jazy")


def test_users_types_are_carried_too(tmp_path):
    folder = tmp_path / "my_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / "Thing.msg").write_text("std_msgs/Header header\nfloat32[3] size\nstring[] names\n")
    own = Schema(tmp_path)
    codec = ros2_codec(own, "jazzy")
    message = own.new("my_msgs/Thing", size=[1, 2, 3], names=["a"])
    assert list(codec.decode("my_msgs/Thing", codec.encode(message)).size) == [1, 2, 3]


# --- names ---
def test_names_on_dds():
    assert names.topic("/a/b", "std_msgs/String")[:2] == ("rt/a/b", "std_msgs::msg::dds_::String_")
    assert names.request("/add", "example/Add")[:2] == ("rq/addRequest", "example::srv::dds_::Add_Request_")
    assert names.reply("/add", "example/Add")[:2] == ("rr/addReply", "example::srv::dds_::Add_Response_")
    send = names.request("/arm/_action/send_goal", "example/Move_SendGoal", "action")
    assert send[:2] == ("rq/arm/_action/send_goalRequest", "example::action::dds_::Move_SendGoal_Request_")
    assert names.action_name("/left/move_group", "moveit_msgs/MoveGroup") == "/left/move_action"  # MoveIt 2's
    assert names.action_name("/pickup", "moveit_msgs/Pickup") == "/pickup"
    assert names.ros_topic("rt/a/b") == "/a/b" and names.ros_topic("ros_discovery_info") is None
    assert names.ros_service("rq/addRequest") == "/add" and names.ros_service("rt/add") is None
    assert names.ros_type("std_msgs::msg::dds_::String_") == "std_msgs/String"
    assert names.ros_type("DDS::String") is None
