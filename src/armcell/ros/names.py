"""ROS graph names: `joint_states` and `/joint_states` are one topic."""

from __future__ import annotations

import re

from armcell.core import InputError

MAX_LENGTH = 256
_PART = re.compile(r"^[A-Za-z_][A-Za-z0-9_]*$")


def resolve(name: str, namespace: str = "/") -> str:
    """The full name, with its leading slash.

    Raises:
        InputError: not a name ROS accepts (letters, digits and _ between slashes, no digit first).
    """
    full = name if name.startswith("/") else f"{namespace.rstrip('/')}/{name}"
    parts = [part for part in full.split("/") if part]
    if not parts or len(full) > MAX_LENGTH or not all(_PART.match(part) for part in parts):
        raise InputError(
            f"{name[:80]!r} is no topic or service name", cure="letters, digits and _ between slashes"
        )
    return "/" + "/".join(parts)
