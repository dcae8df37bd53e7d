"""A run that touched something, or lost an object, fails: on the console, in the result, by exit status."""

from __future__ import annotations

import json

import pytest

from armcell.cli.main import main

pytestmark = pytest.mark.slow

REACH = """
import rospy
from moveit_commander import MoveGroupCommander
rospy.init_node("reach")
arm = MoveGroupCommander("panda_arm")
arm.set_max_velocity_scaling_factor(1.0)
arm.set_max_acceleration_scaling_factor(1.0)
p = arm.get_current_pose().pose
p.position.x, p.position.y, p.position.z = 0.40, 0.10, 0.16
arm.set_pose_target(p)
arm.go()
p.position.y = -0.25
arm.set_pose_target(p)
arm.go()
"""
HOLD = """
import rospy
from moveit_commander import MoveGroupCommander
rospy.init_node("hold")
arm = MoveGroupCommander("panda_arm")
arm.set_max_velocity_scaling_factor(1.0)
arm.set_max_acceleration_scaling_factor(1.0)
assert arm.pick("cube") == 1
{lose}
rospy.sleep(0.5)
"""
LOSE = """
from armcell.core import SE3
from armcell.moveit import current_session
served = current_session().served
served.call(lambda: served.live.driver.world.set_object_pose("cube", SE3.from_xyz(0.4, -0.3, 0.03)))
"""


def run(tmp_path, capsys, text, *options):
    script, out = tmp_path / "script.py", tmp_path / "out.json"
    script.write_text(text)
    arguments = ["run", str(script), "--cell", "panda_table", "--time-scale", "20", "--headless"]
    status = main([*arguments, "--json", str(out), *options])
    return status, json.loads(out.read_text()), capsys.readouterr().err


@pytest.mark.long
def test_a_script_that_touches_something_fails(tmp_path, capsys):
    """The cube is not where the planner believes it: higher, in the way of the hand."""
    moved = "disturbances.moved.cube={by: [0.0, -0.15, 0.0]}"
    tall = "objects.cube.box=[0.05, 0.05, 0.30]"
    place = "objects.cube.pose=[0.40, 0.50, 0.15]"
    status, result, said = run(
        tmp_path, capsys, REACH, "--set", tall, "--set", place,
        "--set", "disturbances.moved.cube={by: [0.0, -0.58, 0.0]}",
    )  # fmt: skip
    assert moved and status == 1 and not result["success"]
    contact = result["unwanted_contacts"][0]
    assert "cube" in (contact["body_a"], contact["body_b"])
    assert "unwanted contact: " in said and "cube" in said and " mm deep" in said


def test_a_script_that_loses_an_object_fails(tmp_path, capsys):
    status, result, said = run(tmp_path, capsys, HOLD.format(lose=LOSE))
    assert status == 1 and not result["success"] and result["lost"][0]["object"] == "cube"
    assert "lost object: cube" in said


def test_a_script_that_holds_its_object_succeeds(tmp_path, capsys):
    status, result, said = run(tmp_path, capsys, HOLD.format(lose=""))
    assert status == 0 and result["success"] and result["lost"] == [] and "lost" not in said
