"""`armcell msg`."""

import pytest
from tests.cli.helpers import call


def test_list_gives_sums_of_messages_and_services(capsys):
    done = call(capsys, "msg", "list", "moveit_msgs")
    assert done.status == 0
    lines = done.out.splitlines()
    assert "srv  efb729a4de517c3ff2c8a1e540017b30  moveit_msgs/GetPositionIK" in lines
    assert "msg  acfc50bcfd6c7b978066bfa7c786002c  moveit_msgs/PlanningScene" in lines
    assert all("moveit_msgs/" in line for line in lines)


def test_show(capsys):
    assert "float64[] position\n" in call(capsys, "msg", "show", "sensor_msgs/msg/JointState").out
    assert call(capsys, "msg", "show", "std_srvs/SetBool").out.startswith("bool data\n---\nbool success\n")
    assert call(capsys, "msg", "show", "moveit_msgs/MoveGroup").out.count("---") == 2
    assert "MSG: std_msgs/Header" in call(capsys, "msg", "show", "sensor_msgs/JointState", "--full").out


def test_generate_with_own_definitions(tmp_path, capsys):
    (tmp_path / "own" / "my_msgs" / "msg").mkdir(parents=True)
    (tmp_path / "own" / "my_msgs" / "msg" / "Weld.msg").write_text("float64 force\n")
    arguments = ["msg", "generate", "my_msgs", "--from", str(tmp_path / "own")]
    done = call(capsys, *arguments, "--csharp", str(tmp_path / "cs"), "--python", str(tmp_path / "py"))
    assert done.status == 0, done.err
    assert "public double force;" in (tmp_path / "cs" / "My" / "msg" / "WeldMsg.cs").read_text()
    assert "force: float" in (tmp_path / "py" / "my_msgs" / "msg.py").read_text()


@pytest.mark.slow
def test_mistakes_are_one_line(tmp_path, capsys):
    for arguments, reason in (
        (["show", "sensor_msgs/JointStat"], "did you mean"),
        (["list", "nope_msgs"], "unknown message package"),
        (["generate"], "give --csharp"),
        (["list", "--from", str(tmp_path / "none")], "is not a folder"),
        (["generate", "--csharp", "/proc/x"], "cannot write there"),
    ):
        done = call(capsys, "msg", *arguments)
        assert done.status == 1
        assert reason in done.err and len(done.err.splitlines()) == 1
