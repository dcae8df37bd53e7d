"""What a MoveGroupCommander does: plans, executions, lines, retiming, pick and place."""

from __future__ import annotations

import time

import numpy as np
import pytest
from tests.moveit.helpers import HOME, stamped

from armcell.ros.convert import pose_from_message


# --- acting ---
def test_plan_and_execute(arm):
    ok, trajectory, _, code = arm.plan(dict(zip(arm.get_active_joints(), np.array(HOME) + 0.2)))
    assert ok and code.val == 1
    assert arm.execute(trajectory) is True
    assert np.allclose(arm.get_current_joint_values(), np.array(HOME) + 0.2, atol=2e-3)
    assert arm.execute(trajectory) is False  # from where it no longer is


def test_a_plan_that_fails_says_so_and_is_not_executed(arm, session):
    arm.set_pose_target(stamped(3.0, 0.0, 0.0))
    plan = arm.plan()
    assert plan[0] is False and plan[3].val < 0
    assert plan  # the tuple itself is true, as in MoveIt
    assert arm.execute(plan) is False and "plan tuple" in session.hints


def test_the_tuple_of_plan_is_executed_as_its_trajectory(arm):
    arm.set_named_target("extended")
    assert arm.execute(arm.plan()) is True


@pytest.mark.slow
def test_async_motion_and_stop(arm):
    arm.set_max_velocity_scaling_factor(0.005)
    before = arm.get_current_joint_values()
    assert arm.go([v + 0.5 for v in HOME], wait=False) is True
    end = time.monotonic() + 20
    while arm.get_current_joint_values()[0] < before[0] + 2e-3 and time.monotonic() < end:
        time.sleep(0.005)
    arm.stop()
    time.sleep(0.2)
    there = arm.get_current_joint_values()
    assert there[0] > before[0] + 1e-3 and there[0] < before[0] + 0.45
    time.sleep(0.1)
    assert np.allclose(arm.get_current_joint_values(), there, atol=1e-3)


def test_a_newer_go_ends_one_that_was_not_waited_for_of_another_group_too(arm, mc):
    """As MoveIt: one move_group action serves all groups. `execute` moves groups side by side."""
    arm.set_max_velocity_scaling_factor(0.005)
    assert arm.go([v + 0.5 for v in HOME], wait=False) is True
    assert mc.MoveGroupCommander("hand").go([0.03, 0.03])
    there = arm.get_current_joint_values()
    assert there[0] < HOME[0] + 0.45
    time.sleep(0.1)
    assert np.allclose(arm.get_current_joint_values(), there, atol=1e-3)


def test_a_start_state_of_ones_own(arm):
    state = arm.get_current_state()
    state.joint_state.position = tuple(
        0.5 if n == "panda_joint1" else p for n, p in zip(state.joint_state.name, state.joint_state.position)
    )
    arm.set_start_state(state)
    arm.set_named_target("home")
    first = arm.plan()[1].joint_trajectory.points[0]
    assert first.positions[0] == pytest.approx(0.5)
    arm.set_start_state_to_current_state()
    assert arm.plan()[1].joint_trajectory.points[0].positions[0] == pytest.approx(0.0, abs=1e-3)


def test_cartesian_paths_and_the_argument_that_changed_its_meaning(arm, session):
    import copy

    here = arm.get_current_pose().pose
    down = copy.deepcopy(here)
    down.position.z -= 0.1
    for more in ((), (0.0,), (True,), (0.0, True), (0.0, True, None)):
        trajectory, fraction = arm.compute_cartesian_path([down], 0.01, *more)
        assert fraction == 1.0 and trajectory.joint_trajectory.points
    assert "jump_threshold" in session.hints
    assert arm.execute(trajectory)
    at = pose_from_message(arm.get_current_pose().pose)
    assert at.translation[2] == pytest.approx(down.position.z, abs=2e-3)
    through = copy.deepcopy(here)
    through.position.z = -0.05  # into the table
    assert arm.compute_cartesian_path([through], 0.01, 0.0)[1] < 1.0
    assert arm.compute_cartesian_path([through], 0.01, 0.0, False)[1] == 1.0  # collisions not looked at
    assert arm.compute_cartesian_path([through], 0.01, False)[1] == 1.0


def test_a_line_that_ends_early_and_an_empty_plan_are_not_executed(arm, mc, session):
    import copy

    from moveit_msgs.msg import RobotTrajectory

    before = arm.get_current_joint_values()
    through = copy.deepcopy(arm.get_current_pose().pose)
    through.position.z = -0.05  # into the table
    plan, fraction = arm.compute_cartesian_path([through], 0.01)
    assert 0 < fraction < 1 and arm.execute(plan) is False
    assert any("[HINT]" in line and f"ends after {fraction:.0%}" in line for line in session.lines)
    assert arm.execute(RobotTrajectory()) is False and arm.execute(RobotTrajectory(), wait=False) is False
    assert any("[HINT]" in line and "the plan is empty" in line for line in session.lines)
    assert arm.get_current_joint_values() == pytest.approx(before, abs=1e-4)
    assert arm.execute(plan.joint_trajectory) is True  # on purpose, as far as it leads


def test_retiming(arm):
    arm.set_named_target("extended")
    trajectory = arm.plan()[1]
    fast = arm.retime_trajectory(arm.get_current_state(), trajectory)
    slow = arm.retime_trajectory(arm.get_current_state(), trajectory, velocity_scaling_factor=0.25)

    def seconds(message):
        return message.joint_trajectory.points[-1].time_from_start.to_sec()

    assert seconds(slow) > 2 * seconds(fast)
    ends = [m.joint_trajectory.points[-1].positions for m in (trajectory, fast, slow)]
    assert np.allclose(ends[0], ends[1]) and np.allclose(ends[0], ends[2])
    assert not arm.retime_trajectory(None, trajectory, algorithm="magic").joint_trajectory.points


# --- grasping, as objects move without physics ---
@pytest.mark.slow
def test_pick_and_place(arm, scene, mc):
    assert arm.pick("nothing") == -19  # INVALID_OBJECT_NAME
    assert arm.pick("cube") == 1
    assert "cube" in scene.get_attached_objects() and "cube" not in scene.get_known_object_names()
    target = stamped(0.40, -0.15, 0.0255)
    target.pose.orientation.x, target.pose.orientation.w = 0.0, 1.0
    assert arm.place("cube", target) is True
    assert "cube" in scene.get_known_object_names()
    at = pose_from_message(scene.get_object_poses(["cube"])["cube"]).translation
    assert np.allclose(at[:2], (0.40, -0.15), atol=2e-3)
    assert arm.place("cube", target) is False  # pick gives the code, place gives whether
    with pytest.raises(mc.MoveItCommanderException, match="location"):
        arm.place("cube", ["here"])
