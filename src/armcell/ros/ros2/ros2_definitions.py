"""Message definitions of a ROS 2 distribution, including messages derived from actions.

The bus's own definitions, which are ROS 1's, apply to user-defined types and to types that have the same
layout in ROS 2.
"""

from __future__ import annotations

from typing import Any

from rosbags.interfaces import Nodetype

from armcell.ros.definitions import Definition, rosbags_name
from armcell.ros.distros import distro_definitions
from armcell.ros.schema import Schema


def definitions(schema: Schema, distro: str) -> dict[str, Definition]:
    """Return all message definitions of a ROS 2 distribution by `pkg/Name`, including the messages of its
    actions.

    Raises:
        UnknownNameError: the distribution does not exist.
    """
    theirs = distro_definitions(distro).messages
    found = schema.definitions | {n: d for n, d in theirs.items() if n not in schema.own}
    for action in schema.actions:
        found |= _action_messages(action)
    return found


def _action_messages(action: str) -> dict[str, Definition]:
    """Return the messages that ROS 2's rosidl derives from the definition of an action.

    Source: design.ros2.org/articles/actions.html.
    """
    uuid = ("goal_id", _node("unique_identifier_msgs/UUID"))
    parts: dict[str, list[Any]] = {
        "_SendGoal_Request": [uuid, ("goal", _node(f"{action}Goal"))],
        "_SendGoal_Response": [
            ("accepted", (Nodetype.BASE, ("bool", 0))),
            ("stamp", _node("builtin_interfaces/Time")),
        ],
        "_GetResult_Request": [uuid],
        "_GetResult_Response": [
            ("status", (Nodetype.BASE, ("int8", 0))),
            ("result", _node(f"{action}Result")),
        ],
        "_FeedbackMessage": [uuid, ("feedback", _node(f"{action}Feedback"))],
    }
    return {f"{action}{part}": Definition([], fields) for part, fields in parts.items()}


def _node(name: str) -> Any:
    return (Nodetype.NAME, rosbags_name(name))
