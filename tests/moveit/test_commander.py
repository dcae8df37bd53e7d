"""moveit_commander: every public method, with the defaults, returns and exceptions of the original."""

from __future__ import annotations

import inspect
import re

import numpy as np
import pytest
from tests.moveit.helpers import HOME

from armcell.core import SE3
from armcell.kinematics import kinematic_tree
from armcell.ros.convert import pose_from_message

GROUP_METHODS = """
get_name stop get_active_joints get_joints get_variable_count has_end_effector_link
get_end_effector_link set_end_effector_link get_interface_description get_pose_reference_frame
set_pose_reference_frame get_planning_frame get_current_joint_values get_current_pose
get_current_rpy get_random_joint_values get_random_pose set_start_state_to_current_state
set_start_state get_current_state_bounded get_current_state get_joint_value_target
set_joint_value_target set_rpy_target set_orientation_target set_position_target set_pose_target
set_pose_targets shift_pose_target clear_pose_target clear_pose_targets set_random_target
get_named_targets set_named_target get_named_target_values remember_joint_values
get_remembered_joint_values forget_joint_values get_goal_tolerance get_goal_joint_tolerance
set_goal_joint_tolerance get_goal_position_tolerance set_goal_position_tolerance
get_goal_orientation_tolerance set_goal_orientation_tolerance set_goal_tolerance allow_looking
allow_replanning get_known_constraints get_path_constraints set_path_constraints
clear_path_constraints get_trajectory_constraints set_trajectory_constraints
clear_trajectory_constraints set_constraints_database get_planning_time set_planning_time
get_planning_pipeline_id set_planning_pipeline_id get_planner_id set_planner_id
set_num_planning_attempts set_workspace set_max_velocity_scaling_factor
set_max_acceleration_scaling_factor limit_max_cartesian_link_speed clear_max_cartesian_link_speed go
plan construct_motion_plan_request compute_cartesian_path execute attach_object detach_object pick
place set_support_surface_name retime_trajectory get_jacobian_matrix enforce_bounds
"""  # moveit_commander's documentation (Noetic)
SCENE_METHODS = """
add_object add_sphere add_cylinder add_cone add_mesh add_box add_plane attach_object attach_mesh
attach_box attach_sphere attach_cylinder clear remove_world_object remove_attached_object
get_known_object_names get_known_object_names_in_roi get_object_poses get_objects
get_attached_objects get_planning_scene apply_planning_scene make_box make_mesh make_sphere
make_cylinder make_cone make_plane
"""
ROBOT_METHODS = """
get_planning_frame get_robot_markers get_root_link get_active_joint_names get_joint_names
get_link_names get_group_names get_current_state get_current_variable_values get_joint get_link
get_group has_group get_default_owner_group
"""


# --- the surface ---
def test_every_public_method_is_there(mc):
    for cls, names in (
        (mc.MoveGroupCommander, GROUP_METHODS),
        (mc.PlanningSceneInterface, SCENE_METHODS),
        (mc.RobotCommander, ROBOT_METHODS),
    ):
        missing = [n for n in re.findall(r"\w+", names) if not callable(getattr(cls, n, None))]
        assert not missing, (cls.__name__, missing)


def test_signatures_are_the_documented_ones(mc):
    def defaults(method):
        parameters = list(inspect.signature(method).parameters.values())[1:]
        return {p.name: p.default for p in parameters if p.default is not p.empty}

    group, scene = mc.MoveGroupCommander, mc.PlanningSceneInterface
    assert defaults(group.__init__) == {
        "robot_description": "robot_description",
        "ns": "",
        "wait_for_servers": 5.0,
    }
    assert defaults(group.go) == {"joints": None, "wait": True} and defaults(group.execute) == {"wait": True}
    assert defaults(group.retime_trajectory) == {
        "velocity_scaling_factor": 1.0, "acceleration_scaling_factor": 1.0,
        "algorithm": "iterative_time_parameterization",
    }  # fmt: skip
    assert defaults(scene.__init__) == {"ns": "", "synchronous": True, "service_timeout": 5.0}
    assert defaults(scene.add_plane) == {"normal": (0, 0, 1), "offset": 0}
    assert defaults(scene.add_box) == {"size": (1, 1, 1)} and defaults(scene.add_sphere) == {"radius": 1}
    assert defaults(mc.RobotCommander.__init__) == {"robot_description": "robot_description", "ns": ""}


def test_defaults(mc):
    arm = mc.MoveGroupCommander("panda_arm")
    assert arm.get_goal_tolerance() == (1e-4, 1e-4, 1e-3) and arm.get_planning_time() == 5.0
    request = arm.construct_motion_plan_request()
    assert request.num_planning_attempts == 1 and request.start_state.is_diff
    assert (request.max_velocity_scaling_factor, request.max_acceleration_scaling_factor) == (0.1, 0.1)
    assert (request.pipeline_id, request.planner_id) == ("", "")
    assert arm.get_known_constraints() == [] and arm.get_remembered_joint_values() == {}
    with pytest.raises(RuntimeError, match="Group 'leg' was not found"):
        mc.MoveGroupCommander("leg")


def test_information(arm, mc):
    assert arm.get_name() == "panda_arm" and arm.get_end_effector_link() == "panda_hand_tcp"
    assert (
        arm.get_active_joints() == [f"panda_joint{i}" for i in range(1, 8)] and arm.get_variable_count() == 7
    )
    assert arm.get_planning_frame() == arm.get_pose_reference_frame() == "world"
    assert arm.get_interface_description().planner_ids
    hand = mc.MoveGroupCommander("hand")
    assert not hand.has_end_effector_link() and hand.get_variable_count() == 2
    with pytest.raises(mc.MoveItCommanderException, match="no end effector"):
        hand.get_current_pose()
    with pytest.raises(mc.MoveItCommanderException, match="Unable to set end effector link"):
        arm.set_end_effector_link("tail")


# --- state ---
def test_the_present_state(arm, session):
    assert np.allclose(arm.get_current_joint_values(), HOME, atol=1e-3)
    T = session.served.cell.scene().frame_pose("panda_hand_tcp")
    pose = arm.get_current_pose()
    assert pose.header.frame_id == "world" and pose_from_message(pose.pose).isclose(T, 1e-6, 1e-6)
    assert np.allclose(arm.get_current_rpy(), T.rotation.rpy)
    assert arm.get_current_pose("panda_link4").pose != pose.pose
    state = arm.get_current_state()
    assert "panda_finger_joint2" in state.joint_state.name
    state.joint_state.position = tuple(9.0 for _ in state.joint_state.position)
    bounded = dict(zip(state.joint_state.name, arm.enforce_bounds(state).joint_state.position))
    assert bounded["panda_joint1"] == pytest.approx(2.8973)
    model = session.model
    for _ in range(20):
        model.check_positions(arm.get_random_joint_values(), arm.get_active_joints())
    assert arm.get_random_pose().header.frame_id == "world"


def test_the_jacobian_by_finite_differences(arm, session):
    q = np.array(arm.get_current_joint_values())
    J = np.asarray(arm.get_jacobian_matrix(list(q), [0.0, 0.0, 0.1]))
    tree, positions = kinematic_tree(session.model), session.served.cell.scene().positions.copy()
    columns = session.model.columns(arm.get_active_joints())

    def point(values):
        positions[columns] = values
        return tree.link_pose(positions, "panda_hand_tcp").apply(np.array([0, 0, 0.1]))

    for k in range(7):
        step = 1e-6 * (np.arange(7) == k)
        assert np.allclose(J[:3, k], (point(q + step) - point(q - step)) / 2e-6, atol=1e-6)


# --- the robot ---
def test_the_robot(arm, mc):
    robot = mc.RobotCommander()
    assert robot.get_root_link() == "panda_link0" and robot.get_planning_frame() == "world"
    assert {"panda_arm", "hand"} <= set(robot.get_group_names()) and robot.has_group("hand")
    assert "panda_finger_joint2" in robot.get_joint_names() and "panda_hand" in robot.get_link_names()
    assert robot.get_active_joint_names("panda_arm") == arm.get_active_joints()
    assert robot.get_default_owner_group("panda_joint1") == "panda_arm"
    joint = robot.get_joint("panda_joint1")
    assert joint.bounds() == [joint.min_bound(), joint.max_bound()] and joint.variable_count() == 1
    assert joint.move(0.3) and joint.value() == pytest.approx(0.3, abs=2e-3)
    assert robot.panda_arm.get_name() == "panda_arm" and robot.panda_joint1.name() == "panda_joint1"
    T = pose_from_message(robot.get_link("panda_link0").pose().pose)
    assert T.isclose(SE3.identity(), 1e-9, 1e-9)
    assert robot.get_current_variable_values()["panda_joint1"] == pytest.approx(0.3, abs=2e-3)
    assert len(robot.get_robot_markers().markers) > 8
    for wrong in (lambda: robot.get_group("leg"), lambda: robot.get_joint("x"), lambda: robot.get_link("x")):
        with pytest.raises(mc.MoveItCommanderException):
            wrong()
    with pytest.raises(AttributeError):
        robot.no_such_part  # noqa: B018


# --- conversions ---
def test_conversions(mc):
    from geometry_msgs.msg import Pose

    values = [0.1, 0.2, 0.3, 0.0, 0.0, 0.6, 0.8]
    pose = mc.conversions.list_to_pose(values)
    assert mc.conversions.pose_to_list(pose) == values
    assert mc.conversions.list_to_pose([0, 0, 0, np.pi, 0, 0]).orientation.x == pytest.approx(1.0)
    assert mc.conversions.list_to_pose_stamped(values, "base").header.frame_id == "base"
    assert mc.conversions.transform_to_list(mc.conversions.list_to_transform(values)) == values
    copy = Pose()
    mc.conversions.msg_from_string(copy, mc.conversions.msg_to_string(pose))
    assert copy == pose
    with pytest.raises(mc.MoveItCommanderException, match="6 or 7"):
        mc.conversions.list_to_pose([1, 2])
