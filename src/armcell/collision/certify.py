"""Certification of paths: proof that a motion is collision-free everywhere, and the `Certificate`.

If two bodies have distance d at a configuration and their relative motion over the rest of an interval
is less than d, they cannot touch in the interval. The algorithm bisects each edge until every pair is
certified or found in contact (conservative advancement; Schwarzer, Saha and Latombe, "Exact collision
checking of robot paths", WAFR 2002).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.core import Contact
from armcell.core.checks import float_array
from armcell.kinematics import KinematicTree
from armcell.kinematics.tree import FIXED, PRISMATIC, REVOLUTE
from armcell.model import RobotModel

Array = NDArray[np.float64]
MIN_INTERVAL_RAD = 2e-4
"""[rad] Smallest interval of the bisection; a pair that is still uncertified there counts as touching."""


@dataclass(frozen=True)
class Certificate:
    """Certificate of a motion: whether the motion was certified collision-free, and if not, which contact
    prevents it.

    Attributes:
        free: True if the motion is certified collision-free.
        at: position of the contact as a fraction of the motion, from 0 to 1; only if not `free`.
        contact: pair of bodies in contact, or None if unknown; only if not `free`.
        clearance: smallest distance [m] among the configurations that were measured.
    """

    free: bool
    at: float = 1.0
    contact: Contact | None = None
    clearance: float = np.inf


class DistanceChecker(Protocol):
    """Interface that a collision checker provides to certify motions: it moves bodies to a configuration and
    measures distances between them.
    """

    model: RobotModel
    tree: KinematicTree
    joint_names: tuple[str, ...]
    columns: NDArray[np.int64]
    geometries: list[Any]
    pairs: NDArray[np.int64]

    def set_configuration(self, q: ArrayLike) -> None: ...
    def pair_gaps(self, pairs: NDArray[np.int64]) -> Array: ...
    def pair_distance(self, a: int, b: int, outer: bool = False) -> float: ...
    def contact_of(self, a: int, b: int) -> Contact: ...


class MotionBound:
    """Upper bounds on the relative displacement of two geometries per unit of motion of each joint [m/rad or
    m/m], for many pairs of geometries. The bounds serve to certify motions.

    Args:
        checker: the checker with the geometries and the group's joints.
        pairs: (p, 2) indices of geometries; by default all pairs of the checker.
    """

    def __init__(self, checker: DistanceChecker, pairs: NDArray[np.int64] | None = None):
        self.checker = checker
        pairs = checker.pairs if pairs is None else pairs
        wanted = set(pairs.ravel().tolist())
        tree = checker.tree
        column_of = {int(c): k for k, c in enumerate(checker.columns)}
        n, joints = len(checker.joint_names), len(tree.parent)
        levers = [np.zeros(joints) for _ in checker.geometries]  # per joint above the geometry
        for i, (lever, geometry) in enumerate(zip(levers, checker.geometries, strict=True)):
            if geometry.link < 0 or i not in wanted:
                continue
            middle = geometry.T_link_solid.apply(geometry.solid.center)
            radius = float(np.linalg.norm(middle) + np.linalg.norm(geometry.solid.half))
            for joint in reversed(tree.path_to(tree.link_names[geometry.link]).tolist()):
                if tree.kind[joint] != FIXED:
                    lever[joint] = abs(tree.multiplier[joint]) * (
                        radius if tree.kind[joint] == REVOLUTE else 1.0
                    )
                if tree.kind[joint] == PRISMATIC:  # a slide lengthens the lever arm of the joints above it
                    limits = checker.model.joints[checker.model.joint_names[tree.column[joint]]].limits
                    span = max(abs(limits.lower), abs(limits.upper))
                    radius += abs(tree.multiplier[joint]) * span + abs(tree.offset[joint])
                radius += float(np.linalg.norm(tree.T_parent_joint[joint, :3, 3]))
        self.per_joint = np.zeros((len(pairs), n))
        for p, (a, b) in enumerate(pairs):
            # A joint above both bodies moves them together, so only joints above exactly one body count.
            alone = (levers[a] > 0) != (levers[b] > 0)
            for joint in np.flatnonzero(alone):
                k = column_of.get(int(tree.column[joint]))
                if k is not None:
                    self.per_joint[p, k] += levers[a][joint] + levers[b][joint]

    def along(self, dq: Array) -> Array:
        """Return upper bounds (p,) [m] on the relative motion of the geometries of each pair when the joints
        change by dq (n,), to certify a motion.
        """
        moving = np.abs(dq) > 0  # avoids 0 * inf for levers of infinite length
        return self.per_joint[:, moving] @ np.abs(dq)[moving]


def certify_path(checker: DistanceChecker, waypoints: ArrayLike, slack: ArrayLike | None = None,
                 bound: MotionBound | None = None) -> Certificate:  # fmt: skip
    """Certify that a piecewise linear motion (k, n) is collision-free.

    Args:
        checker: the checker with the bodies and pairs.
        waypoints: (k, n) joint positions.
        slack: (n,) largest deviation of each joint from the straight edges [rad or m].
        bound: motion bounds of the checker's pairs; by default computed here.
    Returns:
        A certificate; its `at` is the fraction of the motion, from 0 to 1, counted in waypoints.
    """
    n = len(checker.columns)
    points = float_array(waypoints, (None, n), "waypoints")
    bound = bound or MotionBound(checker)
    slack_bound = bound.along(np.zeros(n) if slack is None else float_array(slack, (n,), "slack"))
    clearance, edges = np.inf, max(len(points) - 1, 1)
    if len(points) == 1:
        points = np.vstack([points, points])
    for i in range(len(points) - 1):
        result = _certify_edge(checker, bound, points[i], points[i + 1], slack_bound)
        clearance = min(clearance, result.clearance)
        if not result.free:
            return Certificate(False, (i + result.at) / edges, result.contact, clearance)
    return Certificate(True, 1.0, None, clearance)


def _certify_edge(
    checker: DistanceChecker, bound: MotionBound, q0: Array, q1: Array, slack: Array
) -> Certificate:
    dq = q1 - q0
    motion = bound.along(dq)
    length = float(np.max(np.abs(dq), initial=0.0))
    clearance = np.inf
    stack = [(0.5, 0.5, np.arange(len(checker.pairs)))]  # center, half width, pairs not yet certified
    while stack:
        s, half, left = stack.pop()
        checker.set_configuration(q0 + s * dq)
        need = motion[left] * half + slack[left]
        gaps = checker.pair_gaps(checker.pairs[left])
        open_ = np.flatnonzero(gaps <= need)
        unproven = []
        for k in open_:
            a, b = int(checker.pairs[left[k], 0]), int(checker.pairs[left[k], 1])
            if checker.pair_distance(a, b, outer=True) > need[k]:
                continue
            distance = checker.pair_distance(a, b)
            clearance = min(clearance, distance)
            if distance <= 0.0 or (distance <= need[k] and length * half < MIN_INTERVAL_RAD):
                return Certificate(False, s, checker.contact_of(a, b), clearance)
            if distance <= need[k]:
                unproven.append(left[k])
        if unproven:
            rest = np.array(unproven)
            stack.append((s + half / 2, half / 2, rest))
            stack.append((s - half / 2, half / 2, rest))
    return Certificate(True, 1.0, None, clearance)
