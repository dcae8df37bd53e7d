"""Detection of a gripper's two jaws: links, closing direction, and the closed end of the driven joint."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from armcell.model.setup.hand_geometry import SPACING, GripperNotRecognizedError, HandGeometry

Array = NDArray[np.float64]
Part = tuple[str, ...]

SNAP = 0.9986  # cosine of 3 degrees: directions nearer to an axis of the palm's frame are that axis
NEAR_ROLL = np.cos(np.deg2rad(20))  # largest angle between the jaws' direction and the last joint's axis
WIDEST_TURN = np.deg2rad(40)  # a jaw that turns farther does not hold an object between its pads
LONGEST_PAD = 0.024  # [m] of a longer pad, the outer end is used
FACING = 0.5  # smallest cosine between the line between two jaws and their relative velocity
AS_LONG = 0.01  # [m] a third finger that ends at most this far behind the jaws closes on the object, too
POSE_JOINTS = 6  # joints of an arm that reaches any orientation at a position
STATE_FINGERS = "pass --gripper fingers=LINK,LINK with the links of both jaws"
ALIKE = 1e-3  # [m] gaps at both limits that differ less do not tell the closed end


@dataclass(frozen=True, eq=False)
class Jaws:
    """The two jaws of a detected gripper, on the +y side and on the -y side, with the axes of the hand.

    Attributes:
        plus, minus: links of the jaws.
        axes: (3, 3) rows x, y (closing direction) and z (out of the hand) in the palm's frame.
        closed, opened: positions of the driven joint.
        single: whether the minus jaw is the palm.
    """

    plus: Part
    minus: Part
    axes: Array
    closed: float
    opened: float
    single: bool = False


def find_jaws(hand: HandGeometry, fingers: tuple[Part, ...] = (), closes: str = "") -> Jaws:
    """Find the jaws of a hand.

    Args:
        fingers: links of both jaws; empty: detected.
        closes: "upper" or "lower", the closed limit of the driven joint; empty: detected.
    Raises:
        GripperNotRecognizedError: the hand has no two jaws that close on each other, or `closes`
            contradicts the meshes.
    """
    low, high = hand.driver.limits.lower, hand.driver.limits.upper
    mid = (low + high) / 2
    solid = [p for p in dict.fromkeys(hand.rigid[j.child] for j in hand.moving) if len(hand.at(p, mid))]
    if not solid:
        raise GripperNotRecognizedError("its moving links have no collision geometry")
    palm = hand.rigid[hand.palm]
    if fingers:
        sides = [_side(hand, links) for links in fingers]
        if palm in sides:
            jaws = _single(hand, sides[1 - sides.index(palm)], low, high, closes)
        else:
            jaws = _facing(hand, sides[0], sides[1], _speeds(hand, sides), low, high, closes)
    elif len(hand.moving) == 1:
        jaws = _single(hand, solid[0], low, high, closes)
    else:
        speeds = _speeds(hand, solid)
        jaws = _facing(hand, *_pair(hand, solid, speeds), speeds, low, high, closes)
    return jaws


def _side(hand: HandGeometry, links: Part) -> Part:
    """Return all links of a jaw: the links that the user specified and the links that are fixed to them."""
    return tuple(dict.fromkeys(n for link in links for n in hand.rigid[link]))


def _speeds(hand: HandGeometry, parts: list[Part]) -> dict[Part, Array]:
    """Return the mean velocity (3,) of each possible jaw (group of links of a hand) while the gripper's
    driven joint moves at unit velocity.
    """
    low, high = hand.driver.limits.lower, hand.driver.limits.upper
    mid, h = (low + high) / 2, (high - low) / 200
    return {p: (hand.at(p, mid + h).mean(0) - hand.at(p, mid - h).mean(0)) / (2 * h) for p in parts}


def _out(hand: HandGeometry, parts: list[Part], mid: float) -> Array:
    """Return the unit direction (3,) in which the jaws point out of the hand: from the palm to the moving
    parts.
    """
    out = np.concatenate([hand.at(p, mid) for p in parts]).mean(0)
    if np.linalg.norm(out) < 1e-6:
        raise GripperNotRecognizedError("its jaws surround the palm, so no direction is out of the hand")
    return out / np.linalg.norm(out)


def _pair(hand: HandGeometry, solid: list[Part], speeds: dict[Part, Array]) -> tuple[Part, Part]:
    """Select the two parts of a hand that are its jaws: parts on different branches below the palm that move
    toward each other and extend farthest out of the hand.

    Raises:
        GripperNotRecognizedError: there are no such parts, or three fingers close on the object.
    """
    mid = (hand.driver.limits.lower + hand.driver.limits.upper) / 2
    out = _out(hand, solid, mid)
    fastest = max(float(np.linalg.norm(v)) for v in speeds.values())
    pairs: list[tuple[float, Part, Part]] = []
    for a, b in combinations(solid, 2):
        relative = speeds[a] - speeds[b]
        rate = float(np.linalg.norm(relative))
        if hand.branch(a) == hand.branch(b) or rate < 0.3 * fastest:
            continue
        apart = hand.at(a, mid).mean(0) - hand.at(b, mid).mean(0)
        if abs(apart @ relative) < FACING * np.linalg.norm(apart) * rate:
            continue  # they pass each other
        pairs.append((min(float((hand.at(p, mid) @ out).max()) for p in (a, b)), a, b))
    if not pairs:
        raise GripperNotRecognizedError("no two of its moving links move toward each other", STATE_FINGERS)
    least, best = -np.inf, pairs[0]
    for pair in pairs:
        if pair[0] > least + 1e-3:
            best, least = pair, pair[0]
    _, a, b = best
    longest = {hand.branch(p): p for reach, *both in pairs if reach > least - AS_LONG for p in both}
    if len(longest) > 2:
        names = ", ".join(p[0] for p in longest.values())
        raise GripperNotRecognizedError(
            f"{len(longest)} fingers close toward a common center ({names}), but a gripper has pads on two "
            "sides of one closing direction",
            "pass --gripper fingers=A,B+C with the links of both sides",
        )
    return a, b


def _facing(
    hand: HandGeometry, a: Part, b: Part, speeds: dict[Part, Array], low: float, high: float, closes: str
) -> Jaws:
    """Return the two jaws of a gripper, given the two parts of the hand that move toward each other."""
    mid = (low + high) / 2
    y = speeds[a] - speeds[b]
    if np.linalg.norm(y) < 1e-9:
        raise GripperNotRecognizedError(f"joint {hand.driver.name} does not move its jaws toward each other")
    if (hand.at(a, mid).mean(0) - hand.at(b, mid).mean(0)) @ y < 0:
        a, b = b, a
    moving = [p for p in dict.fromkeys(hand.rigid[j.child] for j in hand.moving) if len(hand.at(p, mid))]
    axes = _axes(y, _out(hand, moving, mid))
    roll = hand.last_axis()
    if roll is not None and abs(roll @ axes[2]) > NEAR_ROLL:  # jaws may be lopsided (I2RT YAM)
        axes = _axes(y, np.sign(roll @ axes[2]) * roll)
    return Jaws(a, b, axes, *_ends(hand, a, b, axes, low, high, closes))


def _ends(
    hand: HandGeometry, a: Part, b: Part, axes: Array, low: float, high: float, closes: str
) -> tuple[float, float]:
    """Return the positions of the driven joint at which a gripper's jaws are closed and open."""
    gaps = [hand.gap(a, b, axes, q)[0] for q in (low, high)]
    if not np.isfinite(gaps).any():
        raise GripperNotRecognizedError("its jaws do not face each other in any position", STATE_FINGERS)
    return _chosen(hand, gaps, closes)


def _chosen(hand: HandGeometry, gaps: list[float], closes: str) -> tuple[float, float]:
    """Return the closed and the open position of the driven joint, given the jaws' gaps [m] at both limits.

    Raises:
        GripperNotRecognizedError: the gaps are equal, or they contradict `closes`.
    """
    name, ends = hand.driver.name, (hand.driver.limits.lower, hand.driver.limits.upper)
    at = [f"{1000 * g:.0f} mm apart" if np.isfinite(g) else "beside each other" for g in gaps]
    text = f"its jaws are {at[0]} at the lower limit of joint {name} ({ends[0]:g}), and {at[1]} at the upper "
    text += f"limit ({ends[1]:g})"
    more = gaps[0] - gaps[1] if np.isfinite(gaps).all() else 0.0
    if closes:
        if (more > ALIKE) if closes == "lower" else (more < -ALIKE):
            raise GripperNotRecognizedError(f"it does not close toward the {closes} limit: {text}")
        return ends if closes == "lower" else (ends[1], ends[0])
    if np.isfinite(gaps).all() and abs(more) < ALIKE:
        raise GripperNotRecognizedError(
            f"its closed end is not clear: {text}", "pass --gripper closes=lower or closes=upper"
        )
    return ends if not gaps[0] > gaps[1] else (ends[1], ends[0])


def _single(hand: HandGeometry, jaw: Part, low: float, high: float, closes: str) -> Jaws:
    """Return the jaws of a gripper with one moving jaw; the palm is the fixed jaw."""
    fixed = hand.rigid[hand.palm]
    if not len(hand.at(fixed, low)):
        raise GripperNotRecognizedError(f"the fixed jaw {hand.palm} has no collision geometry")
    joint = next(j for j in hand.moving if j.child in jaw)
    T_palm_joint = hand.pose(joint.parent, low) @ joint.T_parent_joint
    axis = T_palm_joint.rotation.matrix @ np.asarray(joint.axis)
    if joint.type == "prismatic":
        out = hand.at(jaw, (low + high) / 2).mean(0)
        y, ends = axis, None
    else:
        pivot = T_palm_joint.translation
        ends = _chosen(hand, [_nearest(hand, fixed, jaw, q, pivot) for q in (low, high)], closes)
        points = hand.at(jaw, ends[0]) - pivot
        flat = points - np.outer(points @ axis, axis)
        out = flat[np.argmax(np.linalg.norm(flat, axis=1))]
        y = np.cross(axis, out)
        y = np.asarray(y / np.linalg.norm(y), dtype=float)
    a, b = jaw, fixed
    mid = (low + high) / 2
    # The jaw opens away from the fixed jaw: +y is the side to which its pads move.
    if ends is not None:
        small = ends[0] + 0.1 * (ends[1] - ends[0])
        if (hand.at(jaw, small) - hand.at(jaw, ends[0])).mean(0) @ y < 0:
            y = -y
    elif (hand.at(jaw, mid).mean(0) - hand.at(fixed, mid).mean(0)) @ y < 0:
        y = -y
    axes = _axes(y, out)
    if ends is None:
        return Jaws(a, b, axes, *_ends(hand, a, b, axes, low, high, closes), single=True)
    turn = min(abs(ends[1] - ends[0]), WIDEST_TURN) / 2  # at half the opening
    return Jaws(a, b, _between_pads(hand, a, b, axes, ends[0], turn), *ends, single=True)


def _between_pads(hand: HandGeometry, a: Part, b: Part, axes: Array, q: float, turn: float) -> Array:
    """Rotate the axes of a gripper's jaws about x until z bisects the angle between the pads of the half-open
    gripper. The closing jaws then push a grasped object only slightly along z.

    If the axis of an arm with few joints is near the pad of the fixed jaw, it becomes z.

    Args:
        q: closed position of the driven joint.
        turn: [rad] angle of the moving jaw at half the opening.
    """
    _, cells, _, minus = hand.gap(a, b, axes, q)
    if not len(cells):
        return axes
    outer = cells[:, 1] > cells[:, 1].max() - LONGEST_PAD
    z, y = cells[outer, 1], minus[outer]
    slope = float(np.polyfit(z, y, 1)[0]) if np.ptp(z) > 2 * SPACING else 0.0
    z = axes[2] + (slope if abs(slope) < np.tan(WIDEST_TURN) else 0.0) * axes[1]
    z = z / np.linalg.norm(z)
    y = axes[1] - (axes[1] @ z) * z
    roll = hand.last_axis()
    if roll is not None and hand.arm_joints() < POSE_JOINTS and abs(roll @ z) > NEAR_ROLL:
        z = np.sign(roll @ z) * roll  # the arm then reaches from above in every direction
    else:
        z = z * np.cos(turn / 2) + y / np.linalg.norm(y) * np.sin(turn / 2)
    return _axes(axes[1] - (axes[1] @ z) * z, z)


def _nearest(hand: HandGeometry, fixed: Part, jaw: Part, q: float, pivot: Array) -> float:
    """Return the distance [m] from the end of a gripper's moving jaw to its fixed jaw."""
    points, others = hand.at(jaw, q), hand.at(fixed, q)
    tip = points[np.argmax(np.linalg.norm(points - pivot, axis=1))]
    return float(np.linalg.norm(others - tip, axis=1).min())


def _axes(y: Array, out: Array) -> Array:
    """Return the axes (3, 3) of a gripper's frame as rows, computed from the closing direction of the jaws
    and the direction in which they point out of the hand.
    """
    y = _snapped(y / np.linalg.norm(y))
    z = out - (out @ y) * y
    if np.linalg.norm(z) < 1e-6:
        raise GripperNotRecognizedError("its jaws move along the direction out of the hand")
    z = _snapped(z / np.linalg.norm(z))
    z = z - (z @ y) * y
    z /= np.linalg.norm(z)
    return np.stack([np.cross(y, z), y, z])


def _snapped(direction: Array) -> Array:
    """Snap the jaws' closing or outward direction (3,) to an axis of the palm's frame if the angle between
    them is less than 3 degrees. Otherwise, return the direction unchanged.
    """
    k = int(np.argmax(np.abs(direction)))
    return np.sign(direction[k]) * np.eye(3)[k] if abs(direction[k]) > SNAP else direction
