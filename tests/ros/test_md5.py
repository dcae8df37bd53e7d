"""Type names and md5 sums against those of a running Noetic system."""

from pathlib import Path

import pytest

from armcell.core import InputError, UnknownNameError
from armcell.ros.schema import Schema, schema

RECORDED = [line.split() for line in (Path(__file__).parent / "md5_noetic.txt").read_text().splitlines()[1:]]


def test_the_record_is_whole():
    assert len(RECORDED) > 180


@pytest.mark.slow
@pytest.mark.parametrize(("name", "md5"), RECORDED, ids=[name for name, _ in RECORDED])
def test_md5_is_the_real_one(name, md5):
    assert schema().md5(name) == md5
    package, item = name.split("/")
    assert schema().md5(f"{package}/msg/{item}") == md5


@pytest.mark.parametrize(
    ("name", "md5"),
    [
        ("RobotMode", "73b72d58742c4889c47118411b03a3b4"),
        ("SafetyMode", "5da08725a63d4237bad689481131a84b"),
    ],
)
def test_md5_of_ur_s_modes_is_that_of_its_ros_driver(name, md5):
    """Computed by genmsg's rule from the files of Universal_Robots_ROS_Driver 2.1.5."""
    assert schema().md5(f"ur_dashboard_msgs/{name}") == md5


def test_every_described_type_of_moveit_and_control_is_recorded():
    recorded = {name for name, _ in RECORDED}
    known = schema()
    parts = {f"{s}{part}" for s in known.services for part in ("Request", "Response")}
    ours = {
        n for n in [*known.messages, *known.services] if n.split("/")[0] in ("moveit_msgs", "control_msgs")
    }
    assert {n for n in ours - parts - known.ros2_only if n in known.messages} <= recorded


def test_full_text_has_each_nested_type_once():
    text = schema().full_text("sensor_msgs/JointState")
    assert text.count("MSG: std_msgs/Header") == 1
    assert text.startswith("std_msgs/Header header\nstring[] name\n")
    assert "time stamp" in text and "builtin_interfaces" not in text


def test_unknown_type_names_the_nearest():
    with pytest.raises(UnknownNameError, match="did you mean 'sensor_msgs/JointState'"):
        schema().message("sensor_msgs/JointStates")
    with pytest.raises(UnknownNameError, match="service type"):
        schema().service("sensor_msgs/JointState")


def test_own_definitions_are_added(tmp_path):
    folder = tmp_path / "my_msgs"
    for kind in ("msg", "srv", "action"):
        (folder / kind).mkdir(parents=True)
    (folder / "msg" / "Weld.msg").write_text("# a weld\nfloat64 force # N\nint8 ON=1\nWeld2[] more\n")
    (folder / "msg" / "Weld2.msg").write_text("string name\n")
    (folder / "srv" / "Cut.srv").write_text("Weld weld\n---\nbool ok\n")
    (folder / "action" / "Sew.action").write_text("Weld weld\n---\n---\n")
    own = Schema(tmp_path)
    assert own.new("my_msgs/Weld", force=2.0).ON == 1
    assert own.service("my_msgs/Cut")[0]().weld.force == 0.0
    assert own.new("my_msgs/SewActionGoal").goal.weld.more == []
    assert own.md5("sensor_msgs/JointState") == schema().md5("sensor_msgs/JointState")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("path", "text", "reason"),
    [
        ("a_msgs/msg/A.msg", "float64\n", "not a message definition"),
        ("a_msgs/msg/A.msg", "Missing x\n", "a_msgs/Missing, which is not defined"),
        ("a_msgs/srv/A.srv", "float64 x\n", "1 sections, need 2"),
        ("std_msgs/msg/String.msg", "float64 data\n", "defined twice"),
        ("a_msgs/msg/A-B.msg", "float64 x\n", "no message name"),
        ("a_msgs/A.txt", "float64 x\n", "no message definitions"),
    ],
)
def test_bad_definitions_say_what_is_wrong(tmp_path, path, text, reason):
    file = tmp_path / path
    file.parent.mkdir(parents=True)
    file.write_text(text)
    with pytest.raises(InputError, match=reason):
        Schema(tmp_path)
