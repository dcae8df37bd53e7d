"""What MoveIt's YAML files hold for a robot that has just been set up."""

from __future__ import annotations

from typing import Any

import numpy as np

from armcell.model.robot import Group, RobotModel
from armcell.model.setup.planners import PLANNERS, config_name, planner_configs

VELOCITY, ACCELERATION = 1.0, 1.0
"""[rad/s, rad/s^2 or m] MoveIt's time parameterization takes these where no limit is given
(TimeOptimalTrajectoryGeneration: DEFAULT_VELOCITY_LIMIT, DEFAULT_ACCELERATION_LIMIT)."""

SOLVER = "kdl_kinematics_plugin/KDLKinematicsPlugin"
MANAGER = "moveit_simple_controller_manager/MoveItSimpleControllerManager"


def joint_limits(model: RobotModel) -> dict[str, Any]:
    """joint_limits.yaml: velocities as in the URDF, accelerations (it has none) as MoveIt assumes."""
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
    """kinematics.yaml: a solver for every chain."""
    solver = {
        "kinematics_solver": SOLVER,
        "kinematics_solver_search_resolution": 0.005,
        "kinematics_solver_timeout": 0.005,  # [s]
    }
    return {g.name: dict(solver) for g in model.groups.values() if g.tip_link}


def ompl_planning(model: RobotModel) -> dict[str, Any]:
    """ompl_planning.yaml: every planner for every group that has joints."""
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
    """moveit_controllers.yaml: a trajectory controller for every arm, a gripper command for every gripper.

    A gripper with several driven joints gets a trajectory controller as well; groups made of others, none.
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
    """Whether no smaller group drives some of its joints."""
    return not any(
        g.joint_names and set(g.joint_names) < set(group.joint_names) for g in model.groups.values()
    )


def pilz_cartesian_limits() -> dict[str, Any]:
    """pilz_cartesian_limits.yaml, with the figures of MoveIt's assistant."""
    return {
        "cartesian_limits": {
            "max_trans_vel": 1.0,  # [m/s]
            "max_trans_acc": 2.25,  # [m/s^2]
            "max_trans_dec": -5.0,  # [m/s^2]
            "max_rot_vel": 1.57,  # [rad/s]
        }
    }
