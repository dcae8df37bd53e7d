"""Motions that begin in resting contact: one rule for planners, straight lines and the motion gate.

A held object that stands on a table, or a finger that leans against an object, touches at 0.0 mm. Such a
motion may begin if it leads out of the contact: a touching pair does not get deeper, it separates within
`DRAG`, and from the place where it is `APART` the motion is proven without any exception.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.collision.certificate import Certificate
from armcell.collision.certify import MotionBound
from armcell.collision.exact import ExactChecker
from armcell.collision.kernel.checker import KernelChecker
from armcell.core import Contact
from armcell.scene import PlanningScene

Array = NDArray[np.float64]
Pair = frozenset[str]

RESTING = 2e-3
"""[m] Deepest contact that counts as resting; physics' soft contacts sink in by less than 1 mm."""

APART = 1e-3
"""[m] Distance from which a pair counts as separated."""

DEEPER = 5e-4
"""[m] By which a pair may come closer again on its way out: rounding of a motion's corners."""

DRAG = 5e-3
"""[m] That a body may move along another one, and twice their depth, before their contact has ended."""

TOUCH = 1e-5
"""[m] Nearer pairs touch: the kernel calls 2 micrometers a contact, coal one."""

STEP = 2e-4
"""[m] Most that a touching pair moves between two of the configurations at which it is measured."""

STEPS = 3000
"""Of those: a pair that is not apart after so many slides along another one."""

ROOM = 1.5
"""Times the slack's own motion that a pair must be apart before a proof with slack can succeed."""

COARSE = 0.02
"""[rad or m] Between configurations where the distance of separated pairs is looked up, not proven."""

GROWTH = 1e-5  # [m] of a distance in half of `COARSE`, of a pair that moves apart
FAR = 0.25  # [m] `KernelChecker.clearance` reports no more
LARGEST = 10.0  # [m] of a solid's half size: half-spaces have no corners
CORNERS = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)


def resting_pairs(exact: ExactChecker, q: ArrayLike, within: ArrayLike = APART) -> dict[Pair, Contact]:
    """Pairs of bodies that touch at q (n,), or nearly do: by names, their nearest contact.

    Args:
        within: [m] the largest distance, of all pairs or of each of the checker's (p,).
    """
    exact.place(q)
    found: dict[Pair, Contact] = {}
    most = np.broadcast_to(np.asarray(within, dtype=float), len(exact.pairs))
    for p in np.flatnonzero(exact.pair_gaps(exact.pairs) < most):
        a, b = int(exact.pairs[p, 0]), int(exact.pairs[p, 1])
        if exact.pair_distance(a, b) >= most[p]:
            continue
        contact = exact.contact_of(a, b)
        pair = frozenset((contact.body_a, contact.body_b))
        if pair not in found or contact.distance < found[pair].distance:
            found[pair] = contact
    return found


def touching(checker: KernelChecker, q: ArrayLike) -> list[Contact]:
    """The contacts at q (n,) of bodies that the group moves, deepest first; what only the kernel calls a
    contact is named by the pair that is nearest."""
    contacts = sorted(resting_pairs(checker.exact, q, TOUCH).values(), key=lambda c: c.distance)
    if contacts or not checker.touches(q):
        return contacts
    nearest = checker.exact.nearest(q)
    return [] if nearest is None else [nearest]


def allowing(scene: PlanningScene, pairs: Iterable[Pair]) -> PlanningScene:
    """The scene in which some pairs of bodies may touch."""
    for pair in pairs:
        a, b = sorted(pair)
        scene = scene.with_allowed(a, (b,))
    return scene


def certify_from_rest(
    checker: KernelChecker,
    waypoints: ArrayLike,
    slack: ArrayLike | None = None,
    deepest: float = RESTING,
    *,
    evidence: bool = True,
) -> Certificate:
    """Prove a piecewise linear motion (k, n) free of contact; it may lead out of resting contact.

    Pairs that touch at the start, or are too near to be proven with the slack, are measured by the exact
    checker until they are apart; all other pairs are proven as ever.

    Args:
        slack: how far each joint (n,) may be off the edges [rad or m].
        deepest: [m] contact at the start that may be left.
        evidence: where the start is free and the proof fails, find out which pair it is.
    Returns:
        A certificate; `at` counts along the waypoints, 0..1. `at` 0 with a contact: the start is in contact
        deeper than `deepest`.
    """
    points = np.ascontiguousarray(waypoints, dtype=float)
    if len(points) == 1:
        points = np.vstack([points, points])
    quick = checker.certify(points, slack, evidence=False)
    if quick.free:
        return quick
    exact, need = checker.exact, np.full(len(checker.exact.pairs), APART)
    if slack is not None:
        need += ROOM * MotionBound(exact).along(np.asarray(slack, dtype=float))
    near = resting_pairs(exact, points[0], need)
    worst = min(near.values(), key=lambda c: c.distance, default=None)
    if worst is None:
        return checker.certify(points, slack, evidence=evidence)
    if worst.distance < -deepest:
        return Certificate(False, 0.0, worst)
    edges = len(points) - 1
    leaving = Leaving(exact, points[0], _measured(checker, points, near))
    at, contact = leaving.until_apart(points, lambda q: not checker.touches(q))
    if contact is None and at < edges and not checker.certify(_from(points, at), evidence=False).free:
        # The kernel's pieces of a mesh reach beyond it: farther on it can be proven.
        farther, blocked = leaving.until_apart(points, lambda q: checker.clearance([q], APART) > APART / 2)
        at = farther if blocked is None else at
    others = KernelChecker(allowing(checker.scene, near), checker.joint_names).certify(points, slack)
    if not others.free and (contact is None or others.at <= at / edges):
        return others
    if contact is not None:
        return Certificate(False, at / edges, contact)
    if at >= edges:
        return Certificate(True)
    rest = _from(points, at)
    if checker.certify(rest, slack, evidence=False).free:
        return Certificate(True)
    bare = checker.certify(rest)
    if not bare.free:
        return Certificate(False, _along(at, bare.at, rest, edges), bare.contact)
    if slack is None:
        return Certificate(True)
    # Pairs may be too near for the slack while they move apart: until then they are proven without it.
    farther, contact = Leaving(exact, points[0], near).until_beyond(points, at, need)
    if contact is not None:
        return Certificate(False, farther / edges, contact)
    if farther >= edges:
        return Certificate(True)
    rest = _from(points, farther)
    proof = checker.certify(rest, slack)
    if proof.free:
        return Certificate(True)
    return Certificate(False, _along(farther, proof.at, rest, edges), proof.contact)


def _measured(checker: KernelChecker, points: Array, near: Mapping[Pair, Contact]) -> Iterable[Pair]:
    """Those of the pairs near each other that have to be measured on a motion's way out: the touching ones,
    where the kernel proves that the others do not touch."""
    touch = [pair for pair, contact in near.items() if contact.distance <= TOUCH]
    if len(touch) == len(near):
        return near
    rest = KernelChecker(allowing(checker.scene, touch), checker.joint_names)
    return touch if rest.certify(points, evidence=False).free else near


def separation(
    exact: ExactChecker, points: Array, near: Mapping[Pair, Contact]
) -> tuple[float, Contact | None]:
    """Where along a motion (k, n) pairs in resting contact are all separated, counted in edges.

    Returns:
        That place; the end if the pairs are apart there, though by less than `APART`. With a contact: where a
        pair gets deeper or is dragged along, or the end, where it still touches.
    """
    return Leaving(exact, points[0], near).until_apart(points)


def clearance_from_rest(checker: KernelChecker, waypoints: ArrayLike) -> float:
    """`KernelChecker.clearance` of a motion (k, n) that may begin in resting contact [m].

    A pair that touches at the start counts from the place where it no longer moves apart.
    """
    points = np.ascontiguousarray(waypoints, dtype=float)
    checker = checker.without_room or checker
    if not checker.touches(points[0]):
        return checker.clearance(points)
    near = resting_pairs(checker.exact, points[0])
    if not near or len(points) == 1:
        return 0.0
    leaving = Leaving(checker.exact, points[0], near)
    at, contact = leaving.until_apart(points, lambda q: not checker.touches(q))
    if contact is not None:
        return 0.0
    others = KernelChecker(allowing(checker.scene, near), checker.joint_names).clearance(points)
    at = leaving.while_parting(points, at)
    return others if at >= len(points) - 1 else min(others, checker.clearance(_from(points, at)))


class Leaving:
    """Pairs of bodies in resting contact, and whether a motion leads out of it.

    Args:
        q: (n,) where the motion begins. near: pairs of bodies that touch there, or nearly do.
    """

    def __init__(self, exact: ExactChecker, q: ArrayLike, near: Iterable[Pair]):
        self.exact, pairs = exact, set(near)
        g = exact.geometries
        self.rows = [p for p, (a, b) in enumerate(exact.pairs) if frozenset((g[a].body, g[b].body)) in pairs]
        self.pairs = exact.pairs[self.rows].reshape(-1, 2)
        exact.place(q)
        self.first = self._distances()
        self.touching = self.first <= TOUCH
        self.corners = [self._corners(k) for k in range(len(self.pairs))]
        self._bound: MotionBound | None = None

    def refuses(self, q: ArrayLike) -> Contact | None:
        """The pair that keeps the robot from standing at q (n,) on its way out, or None."""
        self.exact.place(q)
        distances = self._distances()
        broken = self._broken(distances, np.minimum(self.first, APART))
        return None if broken is None else self._contact(broken)

    def until_apart(
        self, points: Array, free: Callable[[Array], bool] = lambda q: True
    ) -> tuple[float, Contact | None]:
        """See `separation`.

        Args:
            free: whether the place where the pairs are apart will do to begin a proof at (n,).
        """
        best = np.minimum(self.first, APART)
        distances, last = self.first, len(points) - 1
        travel, steps = np.zeros(len(self.first)), 0  # bounds of how far pairs have moved
        if not self.touching.any() and free(points[0]):
            return 0.0, None
        for i in range(last):
            a, dq, t = points[i], points[i + 1] - points[i], 0.0
            per_edge = self.bound.along(dq)
            while t < 1.0:
                # As far as no pair can have come into contact unseen, or a touching one much deeper.
                most = np.maximum(0.5 * distances, np.where(self.touching, STEP, TOUCH))
                before = t
                t = min(t + float(np.min(most / np.maximum(per_edge, 1e-12), initial=np.inf)), 1.0)
                travel, steps = travel + (t - before) * per_edge, steps + 1
                q = a + t * dq
                self.exact.place(q)
                distances = self._distances()
                broken = self._broken(distances, best, travel)
                if broken is None and steps > STEPS:
                    broken = int(np.argmin(distances))  # it keeps so near that it does not lead out
                if broken is not None:
                    return i + t, self._contact(broken)
                best = np.maximum(best, np.minimum(distances, APART))
                if np.all(distances[self.touching] > APART) and free(q):
                    return i + t, None
        ends = np.flatnonzero(self.touching & (distances <= 0.0))
        return float(last), self._contact(int(ends[0])) if len(ends) else None

    def until_beyond(self, points: Array, at: float, need: Array) -> tuple[float, Contact | None]:
        """The first place after another one (in edges) where all pairs are as far apart [m] as they need to
        be, or the end. With a contact: a pair that no longer moves apart before that.

        Args:
            need: (p,) of all the checker's pairs.
        """
        before = np.full(len(self.rows), -np.inf)
        since = np.inf  # [rad or m] that the joints have moved since `before`
        last, place = _between(points, at), at
        for place in _places(points, at):
            q = _between(points, place)
            since, last = since + float(np.max(np.abs(q - last))), q
            self.exact.place(q)
            distances = self._distances()
            near = distances <= need[self.rows]
            if not near.any():
                return place, None
            if since < COARSE / 2:
                continue
            stays = np.flatnonzero(near & (distances < before + GROWTH))
            if len(stays):
                return place, self._contact(int(stays[0]))
            before, since = distances, 0.0
        return place, None

    def while_parting(self, points: Array, at: float) -> float:
        """Where the pairs that touched stop moving apart, from a place (in edges) on; the end if never."""
        before = -np.inf
        for place in _places(points, at):
            self.exact.place(_between(points, place))
            now = float(np.min(self._distances(FAR)[self.touching], initial=np.inf))
            if now >= FAR:
                return place
            if now < before:
                return place
            before = now
        return float(len(points) - 1)

    @property
    def bound(self) -> MotionBound:
        if self._bound is None:
            self._bound = MotionBound(self.exact, self.pairs)
        return self._bound

    def _distances(self, within: float = 0.02) -> Array:
        """Of each pair as placed [m]; lower bounds of those farther apart than `within`."""
        distances = self.exact.pair_gaps(self.pairs)
        for k in np.flatnonzero(distances < within):
            distances[k] = self.exact.pair_distance(int(self.pairs[k, 0]), int(self.pairs[k, 1]))
        return distances

    def _broken(self, distances: Array, best: Array, travel: Array | None = None) -> int | None:
        """The pair that touches where it must not: new, deeper than before, or dragged along.

        Args:
            travel: bounds (p,) of how far the pairs have moved [m], where they are known.
        """
        new = ~self.touching & (distances <= 0.0)
        deeper = self.touching & (distances < best - DEEPER)
        found = np.flatnonzero(new | deeper)
        if len(found):
            return int(found[np.argmin(distances[found])])
        most = DRAG - 2.0 * np.minimum(self.first, 0.0)
        far = True if travel is None else travel > most
        for k in np.flatnonzero(self.touching & (distances <= 0.0) & far):
            if self._travel(int(k)) > most[k]:
                return int(k)
        return None

    def _travel(self, k: int) -> float:
        """How far [m] the bodies of a pair have moved against each other: the smaller of two views."""
        now = self._corners(k)
        return min(
            float(np.max(np.linalg.norm(b - a, axis=1))) for a, b in zip(self.corners[k], now, strict=True)
        )

    def _corners(self, k: int) -> tuple[Array, Array]:
        """(8, 3) corners of each geometry of a pair, in the other's frame."""
        a, b = (self._placed(int(i)) for i in self.pairs[k])
        return (a[1] - b[0][:3, 3]) @ b[0][:3, :3], (b[1] - a[0][:3, 3]) @ a[0][:3, :3]

    def _placed(self, i: int) -> tuple[Array, Array]:
        """Pose (4, 4) of a geometry as placed, and its corners (8, 3), in the world."""
        geometry = self.exact.geometries[i]
        T = geometry.T_link_solid.matrix
        if geometry.link >= 0:
            T = self.exact.Ts[geometry.link] @ T
        solid = geometry.solid
        corners = solid.centre + np.minimum(solid.half, LARGEST) * CORNERS
        return T, corners @ T[:3, :3].T + T[:3, 3]

    def _contact(self, k: int) -> Contact:
        return self.exact.contact_of(int(self.pairs[k, 0]), int(self.pairs[k, 1]))


def _between(points: Array, at: float) -> Array:
    i = min(int(at), len(points) - 2)
    return points[i] + (at - i) * (points[i + 1] - points[i])


def _from(points: Array, at: float) -> Array:
    """The rest of a motion (k, n), from a place on (in edges)."""
    i = min(int(at), len(points) - 2)
    return np.vstack([_between(points, at), points[i + 1 :]])


def _places(points: Array, at: float) -> Iterable[float]:
    """Places (in edges) at most `COARSE` apart, from one to the end."""
    i = min(int(at), len(points) - 2)
    for k in range(i, len(points) - 1):
        begin = at - k if k == i else 0.0
        length = float(np.max(np.abs(points[k + 1] - points[k]))) * (1.0 - begin)
        for t in np.linspace(begin, 1.0, max(int(np.ceil(length / COARSE)), 1), endpoint=False):
            yield k + float(t)
    yield float(len(points) - 1)


def _along(at: float, share: float, rest: Array, edges: int) -> float:
    """A share of what is left of a motion after a place (in edges), as a share of the whole motion."""
    i = min(int(at), edges - 1)
    k = share * (len(rest) - 1)  # along `rest`, whose first edge is what is left of edge i
    place = at + k * (i + 1 - at) if k < 1 else i + k
    return float(place / edges)
