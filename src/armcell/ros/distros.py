"""Message layouts of the ROS 2 distributions.

Sources: the distribution's message set in rosbags for the common packages, and armcell's texts in
`ros2/definitions` for the others. Types with the same layout in ROS 1 and ROS 2 appear in neither source if
armcell's ROS 1 definitions contain them.
"""

from __future__ import annotations

import os
from functools import cache
from pathlib import Path
from typing import NamedTuple

from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore

from armcell.core import UnknownNameError
from armcell.ros.definitions import PLACEHOLDER, Definition, Interfaces, plain_name, read_folder

FOLDER = Path(__file__).parent / "ros2" / "definitions"
PLUMBING = ("rmw_dds_common",)
"""Packages whose types only the middleware uses; their layouts differ between distributions."""


class Distro(NamedTuple):
    """ROS 2 distribution: the rosbags type store that contains its message definitions, and the armcell
    folders with further definitions.

    If two folders define the same type, the later folder wins.
    """

    store: Stores
    folders: tuple[str, ...]
    has_hashes: bool  # since Iron, a hash identifies the version of a type (REP 2016)


DISTROS = {
    "humble": Distro(Stores.ROS2_HUMBLE, ("all", "humble"), False),
    "jazzy": Distro(Stores.ROS2_JAZZY, ("all", "jazzy"), True),
    "kilted": Distro(Stores.ROS2_KILTED, ("all", "jazzy", "kilted"), True),
    "lyrical": Distro(Stores.ROS2_LYRICAL, ("all", "jazzy", "kilted"), True),
}
DEFAULT_DISTRO = "jazzy"


def distro_from_environment() -> str:
    """Return the ROS 2 distribution that `ROS_DISTRO` names if armcell supports it, else "jazzy"."""
    name = os.environ.get("ROS_DISTRO", "")
    return name if name in DISTROS else DEFAULT_DISTRO


@cache
def distro_definitions(distro: str) -> Interfaces:
    """Return all message definitions of a ROS 2 distribution by `pkg/Name`, with the field layouts of ROS 2.

    Raises:
        UnknownNameError: armcell does not support the distribution.
    """
    if distro not in DISTROS:
        raise UnknownNameError("ROS 2 distribution", distro, DISTROS)
    known = DISTROS[distro]
    messages: dict[str, Definition] = {}
    services: set[str] = set()
    actions: set[str] = set()
    for name, (constants, fields) in get_typestore(known.store).fielddefs.items():
        empty = [(PLACEHOLDER, (Nodetype.BASE, ("uint8", 0)))]
        messages[plain_name(name)] = Definition(list(constants), list(fields) or list(empty))
    for folder in known.folders:
        found = read_folder(FOLDER / folder)
        messages |= found.messages
        services |= set(found.services)
        actions |= set(found.actions)
    return Interfaces(messages, sorted(services), sorted(actions))
