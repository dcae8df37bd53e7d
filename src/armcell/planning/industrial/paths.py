"""Ways of the tip: a straight line, or an arc of a circle; the orientation turns evenly along either."""

from __future__ import annotations

from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from armcell.core import SE3, SO3, ErrorCode, Outcome

Array = NDArray[np.float64]

COLLINEAR = 1e-5  # [m^2] cross product below which three points span no plane (MoveIt's MAX_COLINEAR_NORM)
RADIUS_DIFFERENCE = 1e-2  # [m] start and goal may be at from the centre (MoveIt's MAX_RADIUS_DIFF)


class TipPath(Protocol):
    """A pose for every s in 0..1; position and orientation both change evenly with s."""

    start: SE3
    goal: SE3

    @property
    def length(self) -> float: ...  # [m]

    @property
    def angle(self) -> float: ...  # [rad]

    def pose(self, s: float) -> SE3: ...


class Line:
    """A straight line between two poses."""

    def __init__(self, start: SE3, goal: SE3):
        self.start, self.goal = start, goal

    @cached_property
    def turn(self) -> Array:
        """The whole rotation as a vector (3,) in the start's axes [rad]."""
        return (self.start.rotation.inv() @ self.goal.rotation).log()

    @property
    def length(self) -> float:
        return float(np.linalg.norm(self.goal.translation - self.start.translation))

    @property
    def angle(self) -> float:
        return float(np.linalg.norm(self.turn))

    def position(self, s: float) -> Array:
        return (1 - s) * self.start.translation + s * self.goal.translation

    def pose(self, s: float) -> SE3:
        return SE3(self.start.rotation @ SO3.exp(s * self.turn), self.position(s))


class Arc(Line):
    """An arc of a circle.

    Args:
        axis: (3,) unit vector; the arc goes about it by `sweep` [rad], right-handed.
    """

    def __init__(self, start: SE3, goal: SE3, center: Array, axis: Array, sweep: float):
        super().__init__(start, goal)
        self.center, self.axis, self.sweep = center, axis, sweep

    @property
    def radius(self) -> float:
        return float(np.linalg.norm(self.start.translation - self.center))

    @property
    def length(self) -> float:
        return self.radius * self.sweep

    def position(self, s: float) -> Array:
        turned = SO3.exp(s * self.sweep * self.axis).matrix
        return self.center + turned @ (self.start.translation - self.center)


def arc_through(start: SE3, goal: SE3, interim: Array) -> Arc | Outcome:
    """The arc from start through a point (3,) [m] to goal."""
    a, b = interim - start.translation, goal.translation - start.translation
    normal = np.cross(a, b)
    size = float(np.linalg.norm(normal))
    if size < COLLINEAR:
        return _no_arc(
            "start, interim point and goal lie on one line (or two of them coincide)",
            "move the interim point aside, or use LIN",
        )
    # Circumscribed circle: https://en.wikipedia.org/wiki/Circumcircle#Higher_dimensions
    center = start.translation + np.cross((a @ a) * b - (b @ b) * a, normal) / (2 * size**2)
    axis = normal / size  # about it start, interim and goal come one after the other
    u, v = start.translation - center, goal.translation - center
    sweep = float(np.arctan2(axis @ np.cross(u, v), u @ v)) % (2 * np.pi)
    return Arc(start, goal, center, axis, sweep)


def arc_around(start: SE3, goal: SE3, center: Array) -> Arc | Outcome:
    """The shorter arc from start to goal around a point (3,) [m].

    A centre that is not quite as far from both is moved to where it is: the arc keeps its radius and ends
    in the goal.
    """
    u, v = start.translation - center, goal.translation - center
    near, far = float(np.linalg.norm(u)), float(np.linalg.norm(v))
    if abs(near - far) > RADIUS_DIFFERENCE:
        text = (
            f"the center is {near * 1000:.1f} mm from the start and {far * 1000:.1f} mm from the goal, "
            f"they may differ by {RADIUS_DIFFERENCE * 1000:.0f} mm"
        )
        return _no_arc(text, "give a center that is as far from both, or an interim point")
    chord = goal.translation - start.translation
    length = float(np.linalg.norm(chord))
    if length > 1e-9:
        middle = (start.translation + goal.translation) / 2
        center = center - ((center - middle) @ chord) / length**2 * chord
        u, v = start.translation - center, goal.translation - center
    normal = np.cross(u, v)
    size = float(np.linalg.norm(normal))
    if size < COLLINEAR:
        return _no_arc(
            "start, center and goal lie on one line (or two of them coincide), so there is more than one arc",
            "give an interim point instead of the center",
        )
    return Arc(start, goal, center, normal / size, float(np.arctan2(size, u @ v)))


def _no_arc(why: str, cure: str) -> Outcome:
    return Outcome(ErrorCode.INVALID_MOTION_PLAN, f"CIRC: {why} ({cure})")
