"""RIHS01 hashes against those that rosidl generated: in Jazzy builds, and in documents of other projects."""

from pathlib import Path

import pytest

from armcell.ros import Schema, schema
from armcell.ros.ros2.codec import ros2_codec

S = schema()
RECORDED = [
    line.split()
    for line in (Path(__file__).parent / "rihs_jazzy.txt").read_text().splitlines()
    if not line.startswith("#")
]


def hash_of(codec, full):
    """The hash of a type by ROS 2's full name."""
    package, kind, item = full.split("/")
    name = f"{package}/{item}"
    if kind != "msg" and name in (codec.schema.services if kind == "srv" else codec.schema.actions):
        return codec.type_hash(name, kind)
    ours = next(n for n in codec.definitions if codec.hashes.names.full(n) == full)
    return codec.type_hash(ours)


@pytest.mark.slow
@pytest.mark.cases("std_msgs/*", "sensor_msgs/*", "moveit_msgs/action/*")
@pytest.mark.parametrize(("full", "expected"), RECORDED, ids=[full for full, _ in RECORDED])
def test_hashes_are_those_of_ros2(full, expected):
    assert hash_of(ros2_codec(S, "jazzy"), full) == f"RIHS01_{expected}"


def test_the_record_has_messages_services_and_actions_with_all_parts():
    kinds = [full.split("/")[1] for full, _ in RECORDED]
    assert min(kinds.count(k) for k in ("msg", "srv", "action")) > 80
    parts = {full.split("GripperCommand")[1] for full, _ in RECORDED if "action/GripperCommand" in full}
    assert parts == {
        "", "_Goal", "_Result", "_Feedback", "_SendGoal_Request", "_SendGoal_Response",
        "_GetResult_Request", "_GetResult_Response", "_FeedbackMessage",
    }  # fmt: skip


def test_hashes_of_example_interfaces_as_rmw_zenoh_documents_them(tmp_path):
    """A user's own types. Sources: rmw_zenoh's design document; swift-ros2's recorded keys of Fibonacci."""
    for kind, name, text in (
        ("srv", "AddTwoInts", "int64 a\nint64 b\n---\nint64 sum\n"),
        ("action", "Fibonacci", "int32 order\n---\nint32[] sequence\n---\nint32[] sequence\n"),
    ):
        folder = tmp_path / "example_interfaces" / kind
        folder.mkdir(parents=True)
        (folder / f"{name}.{kind}").write_text(text)
    codec = ros2_codec(Schema(tmp_path), "jazzy")
    for full, expected in (
        ("srv/AddTwoInts", "e118de6bf5eeb66a2491b5bda11202e7b68f198d6f67922cf30364858239c81a"),
        ("Fibonacci_SendGoal_Request", "3d088942b413247db536576f0286768c6be8fcd5d0c9a5d544f359fba090a238"),
        ("Fibonacci_GetResult_Request", "c8a4f5e7d13b81286ee1043e2ecd084281cecf1ff06aaa799464f5f15479f003"),
        ("Fibonacci_FeedbackMessage", "c1de71afd52e49a89c53d8262366884185bc0a02f78ce051c4e46b0a7fe59bb2"),
    ):
        kind = "" if "/" in full else "action/"
        assert hash_of(codec, f"example_interfaces/{kind}{full}") == f"RIHS01_{expected}"


def test_a_message_and_an_action_of_one_name_have_hashes_of_their_own():
    codec = ros2_codec(S, "jazzy")
    message, action = (codec.type_hash("control_msgs/GripperCommand", kind) for kind in ("msg", "action"))
    assert message != action
    assert message.endswith(dict(RECORDED)["control_msgs/msg/GripperCommand"])
    assert action.endswith(dict(RECORDED)["control_msgs/action/GripperCommand"])


def test_humble_has_no_hashes():
    assert ros2_codec(S, "humble").type_hash("std_msgs/String") is None
