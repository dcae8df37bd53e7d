"""Motions that begin in resting contact: one rule for planners, straight lines and the motion gate.

A held object that stands on a table, or a finger that leans against an object, touches at 0.0 mm. Such a
motion may begin if it leads out of the contact: no touching pair gets deeper, and once the pairs are apart
the rest of the motion is proven without any exception.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.collision.certificate import Certificate
from armcell.collision.exact import ExactChecker
from armcell.collision.kernel.checker import KernelChecker
from armcell.core import Contact
from armcell.scene import PlanningScene

Array = NDArray[np.float64]
Pair = frozenset[str]

RESTING = 2e-3
"""[m] Deepest contact that counts as resting; physics' soft contacts sink in by less than 1 mm."""

APART = 2e-3
"""[m] Distance from which a pair counts as separated."""

DEEPER = 5e-4
"""[m] By which a pair may come closer again on its way out: rounding of a motion's corners."""

STEP = 5e-4
"""[rad or m] Joint distance between the configurations at which the pairs are measured."""


def resting_pairs(exact: ExactChecker, q: ArrayLike) -> dict[Pair, Contact]:
    """Pairs of bodies that touch at q (n,), or are nearer than `APART`: by names, their nearest contact."""
    exact.place(q)
    found: dict[Pair, Contact] = {}
    for p in np.flatnonzero(exact.pair_gaps(exact.pairs) < APART):
        a, b = int(exact.pairs[p, 0]), int(exact.pairs[p, 1])
        if exact.pair_distance(a, b) >= APART:
            continue
        contact = exact.contact_of(a, b)
        pair = frozenset((contact.body_a, contact.body_b))
        if pair not in found or contact.distance < found[pair].distance:
            found[pair] = contact
    return found


def allowing(scene: PlanningScene, pairs: Iterable[Pair]) -> PlanningScene:
    """The scene in which some pairs of bodies may touch."""
    for pair in pairs:
        a, b = sorted(pair)
        scene = scene.with_allowed(a, (b,))
    return scene


def certify_from_rest(
    checker: KernelChecker, waypoints: ArrayLike, slack: ArrayLike | None = None
) -> Certificate:
    """Prove a piecewise linear motion (k, n) free of contact; it may begin in resting contact and leave it.

    Args:
        slack: how far each joint (n,) may be off the edges [rad or m].
    Returns:
        A certificate with evidence; `at` counts along the waypoints, 0..1. `at` 0 with a contact: the start
        is in contact deeper than `RESTING`.
    """
    points = np.ascontiguousarray(waypoints, dtype=float)
    if len(points) == 1:
        points = np.vstack([points, points])
    quick = checker.certify(points, slack, evidence=False)
    if quick.free:
        return quick
    near = resting_pairs(checker.exact, points[0])
    deepest = min(near.values(), key=lambda c: c.distance, default=None)
    if deepest is None:
        return checker.certify(points, slack)
    if deepest.distance < -RESTING:
        return Certificate(False, 0.0, deepest)
    others = KernelChecker(allowing(checker.scene, near), checker.joint_names).certify(points, slack)
    if not others.free:
        return others
    at, contact = separation(checker.exact, points, near)
    edges = len(points) - 1
    if contact is not None:
        return Certificate(False, at / edges, contact)
    i = min(int(at), edges - 1)
    q = points[i] + (at - i) * (points[i + 1] - points[i])
    rest = np.vstack([q, points[i + 1 :]])
    proof = checker.certify(rest, slack)
    if proof.free or at >= edges:
        return Certificate(True)
    k = proof.at * (len(rest) - 1)  # along `rest`, whose first edge is what is left of edge i
    along = at + k * (i + 1 - at) if k < 1 else i + k
    return Certificate(False, float(along / edges), proof.contact)


def separation(exact: ExactChecker, points: Array, near: dict[Pair, Contact]) -> tuple[float, Contact | None]:
    """Where along a motion (k, n) pairs in resting contact are all separated, counted in edges.

    Returns:
        That place; the end if the pairs are apart there, though by less than `APART`. With a contact: where a
        pair gets deeper, or the end, where it still touches.
    """
    bodies = [frozenset((exact.geometries[a].body, exact.geometries[b].body)) for a, b in exact.pairs]
    rows = np.array([p for p, pair in enumerate(bodies) if pair in near], dtype=np.int64)
    best = {pair: contact.distance for pair, contact in near.items()}
    distances = dict(best)
    for i, (a, b) in enumerate(pairwise(points)):
        count = max(int(np.ceil(float(np.abs(b - a).max()) / STEP)), 1)
        for k in range(1, count + 1):
            q = a + (b - a) * (k / count)
            exact.place(q)
            gaps = exact.pair_gaps(exact.pairs[rows])
            distances = dict.fromkeys(best, np.inf)
            for row, gap in zip(rows, gaps, strict=True):
                if gap < distances[bodies[row]]:
                    g, h = (int(n) for n in exact.pairs[row])
                    distances[bodies[row]] = min(distances[bodies[row]], exact.pair_distance(g, h))
            for pair, distance in distances.items():
                if distance < min(best[pair], APART) - DEEPER:
                    return i + k / count, _contact(exact, rows, bodies, pair)
                best[pair] = max(best[pair], distance)
            if min(distances.values()) > APART:
                return i + k / count, None
    touching = [pair for pair, distance in distances.items() if distance <= 0.0]
    if touching:
        return float(len(points) - 1), _contact(exact, rows, bodies, touching[0])
    return float(len(points) - 1), None


def _contact(exact: ExactChecker, rows: NDArray[np.int64], bodies: list[Pair], pair: Pair) -> Contact:
    """The nearest contact of a pair of bodies where they are placed now."""
    contacts = [exact.contact_of(*map(int, exact.pairs[row])) for row in rows if bodies[row] == pair]
    return min(contacts, key=lambda c: c.distance)
