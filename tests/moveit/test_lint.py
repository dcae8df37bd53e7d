"""`armcell lint`: each trap on its line, and nothing where there is none."""

from __future__ import annotations

import json

import pytest
from tests.moveit.helpers import SCRIPTS

from armcell.cli.main import main
from armcell.core import InputError
from armcell.moveit.lint import RULES, commands_gripper, lint, lint_text

HEAD = """import copy, math, time
import rospy
from moveit_commander import MoveGroupCommander, PlanningSceneInterface
rospy.init_node("n")
arm = MoveGroupCommander("arm")
arm.set_max_velocity_scaling_factor(0.5)
"""
LINE = HEAD.count("\n") + 1


def found(text):
    return [(f.line, f.rule) for f in lint_text(HEAD + text)]


@pytest.mark.parametrize(
    "text, rule",
    [
        ("arm.compute_cartesian_path(w, 0.01, 0.0)", "jump-threshold"),
        ("if not arm.set_joint_value_target([0]): pass", "returns-none"),
        ("arm.get_last_planning_result()", "no-such-name"),
        ("from moveit_msgs.msg import GetPlanningScene", "no-such-name"),
        ("from moveit_msgs.msg import PathConstraints", "no-such-name"),
        ("from moveit_commander import GraspGenerator", "no-such-name"),
        ("arm.execute(p, wait=False)", "two-at-once"),
        ("arm.go([0, 90, 0, -45.5, 0, 0])", "degrees"),
        ("arm.set_joint_value_target('a', 180)", "degrees"),
        ("time.sleep(1)", "wall-clock"),
        ("t = time.time()", "wall-clock"),
        ("arm.set_max_acceleration_scaling_factor(2)", "scaling"),
        ("rospy.loginfo('please close the gripper')", "no-gripper"),
        ("print 'old'", "syntax"),
    ],
)
def test_a_trap_is_found_on_its_line(text, rule):
    assert (LINE, rule) in found(text)


@pytest.mark.parametrize(
    "text",
    [
        "arm.compute_cartesian_path(w, 0.01, True)",
        "arm.compute_cartesian_path(w, 0.01, avoid_collisions=True)",
        "ok, trajectory, _, _ = arm.plan()\nif ok: arm.execute(trajectory)",
        "plan = arm.plan()\nif plan[0]: arm.execute(plan[1])",
        "p = copy.deepcopy(q.pose)\np.position.z += 0.1",
        "arm.go([0, math.radians(90), 0, -1.5, 0, 6.28])",
        "rospy.sleep(1)",
        "from moveit_msgs.srv import GetPlanningScene",
        "from moveit_msgs.msg import Grasp, MoveItErrorCodes",
        "MoveGroupCommander('gripper').go()\nrospy.loginfo('close the gripper')",
        "quaternion_from_euler(math.pi, 0, 3.1)",
    ],
)
def test_what_is_right_is_not_complained_of(text):
    assert found(text) == []


def test_the_tuple_of_plan():
    text = "plan = arm.plan()\nif plan and not plan:\n    arm.execute(plan)\n"
    assert found(text) == [(LINE + 1, "plan-tuple"), (LINE + 2, "plan-tuple")]


def test_a_pose_of_two_names_is_told_where_something_is_added_to_one():
    share = "p.pose = object_pose\n"
    assert found(share) == []
    assert (LINE, "shared-pose") in found(share + "p.pose.position.z += 0.1\n")


def test_what_go_does_without_waiting_is_not_what_execute_does():
    (execute,) = lint_text(HEAD + "arm.execute(p, wait=False)")
    (go,) = lint_text(HEAD + "arm.go(wait=False)")
    assert execute.rule == go.rule == "two-at-once" and "ends this motion" in go.text
    assert "armcell moves both" in execute.hint and "execute" in go.hint


def test_a_guessed_wait():
    text = "def f(t):\n    s = t.points[-1].time_from_start.to_sec()\n    rospy.sleep(s + 0.5)\n"
    assert found(text) == [(LINE + 2, "guessed-wait")]


def test_what_is_missing():
    text = "from moveit_commander import MoveGroupCommander\narm = MoveGroupCommander('a')\narm.go()\n"
    assert [(f.line, f.rule) for f in lint_text(text)] == [(2, "no-node"), (3, "slow")]


def test_nothing_is_run(tmp_path):
    file = tmp_path / "s.py"
    file.write_text(f"open({str(tmp_path / 'ran')!r}, 'w')\nraise SystemExit(3)\n")
    assert lint(file) == [] and not (tmp_path / "ran").exists()
    with pytest.raises(InputError):
        lint(tmp_path / "none.py")
    file.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="UTF-8"):
        lint(file)


def test_deep_and_broken_texts_end_in_a_finding():
    for text in ("(" * 500, "x = " + "-" * 20_000 + "1", "\0", "def f(:\n"):
        assert [f.rule for f in lint_text(text)] == ["syntax"]


def test_rules_are_many_and_each_has_a_cure():
    every = {f for text in ("arm.go([400]*1)", "time.sleep(1)") for f in lint_text(HEAD + text)}
    assert len(RULES) >= 10 and all(f.hint and f.text for f in every)


@pytest.mark.skipif(not SCRIPTS.is_dir(), reason="the users' scripts are in ../shared")
@pytest.mark.parametrize(
    "name, wanted",
    [
        (
            "dual_arm_task.py",
            {(25, "plan-tuple"), (26, "plan-tuple"), (26, "two-at-once"), (27, "plan-tuple")},
        ),
        (
            "grasp_action_server.py",
            {(31, "shared-pose"), (41, "slow"), (61, "no-gripper"), (73, "guessed-wait")},
        ),
        ("pick_and_place.py", {(88, "jump-threshold")}),
    ],
)
def test_the_users_scripts(name, wanted):
    assert {(f.line, f.rule) for f in lint(SCRIPTS / name)} == wanted


def test_scripts_that_move_a_gripper_are_told_from_those_that_do_not():
    import ast

    from armcell.moveit.lint import Script

    def moves(text):
        return commands_gripper(Script(ast.parse(text)))

    assert moves("MoveGroupCommander('gripper')") and moves("arm.pick('cube')")
    assert moves("rospy.Publisher('/gripper_command', Float64)") and not moves("arm.go()")


def test_the_command(tmp_path, capsys):
    bad, good = tmp_path / "bad.py", tmp_path / "good.py"
    bad.write_text(HEAD + "time.sleep(1)\n")
    good.write_text(HEAD)
    assert main(["lint", str(good)]) == 0 and "no known traps" in capsys.readouterr().out
    assert main(["lint", str(bad), str(good)]) == 1
    out = capsys.readouterr().out
    assert f"{bad}:{LINE}: wall-clock: " in out and "rospy.sleep" in out
    assert main(["lint", "--json", str(bad)]) == 1
    assert json.loads(capsys.readouterr().out)[0]["line"] == LINE
    assert main(["lint", str(tmp_path / "none.py")]) == 1 and "none.py" in capsys.readouterr().err
