"""Certification: a proof that nothing touches anywhere on a motion, not only at samples.

At a configuration q, if a pair of bodies is d apart and no point of one can move against the other by
more than b during the rest of an interval, they cannot touch there when b < d. Each edge is cut in
halves until every pair is proven or shown touching (conservative advancement; Schwarzer, Saha and
Latombe, "Exact collision checking of robot paths", WAFR 2002).
"""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.collision.certificate import Certificate
from armcell.core import Contact
from armcell.core.checks import float_array
from armcell.kinematics import KinematicTree
from armcell.kinematics.tree import FIXED, PRISMATIC, REVOLUTE
from armcell.model import RobotModel

Array = NDArray[np.float64]

MIN_INTERVAL_RAD = 2e-4
"""Edges are not cut finer than this: closer than that to contact counts as touching."""


class Measures(Protocol):
    """What a proof needs of a checker: its bodies at one configuration, and their distances."""

    model: RobotModel
    tree: KinematicTree
    joint_names: tuple[str, ...]
    columns: NDArray[np.int64]
    geometries: list[Any]
    pairs: NDArray[np.int64]

    def place(self, q: ArrayLike) -> None: ...
    def pair_gaps(self, pairs: NDArray[np.int64]) -> Array: ...
    def pair_distance(self, a: int, b: int, outer: bool = False) -> float: ...
    def contact_of(self, a: int, b: int) -> Contact: ...


class MotionBound:
    """How far a pair's surfaces can move against each other per unit of each group joint [m/rad].

    Args:
        pairs: (p, 2) of geometries; all of the checker's where None.
    """

    def __init__(self, checker: Measures, pairs: NDArray[np.int64] | None = None):
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
            middle = geometry.T_link_solid.apply(geometry.solid.centre)
            radius = float(np.linalg.norm(middle) + np.linalg.norm(geometry.solid.half))
            for joint in reversed(tree.path_to(tree.link_names[geometry.link]).tolist()):
                if tree.kind[joint] != FIXED:
                    lever[joint] = abs(tree.multiplier[joint]) * (
                        radius if tree.kind[joint] == REVOLUTE else 1.0
                    )
                if tree.kind[joint] == PRISMATIC:  # a slide further down lengthens what turns above it
                    limits = checker.model.joints[checker.model.joint_names[tree.column[joint]]].limits
                    span = max(abs(limits.lower), abs(limits.upper))
                    radius += abs(tree.multiplier[joint]) * span + abs(tree.offset[joint])
                radius += float(np.linalg.norm(tree.T_parent_joint[joint, :3, 3]))
        self.per_joint = np.zeros((len(pairs), n))
        for p, (a, b) in enumerate(pairs):
            # A joint above both bodies moves them together: only joints above exactly one count.
            alone = (levers[a] > 0) != (levers[b] > 0)
            for joint in np.flatnonzero(alone):
                k = column_of.get(int(tree.column[joint]))
                if k is not None:
                    self.per_joint[p, k] += levers[a][joint] + levers[b][joint]

    def along(self, dq: Array) -> Array:
        """Bound of the relative motion of each pair over a change dq (n,) of the joints [m]."""
        moving = np.abs(dq) > 0  # 0 rad on an endless lever is no motion
        return self.per_joint[:, moving] @ np.abs(dq)[moving]


def certify_path(checker: Measures, waypoints: ArrayLike, slack: ArrayLike | None = None,
                 bound: MotionBound | None = None) -> Certificate:  # fmt: skip
    """Prove a piecewise linear motion (k, n) free of contact.

    Args:
        slack: how far each joint (n,) may be from the straight edges at the same instant [rad].
    Returns:
        A certificate; `at` counts along the waypoints, 0..1.
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


def _certify_edge(checker: Measures, bound: MotionBound, q0: Array, q1: Array, slack: Array) -> Certificate:
    dq = q1 - q0
    motion = bound.along(dq)
    length = float(np.max(np.abs(dq), initial=0.0))
    clearance = np.inf
    stack = [(0.5, 0.5, np.arange(len(checker.pairs)))]  # centre, half width, pairs left to prove
    while stack:
        s, half, left = stack.pop()
        checker.place(q0 + s * dq)
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
