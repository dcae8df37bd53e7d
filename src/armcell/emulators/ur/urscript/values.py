"""URScript lists and poses, which are copied by assignment; arithmetic is item by item."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any


class Vec(list):
    """URScript value that is a list with item-by-item arithmetic."""

    def _by_item(self, other: Any, act: Callable[[Any, Any], Any]) -> Vec:
        if isinstance(other, list):
            if len(other) != len(self):
                raise TypeError(f"lists of {len(self)} and {len(other)} items do not fit")
            return type(self)(act(a, b) for a, b in zip(self, other))
        return type(self)(act(a, other) for a in self)

    def __add__(self, other: Any) -> Vec:  # type: ignore[override]
        return self._by_item(other, lambda a, b: a + b)

    def __radd__(self, other: Any) -> Vec:
        return self._by_item(other, lambda a, b: b + a)

    def __sub__(self, other: Any) -> Vec:
        return self._by_item(other, lambda a, b: a - b)

    def __rsub__(self, other: Any) -> Vec:
        return self._by_item(other, lambda a, b: b - a)

    def __mul__(self, other: Any) -> Vec:  # type: ignore[override]
        return self._by_item(other, lambda a, b: a * b)

    __rmul__ = __mul__  # type: ignore[assignment]

    def __truediv__(self, other: Any) -> Vec:
        return self._by_item(other, lambda a, b: a / b)

    def __neg__(self) -> Vec:
        return type(self)(-a for a in self)


class Pose(Vec):
    """URScript value for a pose p[x, y, z, rx, ry, rz],
    which consists of a position [m] and a rotation vector [rad].
    """


def copy_value(value: Any) -> Any:
    """Return the value that is stored when URScript assigns a value: lists and poses are copied."""
    if isinstance(value, Vec):
        return type(value)(copy_value(v) for v in value)
    return value


def format_value(value: Any) -> str:
    if isinstance(value, Pose):
        return "p[" + ", ".join(format_value(v) for v in value) + "]"
    if isinstance(value, list):
        return "[" + ", ".join(format_value(v) for v in value) + "]"
    return f"{value:.6g}" if isinstance(value, float) else str(value)
