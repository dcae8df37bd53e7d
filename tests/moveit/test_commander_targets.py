"""Targets and settings of a MoveGroupCommander."""

from __future__ import annotations

import numpy as np
import pytest
from tests.moveit.helpers import HOME, stamped

from armcell.ros.convert import pose_from_message


# --- targets ---
def test_joint_targets_in_all_their_forms(arm, mc):
    from sensor_msgs.msg import JointState

    values = [v + 0.1 for v in HOME]
    names = arm.get_active_joints()
    for target in (
        values,
        tuple(values),
        np.array(values),
        dict(zip(names, values)),
        JointState(name=names, position=values),
    ):
        arm.set_joint_value_target(list(HOME))
        assert arm.set_joint_value_target(target)
        assert np.allclose(arm.get_joint_value_target(), values)
    arm.set_joint_value_target("panda_joint1", 0.5)
    assert arm.get_joint_value_target()[0] == 0.5
    state = arm.get_current_state()
    arm.set_joint_value_target(state)
    assert np.allclose(arm.get_joint_value_target(), HOME, atol=1e-3)
    arm.set_joint_value_target(stamped(0.45, 0.1, 0.4))
    arm.go()
    p = arm.get_current_pose().pose.position
    assert np.allclose((p.x, p.y, p.z), (0.45, 0.1, 0.4), atol=2e-3)


@pytest.mark.parametrize(
    "arguments, text",
    [
        ((["a"],), "joint"), (([0.1, 0.2],), "7 joints"), (("panda_joint1",), "Joint value expected"),
        (("elbow", 0.1), "elbow"), (("panda_joint1", 4.0), "within bounds"),
        (("panda_joint1", 90.0), "degrees"),
        ((3.0,), "Unsupported argument"), (([0.0] * 7, 1), "Too many arguments"),
    ],
)  # fmt: skip
def test_joint_targets_that_cannot_be(arm, mc, arguments, text):
    with pytest.raises(mc.MoveItCommanderException, match=text):
        arm.set_joint_value_target(*arguments)


def test_pose_targets_in_all_their_forms(arm, mc):
    pose = stamped(0.4, 0.1, 0.3)
    for target in (pose, pose.pose, [0.4, 0.1, 0.3, np.pi, 0, 0], [0.4, 0.1, 0.3, 1, 0, 0, 0]):
        arm.clear_pose_targets()
        arm.set_pose_target(target)
        ok, trajectory, seconds, code = arm.plan()
        assert ok and code.val == 1 and seconds > 0 and trajectory.joint_trajectory.points
    cube = pose_from_message(mc.PlanningSceneInterface().get_object_poses(["cube"])["cube"])
    arm.set_pose_target(stamped(0.0, 0.0, 0.2, "cube"))  # in another frame
    assert arm.go()
    at = pose_from_message(arm.get_current_pose().pose)
    assert np.allclose(at.translation, cube.apply(np.array([0, 0, 0.2])), atol=2e-3)
    arm.set_pose_targets([[3.0, 0, 0, np.pi, 0, 0], pose.pose])  # any one of them
    assert arm.plan()[0]
    with pytest.raises(mc.MoveItCommanderException):
        arm.set_pose_target([1, 2])
    with pytest.raises(mc.MoveItCommanderException, match="roll, pitch, yaw"):
        arm.set_rpy_target([1, 2])


def test_a_pose_that_changes_after_it_was_given_changes_nothing(arm):
    pose = stamped(0.4, 0.1, 0.3)
    arm.set_pose_target(pose)
    pose.pose.position.z = 5.0
    assert arm.plan()[0]


def test_position_orientation_and_shifts(arm):
    arm.set_position_target([0.4, 0.0, 0.4])
    assert arm.go()
    assert np.allclose(pose_from_message(arm.get_current_pose().pose).translation, (0.4, 0, 0.4), atol=2e-3)
    arm.set_rpy_target([np.pi, 0.0, 0.5])
    assert arm.go()
    assert np.allclose(np.abs(arm.get_current_rpy()), (np.pi, 0, 0.5), atol=5e-3)
    before = pose_from_message(arm.get_current_pose().pose)
    arm.shift_pose_target(2, -0.05)
    assert arm.go()
    moved = pose_from_message(arm.get_current_pose().pose)
    assert np.allclose(moved.translation - before.translation, (0, 0, -0.05), atol=2e-3)


def test_named_and_remembered_targets(arm, mc):
    assert {"home", "extended"} <= set(arm.get_named_targets())
    assert arm.get_named_target_values("home")["panda_joint4"] == pytest.approx(-2.35619449)
    assert arm.get_named_target_values("nowhere") == {}
    arm.set_named_target("home")
    with pytest.raises(mc.MoveItCommanderException, match="Unable to set target nowhere"):
        arm.set_named_target("nowhere")
    arm.remember_joint_values("here")
    arm.remember_joint_values("there", [v + 0.1 for v in HOME])
    assert arm.go("there")
    assert np.allclose(arm.get_current_joint_values(), np.array(HOME) + 0.1, atol=2e-3)
    arm.set_named_target("here")
    assert arm.go() and set(arm.get_remembered_joint_values()) == {"here", "there"}
    arm.forget_joint_values("here")
    assert "here" not in arm.get_named_targets()


def test_the_values_of_a_group_are_those_of_its_mimic_joints_too(arm, mc):
    hand = mc.MoveGroupCommander("hand")
    hand.set_joint_value_target("panda_finger_joint1", 0.02)
    assert hand.get_joint_value_target() == [0.02, 0.02]
    for values in (hand.get_random_joint_values(), hand.get_current_joint_values()):
        assert len(values) == hand.get_variable_count() == 2 and values[0] == values[1]
    hand.set_joint_value_target([0.03, 0.03])
    (goal,) = hand.construct_motion_plan_request().goal_constraints
    assert [(c.joint_name, c.position) for c in goal.joint_constraints] == [("panda_finger_joint1", 0.03)]


# --- settings ---
def test_settings_reach_the_request(arm, mc):
    from moveit_msgs.msg import Constraints, OrientationConstraint

    arm.set_goal_tolerance(0.005)
    assert arm.get_goal_tolerance() == (0.005, 0.005, 0.005)
    arm.set_planning_time(2.0)
    arm.set_planning_time(-1.0)  # changes nothing
    arm.set_num_planning_attempts(4)
    arm.set_planner_id("RRTConnectkConfigDefault")
    arm.set_planning_pipeline_id("ompl")
    arm.set_workspace([-1, -1, 1, 1])
    arm.limit_max_cartesian_link_speed(0.2, "panda_hand")
    level = Constraints(orientation_constraints=[OrientationConstraint(link_name="panda_hand")])
    arm.set_path_constraints(level)
    request = arm.construct_motion_plan_request()
    assert (request.allowed_planning_time, request.num_planning_attempts) == (2.0, 4)
    assert (request.planner_id, request.pipeline_id) == ("RRTConnectkConfigDefault", "ompl")
    assert request.workspace_parameters.min_corner.x == -1 and request.max_cartesian_speed == 0.2
    assert arm.get_path_constraints() == level == request.path_constraints
    arm.clear_path_constraints()
    assert not arm.get_path_constraints().orientation_constraints
    for bad in (0.0, 1.5, -1):
        with pytest.raises(mc.MoveItCommanderException, match="range from 0 to 1"):
            arm.set_max_velocity_scaling_factor(bad)
    with pytest.raises(mc.MoveItCommanderException, match="0, 4 or 6"):
        arm.set_workspace([1, 2])
    with pytest.raises(mc.MoveItCommanderException, match="path constraints"):
        arm.set_path_constraints("upright")
