"""Default contents of MoveIt's YAML files for a robot, with OMPL's planners and their parameters.

`armcell setup` writes these contents. The planners are those that MoveIt's Setup Assistant writes to
ompl_planning.yaml.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from armcell.model.robot import Group, RobotModel

_RANGE = {"range": 0.0}  # [rad] longest motion that the planner adds to its tree; 0: OMPL chooses
_BIAS = {"range": 0.0, "goal_bias": 0.05}
_PIECES = {"border_fraction": 0.9, "failed_expansion_score_factor": 0.5, "min_valid_path_fraction": 0.5}
_SPARSE = {"stretch_factor": 3.0, "sparse_delta_fraction": 0.25, "dense_delta_fraction": 0.001}

PLANNERS: dict[str, dict[str, Any]] = {
    "AnytimePathShortening": {"shortcut": True, "hybridize": True, "max_hybrid_paths": 24, "num_planners": 4},
    "SBL": _RANGE,
    "EST": _BIAS,
    "LBKPIECE": {"range": 0.0, "border_fraction": 0.9, "min_valid_path_fraction": 0.5},
    "BKPIECE": _RANGE | _PIECES,
    "KPIECE": _BIAS | _PIECES,
    "RRT": _BIAS,
    "RRTConnect": _RANGE,
    "RRTstar": _BIAS | {"delay_collision_checking": 1},
    "TRRT": _BIAS
    | {
        "max_states_failed": 10,
        "temp_change_factor": 2.0,
        "min_temperature": 1e-9,
        "init_temperature": 1e-5,
        "frountier_threshold": 0.0,
        "frountierNodeRatio": 0.1,
        "k_constant": 0.0,
    },
    "PRM": {"max_nearest_neighbors": 10},
    "PRMstar": {},
    "FMT": {
        "num_samples": 1000,
        "radius_multiplier": 1.1,
        "nearest_k": 1,
        "cache_cc": 1,
        "heuristics": 0,
        "extended_fmt": 1,
    },
    "BFMT": {
        "num_samples": 1000,
        "radius_multiplier": 1.0,
        "nearest_k": 1,
        "balanced": 0,
        "optimality": 1,
        "heuristics": 1,
        "cache_cc": 1,
        "extended_fmt": 1,
    },
    "PDST": {},
    "STRIDE": _BIAS
    | {
        "use_projected_distance": 0,
        "degree": 16,
        "max_degree": 18,
        "min_degree": 12,
        "max_pts_per_leaf": 6,
        "estimated_dimension": 0.0,
        "min_valid_path_fraction": 0.2,
    },
    "BiTRRT": _RANGE
    | {
        "temp_change_factor": 0.1,
        "init_temperature": 100,
        "frountier_threshold": 0.0,
        "frountier_node_ratio": 0.1,
        "cost_threshold": 1e300,
    },
    "LBTRRT": _BIAS | {"epsilon": 0.4},
    "BiEST": _RANGE,
    "ProjEST": _BIAS,
    "LazyPRM": _RANGE,
    "LazyPRMstar": {},
    "SPARS": _SPARSE | {"max_failures": 1000},
    "SPARStwo": _SPARSE | {"max_failures": 5000},
}
SOLVER = "kdl_kinematics_plugin/KDLKinematicsPlugin"
MANAGER = "moveit_simple_controller_manager/MoveItSimpleControllerManager"


def config_name(planner: str) -> str:
    """Return the name of an OMPL planner in MoveIt's default ompl_planning.yaml, such as
    `RRTConnectkConfigDefault`.
    """
    return f"{planner}kConfigDefault"


def planner_configs() -> dict[str, dict[str, Any]]:
    """Return the block `planner_configs` of the default ompl_planning.yaml, with all known OMPL planners."""
    return {config_name(n): {"type": f"geometric::{n}", **values} for n, values in PLANNERS.items()}


VELOCITY, ACCELERATION = 1.0, 1.0
"""Default velocity and acceleration [rad/s, rad/s^2; m/s, m/s^2] of a joint without limits.

MoveIt's time parameterization uses the same values (TimeOptimalTrajectoryGeneration: DEFAULT_VELOCITY_LIMIT,
DEFAULT_ACCELERATION_LIMIT).
"""


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
