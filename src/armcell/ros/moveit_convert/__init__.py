"""Conversions between armcell's types and moveit_msgs, with one module per kind of message."""

from armcell.ros.moveit_convert.objects import object_from_message, object_message
from armcell.ros.moveit_convert.requests import (
    cartesian_request_from_message,
    constraints_from_message,
    constraints_message,
    error_code_message,
    goal_from_message,
    plan_request_from_message,
)
from armcell.ros.moveit_convert.scenes import (
    Components,
    attached_changes,
    diff_from_message,
    object_changes,
    scene_message,
    world_from_message,
)
from armcell.ros.moveit_convert.states import (
    robot_state_from_message,
    robot_state_message,
    robot_trajectory_message,
)

__all__ = [
    "Components",
    "attached_changes",
    "cartesian_request_from_message",
    "constraints_from_message",
    "constraints_message",
    "diff_from_message",
    "error_code_message",
    "goal_from_message",
    "object_changes",
    "object_from_message",
    "object_message",
    "plan_request_from_message",
    "robot_state_from_message",
    "robot_state_message",
    "robot_trajectory_message",
    "scene_message",
    "world_from_message",
]
