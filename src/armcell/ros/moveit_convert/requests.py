"""Planning requests: moveit_msgs/MotionPlanRequest and GetCartesianPath."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from armcell.core import ADAPTERS, CartesianRequest, ErrorCode, InputError, PlanRequest
from armcell.core.requests import Corner
from armcell.ros.convert import pose_from_message
from armcell.ros.moveit_convert.constraints import constraints_from_message, goal_from_message
from armcell.ros.moveit_convert.objects import frame_of
from armcell.ros.moveit_convert.states import robot_state_from_message
from armcell.ros.schema import Schema
from armcell.scene import PlanningScene

DEFAULT_TIME = 5.0  # [s] where a request gives none
MOVE_GROUP_ADAPTERS = (ADAPTERS[0], "fix_start_state_collision", *ADAPTERS[1:])
"""MoveIt's default chain has FixStartStateCollision as well: a held object stands on something at first."""


def error_code_message(schema: Schema, code: ErrorCode | int) -> Any:
    """A moveit_msgs/MoveItErrorCodes."""
    return schema.new("moveit_msgs/MoveItErrorCodes", int(code))


def plan_request_from_message(
    message: Any, scene: PlanningScene, parameters: Mapping[str, Any] | None = None
) -> PlanRequest:
    """The request of a moveit_msgs/MotionPlanRequest.

    As move_group reads it: an empty pipeline or planner is the default one, a scaling outside (0, 1] is 1, no
    time is 5 s, fewer than one attempt is one. A workspace counts where its frame is empty, as our scripts'
    `set_workspace` leaves it: RViz and MoveIt's own clients name a frame, and mean mobile bases.

    Args:
        scene: in which frames are looked up.
        parameters: of the planner, as set by set_planner_params.
    Raises:
        InputError: unknown joint or frame, constraints that cannot be meant.
    """
    if message.trajectory_constraints.constraints:
        raise InputError("trajectory constraints are not planned for", cure="use path constraints")
    goals = tuple(goal_from_message(c, scene) for c in message.goal_constraints)
    if not goals:
        raise InputError("the request has no goal", cure="set a target first")
    return PlanRequest(
        message.group_name,
        goals,
        start=robot_state_from_message(message.start_state, scene),
        planner_id=message.planner_id,
        pipeline_id=message.pipeline_id,
        planning_time=float(message.allowed_planning_time)
        if message.allowed_planning_time > 0
        else DEFAULT_TIME,
        attempts=max(int(message.num_planning_attempts), 1),
        velocity_scaling=_scaling(message.max_velocity_scaling_factor),
        acceleration_scaling=_scaling(message.max_acceleration_scaling_factor),
        path_constraints=constraints_from_message(message.path_constraints),
        parameters=parameters or {},
        workspace=_workspace(message.workspace_parameters),
        max_cartesian_speed=float(message.max_cartesian_speed) or None,
        speed_link=message.cartesian_speed_limited_link or None,
        adapters=MOVE_GROUP_ADAPTERS,
    )


def _scaling(value: float) -> float:
    return float(value) if 0 < value <= 1 else 1.0


def _workspace(message: Any) -> tuple[Corner, Corner] | None:
    low = (message.min_corner.x, message.min_corner.y, message.min_corner.z)
    high = (message.max_corner.x, message.max_corner.y, message.max_corner.z)
    if message.header.frame_id or not (any(low) or any(high)):
        return None
    if low[2] == high[2] == 0.0:  # set_workspace with four values: any height
        low, high = (low[0], low[1], -np.inf), (high[0], high[1], np.inf)
    return low, high


def cartesian_request_from_message(message: Any, scene: PlanningScene) -> CartesianRequest:
    """The request of a GetCartesianPath. Waypoints are in the header's frame.

    Jump thresholds of 0 allow any jump, as there. Where none is given at all, ours hold: 0.2 rad and 0.05 m,
    for a line that jumps is none.

    Raises:
        InputError: no waypoints, a step that is not positive, unknown joint or frame.
    """
    if not len(message.waypoints):
        raise InputError("no waypoints")
    if not message.max_step > 0:
        raise InputError(f"the step is {message.max_step:g} m", cure="give one above 0, such as 0.01")
    start = robot_state_from_message(message.start_state, scene)
    placed = scene if start is None else scene.with_state(start)
    T = placed.frame_pose(frame_of(message.header))
    values: dict[str, float] = {}
    given = (message.jump_threshold, message.revolute_jump_threshold, message.prismatic_jump_threshold)
    if any(v > 0 for v in given):
        values = {
            "relative_jump_threshold": max(float(given[0]), 0.0),
            "jump_threshold": max(float(given[1]), 0.0),
            "prismatic_jump_threshold": max(float(given[2]), 0.0),
        }
    return CartesianRequest(
        message.group_name,
        tuple(T @ pose_from_message(p) for p in message.waypoints),
        message.link_name or None,
        start,
        max_step=float(message.max_step),
        avoid_collisions=bool(message.avoid_collisions),
        path_constraints=constraints_from_message(message.path_constraints),
        max_cartesian_speed=float(message.max_cartesian_speed) or None,
        **values,
    )
