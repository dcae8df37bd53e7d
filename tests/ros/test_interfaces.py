"""Every type of the packages that cells and clients use is known, with ROS 1's and ROS 2's layout."""

from pathlib import Path

import numpy as np
import pytest
from tests.ros.helpers import random_message

from armcell.core import InputError
from armcell.ros import Schema, cdr_codec, schema
from armcell.ros.codec import ros1_codec
from armcell.ros.distros import DISTROS
from armcell.ros.ros2.codec import ros2_codec

S = schema()
ROWS = [
    line.partition(":")[::2]
    for line in (Path(__file__).parent / "interfaces.txt").read_text().splitlines()
    if not line.startswith("#")
]
PARTS = {"msg": [""], "srv": ["Request", "Response"], "action": ["Goal", "Result", "Feedback"]}


@pytest.mark.slow
@pytest.mark.cases("jazzy std_*", "jazzy moveit_msgs action", "noetic moveit_msgs *")
@pytest.mark.parametrize(("head", "items"), ROWS, ids=[head for head, _ in ROWS])
def test_every_interface_is_known_in_both_layouts(head, items):
    distro, package, kind = head.split()
    table = {"msg": S.messages, "srv": S.services, "action": S.actions}[kind]
    names = [f"{package}/{item}" for item in items.split()]
    assert set(names) <= set(table)
    codec = ros2_codec(S, "jazzy" if distro == "noetic" else distro)
    rng = np.random.default_rng(5)
    for name in [name + part for name in names for part in PARTS[kind]]:
        message = random_message(S, name, rng)
        data = bytes(ros1_codec(S).encode(message))
        assert bytes(ros1_codec(S).encode(ros1_codec(S).decode(name, data))) == data
        data = bytes(codec.encode(message))
        assert bytes(codec.encode(codec.decode(name, data))) == data


def test_fields_that_only_ros2_has_survive_its_wire_and_are_no_part_of_ros1s():
    primitive = S.new("shape_msgs/SolidPrimitive", 5, [0.2])
    primitive.polygon.points = [S.new("geometry_msgs/Point32", x, 0.5, 0.0) for x in (0.0, 1.0, 2.0)]
    errors = S.new("moveit_msgs/MoveItErrorCodes", -15, message="unknown group", source="armcell")
    goal = S.new("moveit_msgs/ExecuteTrajectoryGoal", controller_names=["left", "right"])
    for message in (primitive, errors, goal):
        jazzy = ros2_codec(S, "jazzy")
        assert jazzy.decode(message._type, jazzy.encode(message)) == message
        without = ros1_codec(S).decode(message._type, ros1_codec(S).encode(message))
        assert without != message and ros1_codec(S).encode(without) == ros1_codec(S).encode(message)
    assert bytes(ros1_codec(S).encode(errors)) == (-15).to_bytes(4, "little", signed=True)
    humble = ros2_codec(S, "humble")
    assert humble.decode(errors._type, humble.encode(errors)) == S.new(errors._type, -15)


def test_positional_arguments_keep_ros1s_order():
    assert S.new("shape_msgs/SolidPrimitive", 1, [1.0, 2.0, 3.0]).type == 1
    assert S.message("shape_msgs/SolidPrimitive")._fields[:2] == ("type", "dimensions")
    assert S.message("moveit_msgs/MoveItErrorCodes")._fields == ("val", "message", "source")


def test_types_that_only_ros2_has_are_types_of_the_bus():
    state = S.new("control_msgs/DynamicJointState", joint_names=["a"])
    assert cdr_codec(S).decode(state._type, cdr_codec(S).encode(state)) == state
    assert "control_msgs/ParallelGripperCommand" in S.actions
    assert "rcl_interfaces/GetParameters" in S.services
    assert not any(name.startswith("rmw_dds_common/") for name in S.messages)


def test_a_users_package_goes_before_ours_in_ros2(tmp_path):
    folder = tmp_path / "control_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / "DynamicJointState.msg").write_text("string only\n")
    own = Schema(tmp_path)
    for distro in DISTROS:
        codec = ros2_codec(own, distro)
        message = own.new("control_msgs/DynamicJointState", "x")
        assert codec.decode(message._type, codec.encode(message)) == message
    (folder / "JointTolerance.msg").write_text("string only\n")
    with pytest.raises(InputError, match="defined twice"):
        Schema(tmp_path)


def test_scripts_messages_have_ros2s_fields_too_but_print_as_ros1s():
    from armcell.moveit.message_classes import MessageClasses

    code = MessageClasses(S)["moveit_msgs/MoveItErrorCodes"](-4)
    assert str(code) == "val: -4" and code.message == ""
    code.message = "why"
    assert ros2_codec(S, "jazzy").decode(code._type, ros2_codec(S, "jazzy").encode(code)).message == "why"
    assert MessageClasses(S).local(S.new(code._type, -4, "why", "armcell")).message == "why"
