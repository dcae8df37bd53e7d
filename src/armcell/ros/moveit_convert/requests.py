"""Conversion of planning requests: moveit_msgs/MotionPlanRequest and GetCartesianPath."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from armcell.core import ADAPTERS, CartesianRequest, ErrorCode, InputError, PlanRequest
from armcell.core.requests import Corner
from armcell.ros.convert import pose_from_message
from armcell.ros.failure_responses import ERROR_CODES, SOURCE
from armcell.ros.moveit_convert.constraints import constraints_from_message, goal_from_message
from armcell.ros.moveit_convert.objects import frame_of
from armcell.ros.moveit_convert.states import robot_state_from_message
from armcell.ros.schema import Schema
from armcell.scene import PlanningScene

DEFAULT_TIME = 5.0  # [s] if a request gives no planning time
MOVE_GROUP_ADAPTERS = (ADAPTERS[0], "fix_start_state_collision", *ADAPTERS[1:])
"""Request adapters of MoveIt's default chain.

It includes FixStartStateCollision, because a grasped object still touches its support at the start.
"""


def error_code_message(schema: Schema, code: ErrorCode | int, message: str = "") -> Any:
    """Create a moveit_msgs/MoveItErrorCodes message from an error code and a text.

    Only MoveIt 2 clients receive the text and its source.
    """
    return schema.new(ERROR_CODES, int(code), message, SOURCE if message else "")


def plan_request_from_message(
    message: Any, scene: PlanningScene, parameters: Mapping[str, Any] | None = None
) -> PlanRequest:
    """Convert a moveit_msgs/MotionPlanRequest message to a `PlanRequest`.
    Empty fields get the defaults of MoveIt's move_group node.

    An empty pipeline or planner selects the default, a scaling factor outside (0, 1] becomes 1, a missing
    planning time becomes 5 s, and less than one attempt becomes one. The workspace applies only if its frame
    is empty, as `set_workspace` in armcell's scripts sends it: RViz and MoveIt's clients set a frame, and
    their workspace is meant for mobile bases.

    Args:
        message: the MotionPlanRequest message.
        scene: planning scene for looking up frames.
        parameters: planner parameters that a client set with set_planner_params.
    Raises:
        InputError: a joint or frame is unknown, or a constraint is invalid.
    """
    if message.trajectory_constraints.constraints:
        raise InputError("trajectory constraints are not planned for", hint="use path constraints")
    goals = tuple(goal_from_message(c, scene) for c in message.goal_constraints)
    if not goals:
        raise InputError("the request has no goal", hint="set a target first")
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
        speed_link=message.cartesian_speed_limited_link
        or message.cartesian_speed_end_effector_link  # Humble's name
        or None,
        adapters=MOVE_GROUP_ADAPTERS,
    )


def _scaling(value: float) -> float:
    return float(value) if 0 < value <= 1 else 1.0


def _workspace(message: Any) -> tuple[Corner, Corner] | None:
    low = (message.min_corner.x, message.min_corner.y, message.min_corner.z)
    high = (message.max_corner.x, message.max_corner.y, message.max_corner.z)
    if message.header.frame_id or not (any(low) or any(high)):
        return None
    if low[2] == high[2] == 0.0:  # set_workspace with four values does not limit the height
        low, high = (low[0], low[1], -np.inf), (high[0], high[1], np.inf)
    return low, high


def cartesian_request_from_message(message: Any, scene: PlanningScene) -> CartesianRequest:
    """Convert the request of a moveit_msgs/GetCartesianPath service to a `CartesianRequest`.

    Waypoints are in the header's frame. A jump threshold of 0 allows any jump, as in MoveIt. If a request
    sets no threshold at all, armcell's defaults apply (0.2 rad and 0.05 m), because a path with jumps is not
    a straight line.

    Args:
        message: the GetCartesianPath request.
        scene: planning scene for looking up frames.
    Raises:
        InputError: the request has no waypoints, a step that is not positive, or an unknown joint or frame.
    """
    if not len(message.waypoints):
        raise InputError("no waypoints")
    if not message.max_step > 0:
        raise InputError(f"the step is {message.max_step:g} m", hint="give one above 0, such as 0.01")
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
        velocity_scaling=_scaling(message.max_velocity_scaling_factor),  # field exists only in ROS 2
        acceleration_scaling=_scaling(message.max_acceleration_scaling_factor),
        max_cartesian_speed=float(message.max_cartesian_speed) or None,
        **values,
    )
