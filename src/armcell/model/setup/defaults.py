"""Default contents of MoveIt's YAML files for a robot that `armcell setup` configures."""

from __future__ import annotations

from typing import Any

import numpy as np

from armcell.model.robot import Group, RobotModel
from armcell.model.setup.planners import PLANNERS, config_name, planner_configs

VELOCITY, ACCELERATION = 1.0, 1.0
"""Default velocity and acceleration [rad/s, rad/s^2; m/s, m/s^2] of a joint without limits.

MoveIt's time parameterization uses the same values (TimeOptimalTrajectoryGeneration: DEFAULT_VELOCITY_LIMIT,
DEFAULT_ACCELERATION_LIMIT).
"""

SOLVER = "kdl_kinematics_plugin/KDLKinematicsPlugin"
MANAGER = "moveit_simple_controller_manager/MoveItSimpleControllerManager"


def joint_limits(model: RobotModel) -> dict[str, Any]:
    """Return a default joint_limits.yaml for MoveIt,
    with velocities from the URDF and MoveIt's default accelerations.

    URDF has no acceleration limits. Joint limits that the model does have take precedence over the defaults.
    """
    joints = {}
    for name in model.movable_joint_names:
        limits = model.joints[name].limits
        entry = {
            "has_velocity_limits": True,
            "max_velocity": _finite(limits.velocity, VELOCITY),
            "has_acceleration_limits": True,
            "max_acceleration": _finite(limits.acceleration, ACCELERATION),
        }
        if np.isfinite(limits.jerk):
            entry |= {"has_jerk_limits": True, "max_jerk": float(limits.jerk)}
        joints[name] = entry
    return {
        "default_velocity_scaling_factor": 0.1,
        "default_acceleration_scaling_factor": 0.1,
        "joint_limits": joints,
    }


def _finite(value: float, otherwise: float) -> float:
    return float(value) if np.isfinite(value) else otherwise


def kinematics(model: RobotModel) -> dict[str, Any]:
    """Return a default kinematics.yaml for MoveIt, with KDL for every group that has a tip link."""
    solver = {
        "kinematics_solver": SOLVER,
        "kinematics_solver_search_resolution": 0.005,
        "kinematics_solver_timeout": 0.005,  # [s]
    }
    return {g.name: dict(solver) for g in model.groups.values() if g.tip_link}


def ompl_planning(model: RobotModel) -> dict[str, Any]:
    """Return a default ompl_planning.yaml for MoveIt, with all OMPL planners for every group that
    has joints.
    """
    data: dict[str, Any] = {"planner_configs": planner_configs()}
    for group in model.groups.values():
        if not group.joint_names:
            continue
        entry: dict[str, Any] = {
            "default_planner_config": config_name("RRTConnect"),
            "planner_configs": [config_name(n) for n in PLANNERS],
        }
        if len(group.joint_names) > 1:
            entry["projection_evaluator"] = f"joints({','.join(group.joint_names[:2])})"
        data[group.name] = entry | {"longest_valid_segment_fraction": 0.005}
    return data


def moveit_controllers(model: RobotModel) -> dict[str, Any]:
    """Return a default moveit_controllers.yaml for MoveIt, with one controller for each arm and each gripper.

    An arm gets a trajectory controller, a gripper with one actuated joint a gripper command. A gripper with
    several actuated joints gets a trajectory controller as well. Groups that consist of other groups get no
    controller.
    """
    hands = {e.group for e in model.end_effectors.values()}
    controllers: dict[str, Any] = {}
    for group in model.groups.values():
        if not group.joint_names or not _own(model, group):
            continue
        if group.name in hands and len(group.joint_names) == 1:
            kind, action = "GripperCommand", "gripper_cmd"
        else:
            kind, action = "FollowJointTrajectory", "follow_joint_trajectory"
        controllers[f"{group.name}_controller"] = {
            "type": kind,
            "action_ns": action,
            "default": True,
            "joints": list(group.joint_names),
        }
    return {
        "trajectory_execution": {
            "allowed_execution_duration_scaling": 1.2,
            "allowed_goal_duration_margin": 0.5,  # [s]
            "allowed_start_tolerance": 0.01,  # [rad or m]
        },
        "moveit_controller_manager": MANAGER,
        "moveit_simple_controller_manager": {"controller_names": list(controllers), **controllers},
    }


def _own(model: RobotModel, group: Group) -> bool:
    """Return whether a planning group gets its own controller in the default moveit_controllers.yaml.

    A group that contains all joints of a smaller group gets none, because the smaller group has its own.
    """
    return not any(
        g.joint_names and set(g.joint_names) < set(group.joint_names) for g in model.groups.values()
    )


def pilz_cartesian_limits() -> dict[str, Any]:
    """Return a default pilz_cartesian_limits.yaml for MoveIt, with the values of MoveIt's Setup Assistant."""
    return {
        "cartesian_limits": {
            "max_trans_vel": 1.0,  # [m/s]
            "max_trans_acc": 2.25,  # [m/s^2]
            "max_trans_dec": -5.0,  # [m/s^2]
            "max_rot_vel": 1.57,  # [rad/s]
        }
    }
