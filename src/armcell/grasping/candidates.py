"""Where to hold an object: grasp candidates for a parallel gripper, best first, and why others are out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armcell.core import SE3, SO3, Cylinder, Registry, Sphere
from armcell.model import Gripper
from armcell.scene import CollisionObject

Array = NDArray[np.float64]

MIN_DEPTH = 0.002  # [m] that the tcp is inside the object at least
BOTTOM_CLEARANCE = 0.006  # [m] between the finger tips and what the object stands on
OPENING_FACTOR = 1.125  # pre-opening relative to the object: 10-15 % wider
OPENING_MARGIN = 0.010  # [m] wider at least: half of it is what a finger may be off by
FORCE_SAFETY = 3.0
MIN_FORCE = 10.0  # [N] per finger
LIFT_ACCELERATION = 3.0  # [m/s^2] the held object must stand besides gravity


@dataclass(frozen=True, eq=False)
class Grasp:
    """A way to hold an object. The tcp's z axis is the approach direction, y the closing direction."""

    name: str
    T_object_tcp: SE3
    width: float  # [m] of the object between the pads
    opening: float  # [m] before the approach
    force: float  # [N] per finger
    score: float = 0.0  # higher is tried first


@dataclass(frozen=True)
class Rejection:
    """A candidate that cannot be used, and why."""

    name: str
    reason: str


Generator = Callable[[CollisionObject, Gripper], tuple[list[Grasp], list[Rejection]]]
generators: Registry[Generator] = Registry("grasp generator")


def needed_force(item: CollisionObject) -> float:
    """Force per finger [N] that just holds the object: m (g + a) / (2 mu) by Coulomb."""
    return item.mass_kg * (9.81 + LIFT_ACCELERATION) / (2 * max(item.material.friction, 0.05))


def grip_force(item: CollisionObject, gripper: Gripper) -> float:
    """Force per finger [N] to grip with: `needed_force` with a safety factor, if the gripper has it."""
    return float(np.clip(needed_force(item) * FORCE_SAFETY, MIN_FORCE, gripper.max_force))


@generators.register("bounding_box")
def bounding_box_grasps(item: CollisionObject, gripper: Gripper) -> tuple[list[Grasp], list[Rejection]]:
    """Grasps across the faces of the object's bounding box: six approach directions, two closing axes, both
    hand orientations. Round shapes are also gripped at angles in between.
    """
    low, high = item.bounds()
    centre, size = (low + high) / 2, high - low
    found, rejected = [], []
    up = item.T_world_object.rotation.matrix.T @ np.array([0.0, 0.0, 1.0])  # in the object's frame
    for axis in range(3):
        for sign in (-1.0, 1.0):
            approach = np.zeros(3)
            approach[axis] = sign
            for closing, turn in _closings(item, axis):
                width = item.extent(closing)
                label = f"{_direction(approach, axis, up)} {turn}"
                opening = min(max(width * OPENING_FACTOR, width + OPENING_MARGIN), gripper.max_width)
                if width > gripper.max_width - OPENING_MARGIN / 2:
                    reason = (
                        f"{width * 1000:.0f} mm wide, the gripper opens {gripper.max_width * 1000:.0f} mm"
                    )
                    rejected.append(Rejection(label, reason))
                    continue
                if needed_force(item) > gripper.max_force:
                    force = needed_force(item)
                    text = f"needs {force:.0f} N per finger, the gripper has {gripper.max_force:.0f} N"
                    rejected.append(Rejection(label, text))
                    continue
                position = _tcp_position(centre, size, approach, axis, up, gripper)
                if position is None:
                    rejected.append(
                        Rejection(label, f"{size[axis] * 1000:.0f} mm is too flat for the finger tips")
                    )
                    continue
                for flip in (1.0, -1.0):
                    y = flip * closing
                    R = SO3(np.column_stack([np.cross(y, approach), y, approach]))
                    down = float(-approach @ up)  # 1: from above
                    # From above first, then the narrower side, then the hand the usual way round.
                    score = down - 0.2 * width / gripper.max_width - (0.01 if flip < 0 else 0.0)
                    found.append(
                        Grasp(
                            f"{label}{'' if flip > 0 else ' flipped'}", SE3(R, position), width, opening,
                            grip_force(item, gripper), score,
                        )
                    )  # fmt: skip
    found.sort(key=lambda g: -g.score)
    return found, rejected


def _closings(item: CollisionObject, axis: int) -> list[tuple[Array, str]]:
    """Closing directions across an approach axis, in the object's frame."""
    others = [k for k in range(3) if k != axis]
    basis = [np.eye(3)[k] for k in others]
    shape, T_object_shape = item.shapes[0] if len(item.shapes) == 1 else (None, None)
    lies_along = T_object_shape is not None and abs(T_object_shape.rotation.matrix[axis, 2]) > 0.999
    if isinstance(shape, Sphere) or (isinstance(shape, Cylinder) and lies_along):
        angles = np.deg2rad([0, 30, 60, 90, 120, 150])
        return [(np.cos(a) * basis[0] + np.sin(a) * basis[1], f"at {np.rad2deg(a):.0f} deg") for a in angles]
    return [(b, f"across {'xyz'[k]}") for b, k in zip(basis, others, strict=True)]


def _direction(approach: Array, axis: int, up: Array) -> str:
    down = float(-approach @ up)
    face = f"{'-' if approach[axis] > 0 else '+'}{'xyz'[axis]}"
    if down > 0.9:
        return "top"
    if down < -0.9:
        return "from below"
    if abs(down) > 0.1:
        return f"slanting {face}"
    return f"side {'-' if approach[axis] > 0 else '+'}{'xyz'[axis]}"


def _tcp_position(
    centre: Array, size: Array, approach: Array, axis: int, up: Array, gripper: Gripper
) -> Array | None:
    """The tcp at the object's centre, or as deep as the fingers allow, and high enough above the support."""
    position = centre.copy()
    half = size[axis] / 2
    # Distance from the near face to the tcp along the approach: not deeper than the fingers are long, and
    # (from above) the tips not lower than the bottom.
    depth = min(half, gripper.finger_depth)
    if float(-approach @ up) > 0.7:
        depth = min(depth, size[axis] - gripper.pad_depth - BOTTOM_CLEARANCE)
    if depth < MIN_DEPTH:
        return None
    position += approach * (depth - half)
    return position


def grasp_candidates(
    item: CollisionObject, gripper: Gripper, generator: str = "bounding_box"
) -> tuple[list[Grasp], list[Rejection]]:
    """Candidates, best first, and the rejected ones with their reasons.

    Raises:
        UnknownNameError: no such generator.
    """
    return generators[generator](item, gripper)
