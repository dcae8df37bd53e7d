"""ROS 2's message definitions, where they differ from those of the bus, which are ROS 1's.

Sources: rosbags' set of the distribution for the common packages; our texts in `definitions`; the bus's own
definitions for everything else (the user's types too). Actions get the messages that rosidl makes of them.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, NamedTuple

from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore

from armcell.core import UnknownNameError
from armcell.ros.definitions import PLACEHOLDER, Definition, plain_name, read_folder, rosbags_name
from armcell.ros.schema import Schema

FOLDER = Path(__file__).parent / "definitions"


class Distro(NamedTuple):
    """A ROS 2 distribution: rosbags' set and our folders of texts."""

    store: Stores
    folders: tuple[str, ...]
    has_hashes: bool  # types are told apart by a hash since Iron (REP 2016)


DISTROS = {
    "humble": Distro(Stores.ROS2_HUMBLE, ("all",), False),
    "jazzy": Distro(Stores.ROS2_JAZZY, ("all", "jazzy"), True),
    "kilted": Distro(Stores.ROS2_KILTED, ("all", "jazzy"), True),
    "lyrical": Distro(Stores.ROS2_LYRICAL, ("all", "jazzy"), True),
}
DEFAULT_DISTRO = "jazzy"


def distro_from_environment() -> str:
    """ROS_DISTRO where it is one we know, else Jazzy."""
    name = os.environ.get("ROS_DISTRO", "")
    return name if name in DISTROS else DEFAULT_DISTRO


def definitions(schema: Schema, distro: str) -> dict[str, Definition]:
    """Every type as this distribution has it, by `pkg/Name`.

    Raises:
        UnknownNameError: no such distribution.
    """
    if distro not in DISTROS:
        raise UnknownNameError("ROS 2 distribution", distro, DISTROS)
    known = DISTROS[distro]
    found = dict(schema.definitions)
    for name, (constants, fields) in get_typestore(known.store).fielddefs.items():
        found[plain_name(name)] = Definition(list(constants), list(fields) or _EMPTY)
    for folder in known.folders:
        found |= read_folder(FOLDER / folder).messages
    for action in schema.actions:
        found |= _action_messages(action)
    return found


_EMPTY: list[Any] = [(PLACEHOLDER, (Nodetype.BASE, ("uint8", 0)))]


def _action_messages(action: str) -> dict[str, Definition]:
    """What rosidl makes of an action. Source: design.ros2.org/articles/actions.html."""
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
