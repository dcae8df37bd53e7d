"""Methods that moveit_commander adds to moveit_msgs/AllowedCollisionMatrix."""

from __future__ import annotations

from typing import Any

MATRIX = "moveit_msgs/AllowedCollisionMatrix"


def set_default(self: Any, obj: str, allow: bool) -> None:
    """Set in MoveIt's allowed collision matrix whether a body may touch other bodies by default."""
    if obj in self.default_entry_names:
        self.default_entry_values[self.default_entry_names.index(obj)] = allow
    else:
        self.default_entry_names.append(obj)
        self.default_entry_values.append(allow)


def set_allowed(self: Any, obj: str, other: str | None = None, allow: bool = True) -> None:
    """Set in MoveIt's allowed collision matrix whether two bodies may touch each other.

    Without `other`, the setting becomes the default for pairs without an entry. A body that is not in the
    matrix gets a new row, in which all other contacts are forbidden.

    Raises:
        ValueError: the other body is not in the matrix.
    """
    if other is None:
        self.set_default(obj, allow)
        return
    if other not in self.entry_names:
        raise ValueError(f"{other!r} is not in the matrix; it has {', '.join(self.entry_names)}")
    if obj not in self.entry_names:
        self.entry_names.append(obj)
        for row in self.entry_values:
            row.enabled.append(False)
        self.entry_values.append(type(self.entry_values[0])(enabled=[False] * len(self.entry_names)))
    i, j = self.entry_names.index(obj), self.entry_names.index(other)
    self.entry_values[i].enabled[j] = self.entry_values[j].enabled[i] = allow


METHODS = {"set_allowed": set_allowed, "set_default": set_default}
