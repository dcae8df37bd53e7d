"""Constraints with more room: by a factor, or by as much as a state needs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from armcell.core import (
    SE3,
    Box,
    Capsule,
    Cylinder,
    JointConstraint,
    OrientationConstraint,
    Plane,
    PositionConstraint,
    Shape,
    Sphere,
    VisibilityConstraint,
)
from armcell.planning.constraint_check import ConstraintError
from armcell.planning.explanation import words

One = JointConstraint | PositionConstraint | OrientationConstraint | VisibilityConstraint
SPARE = (1.05, 1e-3)  # factor and addition [rad or m] to what is just needed


def name(one: One) -> str:
    if isinstance(one, JointConstraint):
        return one.joint
    if isinstance(one, VisibilityConstraint):
        return f"the view of {one.sensor}"
    what = "the orientation" if isinstance(one, OrientationConstraint) else "the position"
    return f"{what} of {one.link or 'the tip'}"


def told(one: One) -> str:
    """Its tolerance in words."""
    if isinstance(one, OrientationConstraint):
        return ", ".join(words.angle(t) for t in one.tolerance)
    if isinstance(one, JointConstraint):
        return f"+{one.tolerance_above:.3g}, -{one.tolerance_below:.3g}"
    if isinstance(one, VisibilityConstraint):
        return words.length(one.target_radius)
    return " or ".join(_size(shape) for shape, _ in one.region)


def scaled(one: One, factor: float) -> One | None:
    """With its tolerance so many times as wide; None: a half space, which has no size, or a view."""
    if isinstance(one, VisibilityConstraint):
        return None
    if isinstance(one, OrientationConstraint):
        x, y, z = (min(t * factor, np.pi) for t in one.tolerance)
        return replace(one, tolerance=(x, y, z))
    if isinstance(one, JointConstraint):
        above, below = one.tolerance_above * factor, one.tolerance_below * factor
        return replace(one, tolerance_above=above, tolerance_below=below)
    if any(isinstance(shape, Plane) for shape, _ in one.region):
        return None
    region = tuple(_grown(shape, T, (factor - 1) * _half(shape)) for shape, T in one.region)
    return replace(one, region=region)


def loosened(one: One, error: ConstraintError) -> One:
    """The constraint with so much more room that the state of an error keeps to it, and a little.

    Args:
        one: the error's constraint, or what was made of it for another state.
    """
    if isinstance(one, VisibilityConstraint):
        return one
    need = [float(v) for v in np.abs(error.error) * SPARE[0] + SPARE[1]]
    if isinstance(one, OrientationConstraint):
        x, y, z = (
            t if over <= 0 else min(max(t, n), np.pi)
            for t, n, over in zip(one.tolerance, need, error.excess, strict=True)
        )
        return replace(one, tolerance=(x, y, z))
    if isinstance(one, JointConstraint):
        if error.error[0] > 0:
            return replace(one, tolerance_above=max(one.tolerance_above, need[0]))
        return replace(one, tolerance_below=max(one.tolerance_below, need[0]))
    return replace(one, region=tuple(_grown(shape, T, need[0]) for shape, T in one.region))


def _half(shape: Shape) -> float:
    return float(np.max(_extent(shape))) / 2


def _extent(shape: Shape) -> tuple[float, ...]:
    """Sizes [m] of a region's shape."""
    match shape:
        case Box():
            return shape.x, shape.y, shape.z
        case Sphere():
            return (2 * shape.radius,)
        case Cylinder() | Capsule():
            return 2 * shape.radius, shape.length
    return ()


def _size(shape: Shape) -> str:
    extent = _extent(shape)
    kind = type(shape).__name__.lower()
    return f"a {kind} of {' x '.join(words.length(x) for x in extent)}" if extent else f"a {kind}"


def _grown(shape: Shape, T: SE3, by: float) -> tuple[Shape, SE3]:
    """A shape whose surface is at least so much [m] farther out on every side."""
    match shape:
        case Box():
            return Box(shape.x + 2 * by, shape.y + 2 * by, shape.z + 2 * by), T
        case Sphere():
            return Sphere(shape.radius + by), T
        case Cylinder():
            return Cylinder(shape.radius + by, shape.length + 2 * by), T
        case Capsule():
            return Capsule(shape.radius + by, shape.length), T
        case Plane():  # solid below its xy plane
            return shape, T @ SE3.from_xyz(0.0, 0.0, by)
    return shape, T
