"""`armcell run SCRIPT.py --cell CELL`: exit status, arguments, imports, errors, Ctrl-C."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import threading
import time

import pytest
from tests.programs import Program

from armcell.cell import load
from armcell.cli.main import main
from armcell.core import InputError
from armcell.drivers.fake import FakeDriver
from armcell.moveit import current_session, run_script
from armcell.records import read_record

CTRL_C = "import signal, threading; threading.Timer(0.5, signal.raise_signal, [signal.SIGINT]).start()\n"
"""To a script by itself, so that it is under way when it comes."""
MOVING = """
import rospy
from moveit_commander import MoveGroupCommander
rospy.init_node("mover")
arm = MoveGroupCommander("panda_arm")
arm.set_max_velocity_scaling_factor(0.02)
arm.set_joint_value_target("panda_joint1", 2.5)
arm.go({wait})
"""


def run(tmp_path, text, *arguments, **kwargs):
    file = tmp_path / "script.py"
    file.write_text(text)
    live = load("panda_table").connect("fake", None, time_scale=20.0)
    return run_script(file, live, arguments, quiet=True, **kwargs)


@pytest.mark.slow
def test_exit_status_and_arguments(tmp_path):
    (tmp_path / "beside.py").write_text("NUMBER = 5\n")
    text = "import sys, beside\nfrom rospy import myargv\nassert __name__ == '__main__'\n"
    text += "assert sys.argv[1:] == ['a', 'x:=1'] and len(myargv()) == 2\nsys.exit(beside.NUMBER)\n"
    assert run(tmp_path, text, "a", "x:=1")[0] == 5
    assert run(tmp_path, "pass\n")[0] == 0
    assert "rospy" not in sys.modules and "geometry_msgs.msg" not in sys.modules


def test_an_error_shows_the_scripts_own_lines(tmp_path, capsys):
    text = "from moveit_commander import MoveGroupCommander\narm = MoveGroupCommander('panda_arm')\n\n"
    status, _ = run(tmp_path, text + "arm.set_max_velocity_scaling_factor(7)\n")
    shown = capsys.readouterr().err
    assert status == 1 and "script.py" in shown and "line 4" in shown and "MoveItCommanderException" in shown
    assert "armcell/moveit" not in shown and "runpy" not in shown


TALKING = """
import actionlib, rospy, tf2_ros
from control_msgs.msg import GripperCommandAction
from std_msgs.msg import String
rospy.init_node("talker")
heard = rospy.Subscriber("/talk", String, print)
listener = tf2_ros.TransformListener(tf2_ros.Buffer())
server = actionlib.SimpleActionServer("/grip", GripperCommandAction, print)
client = actionlib.SimpleActionClient("/grip", GripperCommandAction)
timer = rospy.Timer(rospy.Duration(0.1), lambda event: None)
rospy.loginfo_once("once")
rospy.sleep(0.5)
"""


@pytest.mark.slow
def test_nothing_is_left_running(tmp_path):
    before = threading.active_count()
    status, session = run(tmp_path, TALKING)
    end = time.monotonic() + 5
    while threading.active_count() > before and time.monotonic() < end:
        time.sleep(0.01)
    assert status == 0 and threading.active_count() <= before, threading.enumerate()
    assert any("once" in line for line in session.lines)
    _, again = run(tmp_path, "import rospy\nrospy.loginfo_once('once')\n")
    assert any("once" in line for line in again.lines)  # once in each run
    with pytest.raises(RuntimeError, match="armcell run"):
        current_session()


@pytest.mark.slow
def test_motions_that_were_not_waited_for_are_finished(tmp_path):
    text = MOVING.format(wait="wait=False").replace("0.02", "1.0")
    _, session = run(tmp_path, text)
    assert session.served.live.driver.joint_state()["panda_joint1"] == pytest.approx(2.5, abs=2e-3)


@pytest.mark.slow
def test_ctrl_c_in_a_wait_ends_the_script_and_stops_the_arm(tmp_path):
    text = "import rospy\nrospy.on_shutdown(lambda: print('hook'))\n"
    status, session = run(tmp_path, text + CTRL_C + MOVING.format(wait=""))
    assert status == 130
    assert (
        session.served.live.driver.joint_state()["panda_joint1"] < 2.0
        and not session.served.thread.is_alive()
    )


@pytest.mark.slow
def test_ctrl_c_in_a_sleep_that_nobody_catches(tmp_path, capsys):
    status, _ = run(tmp_path, f"import rospy\n{CTRL_C}while True:\n    rospy.sleep(0.1)\n")
    assert status == 130 and "Traceback" not in capsys.readouterr().err


@pytest.mark.slow
def test_ctrl_c_is_rospys_interrupt_in_a_loop(tmp_path):
    text = f"import rospy\nrate = rospy.Rate(10)\n{CTRL_C}try:\n"
    text += "    while not rospy.is_shutdown():\n        rate.sleep()\n"
    text += "except rospy.ROSInterruptException:\n    rospy.loginfo('cleaned up')\n"
    status, session = run(tmp_path, text)
    assert status == 130 and any("cleaned up" in line for line in session.lines)


@pytest.mark.slow
def test_ctrl_c_that_a_script_catches_stops_what_it_did_not_wait_for(tmp_path):
    text = MOVING.format(wait="wait=False") + CTRL_C
    text += "try:\n    rospy.sleep(1000.0)\nexcept rospy.ROSInterruptException:\n    pass\n"
    status, session = run(tmp_path, text)
    assert status == 130 and session.served.live.driver.joint_state()["panda_joint1"] < 2.0


@pytest.mark.slow
def test_each_script_has_the_modules_beside_it(tmp_path):
    for name in ("first", "second"):
        package = tmp_path / name / "parts"
        package.mkdir(parents=True)
        (tmp_path / name / "beside.py").write_text(f"NAME = {name!r}\n")
        (package / "__init__.py").write_text("from parts.inner import NAME\n")
        (package / "inner.py").write_text(f"NAME = {name!r}\n")
        text = f"import beside, parts\nassert beside.NAME == parts.NAME == {name!r}, beside.NAME\n"
        assert run(tmp_path / name, text)[0] == 0
    assert not {"beside", "parts", "parts.inner"} & set(sys.modules)


@pytest.mark.slow
def test_installed_packages_that_are_hidden_are_told(tmp_path, monkeypatch):
    (tmp_path / "site" / "rospy").mkdir(parents=True)
    (tmp_path / "site" / "rospy" / "__init__.py").write_text("raise SystemExit('the real one')\n")
    monkeypatch.syspath_prepend(str(tmp_path / "site"))
    status, session = run(tmp_path, "import rospy\nrospy.loginfo('ours')\n")
    assert status == 0 and "hidden" in session.hints
    assert any("installed rospy" in line for line in session.lines)


def test_wrong_calls_of_the_command(tmp_path, capsys):
    script = tmp_path / "s.py"
    script.write_text("pass\n")
    assert main(["run", str(script)]) == 1 and "--cell" in capsys.readouterr().err
    assert main(["run", str(tmp_path / "no.py"), "--cell", "panda_table"]) == 1
    assert "no such script" in capsys.readouterr().err
    assert (
        main(["run", str(script), "--cell", "no_such_cell"]) == 1
        and "no_such_cell" in capsys.readouterr().err
    )
    assert main(["run", str(script), "--cell", "panda_table", "--mode", "dream"]) == 1
    with pytest.raises(InputError):
        run_script(tmp_path / "no.py", load("panda_table").connect("fake"))


NODDING = """
import sys
from moveit_commander import MoveGroupCommander
arm = MoveGroupCommander("panda_arm")
arm.set_joint_value_target("panda_joint1", 0.3)
arm.go()
sys.exit(int(sys.argv[1]))
"""


@pytest.mark.slow
@pytest.mark.cases("0")
@pytest.mark.parametrize("status", [0, 4])
def test_the_run_of_a_script_is_kept(status, tmp_path, capsys):
    script, numbers = tmp_path / "nodding.py", tmp_path / "out.json"
    script.write_text(NODDING)
    command = ["run", str(script), "--cell", "panda_table", "--mode", "fake", "--seed", "3"]
    options = ["--time-scale", "50", "--set", "objects.cube.mass=0.07", "--json", str(numbers)]
    assert main([*command, *options, "--runs", str(tmp_path / "runs"), "--", str(status)]) == status
    (folder,) = (tmp_path / "runs").iterdir()
    assert str(folder / "report.html") in capsys.readouterr().err
    record = read_record(folder)
    assert record.result is not None and record.result == json.loads(numbers.read_text())
    assert record.result["success"] is (status == 0) and record.result["seed"] == 3
    asked = f"--seed 3 --set objects.cube.mass=0.07 --time-scale 50 -- {status}"
    assert record.result["command"].endswith(asked) and "nodding.py" in (folder / "report.html").read_text()
    assert record.metadata["by"] == "the script nodding.py" and record.metadata["script"]
    assert record.metadata["values"] == {"objects.cube.mass": 0.07}
    (motion,) = (trajectory for _, trajectory in record.trajectories)
    assert motion.end.as_dict()["panda_joint1"] == pytest.approx(0.3, abs=1e-6)
    (plan,) = (event for event in record.events if event.kind == "plan")
    assert plan.text == "for a client, panda_arm" and plan.data["points"] == len(motion.times)
    assert plan.data["planner"] == "straight line" and plan.data["evidence"]["attempts"] == 1
    end = record.states[-1].joints.as_state(0.0)
    assert end.as_dict()["panda_joint1"] == pytest.approx(0.3, abs=1e-3)
    assert main(["replay", str(folder), "--execute"]) == 1
    assert "led by the script nodding.py" in capsys.readouterr().err
    assert main([*command, *options, "--headless", "--runs", str(tmp_path / "no"), "--", "0"]) == 0
    assert not (tmp_path / "no").exists()


@pytest.mark.slow
def test_of_a_cell_that_dies_the_cause_is_told_and_kept(tmp_path, capsys, monkeypatch):
    def lost(self, duration):
        if self.now > 0.5:
            raise RuntimeError("arm lost")
        real(self, duration)

    real = FakeDriver.advance
    monkeypatch.setattr(FakeDriver, "advance", lost)
    (tmp_path / "s.py").write_text("import time\ntime.sleep(1.0)\n")
    command = ["run", str(tmp_path / "s.py"), "--cell", "panda_table", "--mode", "fake", "--runs"]
    assert main([*command, str(tmp_path / "runs")]) == 1
    assert "arm lost" in capsys.readouterr().err
    (folder,) = (tmp_path / "runs").iterdir()
    record = read_record(folder)
    assert record.result is not None and record.result["message"] == "RuntimeError: arm lost"
    assert main([*command, str(tmp_path / "no"), "--frames", "overview"]) == 1
    assert "--frames needs physics" in capsys.readouterr().err and not list((tmp_path / "no").iterdir())


@pytest.mark.slow
def test_ctrl_c_while_the_last_motion_ends_keeps_the_run(tmp_path):
    """The script is over; its motion is not."""
    status, kept = None, []
    live = load("panda_table").connect("fake", None)
    (tmp_path / "s.py").write_text(CTRL_C + MOVING.format(wait="wait=False"))
    ended = lambda status, session: kept.append((status, session.served.cell.motions()))  # noqa: E731
    status, _ = run_script(tmp_path / "s.py", live, quiet=True, ended=ended)
    assert status == 130 and kept == [(130, [])]


def test_a_script_moves_real_arms_for_a_reason_only(tmp_path, capsys):
    (tmp_path / "s.py").write_text("pass\n")
    command = ["run", str(tmp_path / "s.py"), "--cell", "six_axis_pick", "--mode", "real"]
    for more in ([], ["--without-gate", " "]):
        assert main([*command, *more]) == 1
        said = capsys.readouterr().err
        assert "no campaign can show what s.py does" in said and "--without-gate" in said


@pytest.mark.slow
def test_the_command_in_a_process_of_its_own_ends_by_ctrl_c(tmp_path):
    file = tmp_path / "spin.py"
    file.write_text(
        "import rospy\nrospy.init_node('n')\nrospy.loginfo('spinning')\nrospy.spin()\nprint('after')\n"
    )
    command = [sys.executable, "-m", "armcell", "run", str(file), "--cell", "panda_table", "--mode", "fake"]
    process = Program(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stderr is not None
    while "spinning" not in process.stderr.readline():
        assert process.poll() is None
    time.sleep(1.0)  # until it spins
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=20)
    assert process.returncode == 130 and "after" in out and "Traceback" not in err
    (folder,) = (tmp_path / "runs").iterdir()
    record = read_record(folder)
    assert record.result is not None and record.result["message"].endswith("status 130, interrupted")
