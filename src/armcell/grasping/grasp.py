"""`Grasp` with its pad contacts, grip force and tcp pose, and `Rejection`: the results of grasp planning.

The grip force follows from mass, friction, softness and the position of the weight. A tcp pose follows
from the approach and closing directions.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from armcell.core import SE3
from armcell.core.checks import checked, float_array
from armcell.grasping import hand_fit_kernel
from armcell.model import Gripper, SuctionGripper
from armcell.scene import CollisionObject

F64 = NDArray[np.float64]
FAILED = (  # by the number of checks that a rejected candidate passed
    "have nothing between the pads",
    "are too wide",
    "let the hand touch the object or its support",
    "slip off",
    "need more force",
)
SAFETY = 3.0
MIN_FORCE = 5.0  # [N] per finger
LIFT_ACCELERATION = 3.0  # [m/s^2] assumed acceleration of the held object, in addition to gravity


@dataclass(frozen=True, eq=False)
class PadContact:
    """Contact of a grasp: the patch between an object and a soft finger pad, with surface friction and
    torsional friction.
    """

    point: F64  # (3,) [m] center of the patch
    normal: F64  # (3,) unit vector, points out of the object
    radius: float  # [m] radius of gyration of the patch; 0 for a point contact

    @staticmethod
    def of(row: F64) -> PadContact:
        """Create a pad contact of a grasp from one row (9,) of the array of contacts that
        `hand_fit_kernel.fit_hand` returns.
        """
        row = float_array(row, (9,), "a row", finite=False)
        return PadContact(row[:3].copy(), row[3:6].copy(), float(row[7]))


APPROACH, SHORTEST_APPROACH = 0.10, 0.03  # [m] desired and minimum


@dataclass(frozen=True, eq=False)
@checked()
class Grasp:
    """Grasp candidate: a pose of the tcp, which approaches along its z axis while the gripper closes along
    its y axis.

    The hand approaches along +z of the TCP and retreats along -z. The approach is `approach` [m] long if
    there is enough free space, and at least `shortest_approach` [m]. With a suction gripper the width is 0,
    and there is a contact for each cup that seals.
    """

    name: str
    T_object_tcp: SE3
    width: float  # [m] width of the object between the pads
    opening: float  # [m] finger opening before the approach
    force: float  # [N] per finger or cup
    score: float = 0.0  # higher scores are tried first
    approach: float = APPROACH
    shortest_approach: float = SHORTEST_APPROACH
    contacts: tuple[PadContact, ...] = ()  # of the pads at +y and -y, or of the cups; TCP frame


def openings(grasp: Grasp, gripper: Gripper) -> Iterator[Grasp]:
    """Yield a grasp, and then the same grasp with a smaller opening of the fingers, which leaves no margin
    for errors in the object's pose.

    The smaller opening is for fingers beside an obstacle.
    """
    yield grasp
    least = hand_fit_kernel.pre_opening(grasp.width, gripper.max_width, 0.0)
    if grasp.contacts and least < grasp.opening - 1e-6 and not isinstance(gripper, SuctionGripper):
        center = gripper.grip_center(grasp.width, grasp.opening)
        T = grasp.T_object_tcp @ center @ gripper.grip_center(grasp.width, least).inverse()
        yield replace(grasp, T_object_tcp=T, opening=least)


@dataclass(frozen=True)
class Rejection:
    """Rejected grasp: the candidate's name and the reason."""

    name: str
    reason: str
    passed: int = 0  # number of passed checks
    excess: float = np.inf  # excess over the limit of the failed check


def nearest_miss(rejected: list[Rejection]) -> Rejection | None:
    """Return the rejected grasp that passed the most checks, as a `Rejection`, or None.

    Among equals, the candidate with the smallest excess wins.
    """
    return min(rejected, key=rejection_sort_key, default=None)


def why_none(rejected: list[Rejection], covered: float) -> str:
    """Explain in one line, from the list of rejected grasps, why no grasp of an object is possible.

    Args:
        covered: share of the surface that was tried, from 0 to 1.
    """
    counts = Counter(min(r.passed, len(FAILED) - 1) for r in rejected)
    kinds = ", ".join(f"{counts[k]} {FAILED[k]}" for k in sorted(counts, reverse=True))
    tried = f"{100 * covered:.0f} % of the surface was tried"
    if not rejected:
        return f"no grasp: {tried}, no two sides oppose each other within the opening"
    return f"no grasp: {tried}; of {len(rejected)} candidates {kinds}"


def rejection_sort_key(rejection: Rejection) -> tuple[int, float]:
    """Return the sort key of a rejected grasp. Grasps that passed more checks come first. Among equals, the
    grasp that missed the limit of the failed check by less comes first.
    """
    return -rejection.passed, rejection.excess


def holding_factor(friction: float, torsional_friction: float, lever: F64, patch: F64) -> F64:
    """Return the factor by which the grip force of a grasp must grow because the object's weight acts beside
    the line through the contacts.

    A soft finger pressed with F holds a force f along the surface and a torque t about its normal while
    (f / (mu F))^2 + (t / (g F))^2 <= 1 (Howe and Cutkosky 1996), with g = mu r + the torsional coefficient
    [m] for a patch of radius r.

    Args:
        lever: [m] lever arm of the weight about the line through the contacts.
        patch: [m] radius of the smaller patch.
    """
    g = friction * patch + max(torsional_friction, 1e-4)
    return np.sqrt(1 + (friction * lever / g) ** 2)


def pair_friction(item: CollisionObject, support: CollisionObject) -> float:
    """Return the friction coefficient between an object and its support as MuJoCo combines it, to compute the
    grip force of a grasp.

    MuJoCo takes the material of the geom with the higher priority, and the larger coefficient if priorities
    are equal ("Contact parameters" in its XML reference). Movable objects have the higher priority.
    """
    mu = item.material.friction
    return max(mu, support.material.friction) if support.movable else mu


def needed_force(item: CollisionObject) -> float:
    """Return the minimum grip force per finger [N] with which a grasp at the center of mass holds the object.

    Coulomb friction: m (g + a) / (2 mu).
    """
    return item.mass_kg * (9.81 + LIFT_ACCELERATION) / (2 * max(item.material.friction, 0.05))


def firm_force(needed: float, gripper: Gripper) -> float:
    """Return the grip force per finger [N] of a firm grasp, which includes a safety factor and does not
    exceed the gripper's maximum.
    """
    return float(np.clip(needed * SAFETY, MIN_FORCE, gripper.max_force))


def grip_force(item: CollisionObject, gripper: Gripper) -> float:
    """Return the grip force per finger [N] of a firm grasp at an object's center."""
    return firm_force(needed_force(item), gripper)


def tcp_pose(closing: F64, approach: F64, at: F64) -> F64:
    """Return the frame of a grasp, T_object_tcp (4, 4), from its closing direction and its approach
    direction.

    Both are orthogonal unit vectors (3,); the tcp is at a point (3,) [m].
    """
    T = np.eye(4)
    T[:3, 0] = np.cross(closing, approach)
    T[:3, 1], T[:3, 2], T[:3, 3] = closing, approach, at
    return T


def directions_around(axis: F64, count: int, first: F64) -> F64:
    """Return unit approach directions (count, 3) for grasp frames, distributed evenly around an axis.

    The first direction is the one nearest to `first` (3,).
    """
    start = first - (first @ axis) * axis
    if np.linalg.norm(start) < 1e-6:  # `first` is parallel to the axis: use any perpendicular direction
        start = np.eye(3)[int(np.argmin(np.abs(axis)))]
        start = start - (start @ axis) * axis
    start = start / np.linalg.norm(start)
    side = np.cross(axis, start)
    angle = 2 * np.pi * np.arange(count) / count
    return np.cos(angle)[:, None] * start + np.sin(angle)[:, None] * side
