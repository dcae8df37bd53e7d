"""What moveit_commander adds to moveit_msgs/AllowedCollisionMatrix."""

from __future__ import annotations

from typing import Any

MATRIX = "moveit_msgs/AllowedCollisionMatrix"


def set_default(self: Any, obj: str, allow: bool) -> None:
    """What holds for a body's contacts that no pair speaks of."""
    if obj in self.default_entry_names:
        self.default_entry_values[self.default_entry_names.index(obj)] = allow
    else:
        self.default_entry_names.append(obj)
        self.default_entry_values.append(allow)


def set_allowed(self: Any, obj: str, other: str | None = None, allow: bool = True) -> None:
    """Allow (or forbid) contact of a body with another; with every one that no pair speaks of by default.

    A body that is new in the matrix gets a row of its own, which allows nothing else.

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
