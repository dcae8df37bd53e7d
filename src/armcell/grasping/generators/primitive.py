"""Grasps of boxes, cylinders, capsules and spheres, using their symmetry.

Box: across each axis, from the four faces and four edges around it, also off-center on long sides. Cylinder:
across its axis from all directions, along its length, and at its ends. Sphere: from all directions.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from armcell.core import Capsule, Cylinder, Sphere
from armcell.grasping.candidates import Proposals, generators
from armcell.grasping.grasp import directions_around, tcp_pose
from armcell.grasping.hand import Hand
from armcell.grasping.surface import Surface
from armcell.scene import CollisionObject

Array = NDArray[np.float64]

LONG = 0.06  # [m] longer sides are also held off-center
STEP = 0.03  # [m] spacing of the off-center grasps
SIDES = 12  # approach directions around a cylinder
TIP_INSIDE = 0.002  # [m] minimum depth of the TCP inside the object


@generators.register("primitive")
def primitive_grasps(item: CollisionObject, surface: Surface, hand: Hand, up: Array) -> Proposals:
    """Propose grasps for an object that is a single primitive shape.
    For other objects, use the bounding box.
    """
    shape, T = item.shapes[0]
    R, found = T.rotation.matrix, Proposals()
    up_shape = R.T @ up
    if len(item.shapes) == 1 and isinstance(shape, Sphere):
        _sphere(found, shape.radius, hand, up_shape)
    elif len(item.shapes) == 1 and isinstance(shape, Cylinder | Capsule):
        _round(found, shape.half_extents, hand, up_shape)
    else:
        low, high = item.bounds()
        T_box = np.eye(4)
        T_box[:3, 3] = (low + high) / 2
        _box(found, (high - low) / 2, hand, up)
        found.poses = [T_box @ pose for pose in found.poses]
        return found
    found.poses = [T.matrix @ pose for pose in found.poses]
    return found


def _depth(half: float, hand: Hand) -> float:
    """Return how deep [m] the TCP of a grasp is below the surface of a primitive, measured along the approach
    direction. The finger length limits this depth.

    Without the limit, the tcp is at the object's center.
    """
    return max(min(half, hand.gripper.finger_depth), TIP_INSIDE)


def _along(half: float) -> list[tuple[float, str]]:
    """Return offsets [m] from the center of a primitive at which to grasp it along its side, each with a
    suffix for the grasp's name.

    A long side has several offsets.
    """
    if 2 * half <= LONG:
        return [(0.0, "")]
    reach = half - STEP / 2
    steps = np.arange(STEP, reach + 1e-9, STEP)[:4]
    return [(0.0, ""), *((sign * s, f" {sign * s * 1000:+.0f} mm") for s in steps for sign in (1.0, -1.0))]


def _box(found: Proposals, half: Array, hand: Hand, up: Array) -> None:
    for c in range(3):
        closing = np.eye(3)[c]
        a, b = (k for k in range(3) if k != c)
        for turn in range(8):  # four faces and, between them, four edges
            approach = np.cos(turn * np.pi / 4) * np.eye(3)[a] + np.sin(turn * np.pi / 4) * np.eye(3)[b]
            approach[np.abs(approach) < 1e-12] = 0.0
            side = np.cross(closing, approach)
            reach = float(np.abs(approach) @ half)
            label = f"{_where(approach, up)} across {'xyz'[c]}"
            straight = turn % 2 == 0
            if not straight and reach > hand.gripper.finger_depth + TIP_INSIDE:
                continue  # from an edge, the fingers do not reach the center
            for offset, at in _along(float(np.abs(side) @ half)) if straight else [(0.0, "")]:
                point = approach * (_depth(reach, hand) - reach) + side * offset
                for flip, mark in ((1.0, ""), (-1.0, " flipped")):
                    found.add(f"{label}{at}{mark}", tcp_pose(flip * closing, approach, point))


def _round(found: Proposals, half: Array, hand: Hand, up: Array) -> None:
    """Propose grasps for a primitive that is a body of revolution about z, such as a cylinder.

    Args:
        half: half extents (radius, radius, half length) [m].
    """
    z = np.array([0.0, 0.0, 1.0])
    radius, length = float(half[0]), float(half[2])
    for approach in directions_around(z, SIDES, -up):  # across the axis, from all directions
        closing = np.cross(z, approach)
        for offset, at in _along(length):
            point = approach * (_depth(radius, hand) - radius) + z * offset
            for flip, mark in ((1.0, ""), (-1.0, " flipped")):
                name = f"{_where(approach, up)} {_compass(approach)}{at}{mark}"
                found.add(name, tcp_pose(flip * closing, approach, point))
        if 2 * length <= hand.gripper.max_width:  # short cylinders also across their ends
            point = approach * (_depth(radius, hand) - radius)
            found.add(
                f"{_where(approach, up)} {_compass(approach)} over the ends", tcp_pose(z, approach, point)
            )
    for approach in (z, -z):  # at an end; the rotation matters only for the arm
        point = approach * (_depth(length, hand) - length)
        for k, closing in enumerate(directions_around(z, SIDES, np.eye(3)[0])):
            found.add(f"{_where(approach, up)} at {360 // SIDES * k} deg", tcp_pose(closing, approach, point))


def _sphere(found: Proposals, radius: float, hand: Hand, up: Array) -> None:
    above = -up / np.linalg.norm(up)
    level = directions_around(above, 8, np.eye(3)[0])
    for tilt, sides in ((0.0, 1), (30.0, 8), (60.0, 8), (90.0, 8)):
        for n in range(sides):
            approach = np.cos(np.radians(tilt)) * above + np.sin(np.radians(tilt)) * level[n]
            point = approach * (_depth(radius, hand) - radius)
            for k, closing in enumerate(
                directions_around(
                    approach, 6 if tilt == 0 else 2, np.asarray(np.cross(above, level[n]), dtype=np.float64)
                )
            ):
                name = f"{_where(approach, up)} {tilt:.0f}/{45 * n} deg at {k}"
                found.add(name, tcp_pose(closing, approach, point))


def _where(approach: Array, up: Array) -> str:
    """Describe the approach direction of a grasp on a primitive in words, such as "top" or "from below"."""
    down = float(-approach @ up)
    if down > 0.95:
        return "top"
    if down < -0.95:
        return "from below"
    axis = int(np.argmax(np.abs(approach)))
    others = [k for k in range(3) if k != axis and abs(approach[k]) > 0.3]
    face = "".join(f"{'-' if approach[k] > 0 else '+'}{'xyz'[k]}" for k in sorted([axis, *others]))
    return f"side {face}" if abs(down) < 0.1 else f"slanting {face}"


def _compass(approach: Array) -> str:
    return f"{np.degrees(np.arctan2(-approach[1], -approach[0])) % 360:.0f} deg"
