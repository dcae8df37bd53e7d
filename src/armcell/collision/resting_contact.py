"""Certification of motions that start in resting contact, for planners and the motion gate.

A held object on a table, or a finger on an object, touches at a distance of 0.0 mm. A motion may start in
such a resting contact if it leads out of the contact: a touching pair must not get deeper and must separate
within `DRAG`. From the position where all pairs are `APART`, the rest of the motion must be certified without
exceptions.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.collision.certify import Certificate, MotionBound
from armcell.collision.exact_checker import ExactChecker
from armcell.collision.kernel.checker import KernelChecker
from armcell.core import Contact
from armcell.scene import PlanningScene

Array = NDArray[np.float64]
Pair = frozenset[str]

RESTING = 2e-3
"""[m] Deepest contact that counts as resting; soft contacts in physics penetrate by less than 1 mm."""

APART = 1e-3
"""[m] Distance above which a pair counts as separated."""

DEEPER = 5e-4
"""[m] Distance by which a separating pair may approach again, because motions round their corners."""

DRAG = 5e-3
"""[m] Distance that a body may slide along another one, plus twice the depth, before their contact ends."""

TOUCH = 1e-5
"""[m] Pairs closer than this touch; contact starts at 2 um in the kernel and at 1 um in coal."""

STEP = 2e-4
"""[m] Largest motion of a touching pair between two configurations at which its distance is measured."""

STEPS = 3000
"""Largest number of measured configurations; a pair still not separated then slides along its contact."""

ROOM = 1.5
"""Smallest ratio of a pair's distance to its motion within the slack at which certification can succeed."""

COARSE = 0.02
"""[rad or m] Largest step between configurations at which distances are sampled without certification."""

GROWTH = 1e-5  # [m] smallest increase of the distance of a separating pair within half of `COARSE`
ROUNDING = 1e-9  # [m] of a measured distance: a pair that only slides does not move apart
FAR = 0.25  # [m] largest clearance that `KernelChecker.clearance` returns
LARGEST = 10.0  # [m] upper limit of a solid's half extents, because half-spaces have no corners
CORNERS = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)


def resting_pairs(exact: ExactChecker, q: ArrayLike, within: ArrayLike = APART) -> dict[Pair, Contact]:
    """Return the pairs of bodies in resting contact at q (n,), with their contacts. These bodies touch or
    nearly touch.

    Each pair has the contact at its smallest distance.

    Args:
        within: largest distance [m], for all pairs or for each of the checker's pairs (p,).
    """
    exact.set_configuration(q)
    found: dict[Pair, Contact] = {}
    most = np.broadcast_to(np.asarray(within, dtype=float), len(exact.pairs))
    for p in np.flatnonzero(exact.pair_gaps(exact.pairs) < most):
        a, b = int(exact.pairs[p, 0]), int(exact.pairs[p, 1])
        distance = exact.pair_distance(a, b)
        if distance >= most[p]:
            continue
        contact = exact.contact_of(a, b, distance)
        pair = frozenset((contact.body_a, contact.body_b))
        if pair not in found or contact.distance < found[pair].distance:
            found[pair] = contact
    return found


def resting_contacts(checker: KernelChecker, q: ArrayLike) -> list[Contact]:
    """Return the contacts of those bodies that the group moves and that
    rest on other bodies at q (n,), deepest first.

    If only the kernel reports a contact, the result is the nearest pair of the exact checker.
    """
    contacts = sorted(resting_pairs(checker.exact, q, TOUCH).values(), key=lambda c: c.distance)
    if contacts or not checker.touches(q):
        return contacts
    nearest = checker.exact.nearest(q)
    return [] if nearest is None else [nearest]


def with_allowed_contacts(scene: PlanningScene, pairs: Iterable[Pair]) -> PlanningScene:
    """Return a copy of the scene in which the given pairs of bodies, which rest on each other at the start of
    a motion, may touch.
    """
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
    """Certify that a motion (k, n) out of resting contact is collision-free. Bodies in resting contact at the
    start may touch until they separate.

    The motion may start in resting contact and lead out of it. The exact checker measures pairs that touch at
    the start, or that are too close for a certificate with slack, until they are separated. All other pairs
    are certified on the whole motion as usual.

    Args:
        checker: the checker of the scene.
        waypoints: (k, n) joint positions.
        slack: (n,) largest deviation of each joint from the straight edges [rad or m].
        deepest: largest penetration depth at the start that the motion may leave [m].
        evidence: if the start is collision-free but the certification fails, find the pair in contact.
    Returns:
        A certificate; its `at` is the fraction of the motion, from 0 to 1. If `at` is 0 and there is a
        contact, the start is in contact deeper than `deepest`.
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
    leaving = SeparationChecker(exact, points[0], _measured(checker, points, near))
    at, contact = leaving.separated_at(points, lambda q: not checker.touches(q))
    if contact is None and at < edges and not checker.certify(_from(points, at), evidence=False).free:
        # The kernel's pieces extend beyond the mesh, so certification can succeed from a later position.
        farther, blocked = leaving.separated_at(points, lambda q: checker.clearance([q], APART) > APART / 2)
        at = farther if blocked is None else at
    others = KernelChecker(with_allowed_contacts(checker.scene, near), checker.joint_names).certify(
        points, slack
    )
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
    # While separating pairs are still too close for the slack, the motion is certified without slack.
    farther, contact = SeparationChecker(exact, points[0], near).clearance_reached_at(points, at, need)
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
    """Return the body pairs whose distances must be measured while a motion separates bodies in resting
    contact.

    These are the touching pairs if the kernel certifies all others, else all near pairs.
    """
    touch = [pair for pair, contact in near.items() if contact.distance <= TOUCH]
    if len(touch) == len(near):
        return near
    rest = KernelChecker(with_allowed_contacts(checker.scene, touch), checker.joint_names)
    return touch if rest.certify(points, evidence=False).free else near


def separation(
    exact: ExactChecker, points: Array, near: Mapping[Pair, Contact]
) -> tuple[float, Contact | None]:
    """Return the position along a motion (k, n) at which all bodies that started in resting contact have
    separated.

    Args:
        exact: the exact checker.
        points: (k, n) waypoints.
        near: pairs in resting contact at the start.
    Returns:
        The position, and a contact or None. The position is counted in edges: 2.5 is the middle of the third
        edge. It is the end if the pairs separate by less than `APART`. With a contact, it is the position
        where the pair gets deeper or is dragged along, or the end, where the pair still touches.
    """
    return SeparationChecker(exact, points[0], near).separated_at(points)


def clearance_from_rest(checker: KernelChecker, waypoints: ArrayLike) -> float:
    """Return the clearance [m] of a motion (k, n) that may start with bodies in resting contact.

    Like `KernelChecker.clearance`, but a pair that touches at the start counts only from the position where
    it stops separating.
    """
    points = np.ascontiguousarray(waypoints, dtype=float)
    checker = checker.without_arm_clearance or checker
    if not checker.touches(points[0]):
        return checker.clearance(points)
    near = resting_pairs(checker.exact, points[0])
    if not near or len(points) == 1:
        return 0.0
    leaving = SeparationChecker(checker.exact, points[0], near)
    at, contact = leaving.separated_at(points, lambda q: not checker.touches(q))
    if contact is not None:
        return 0.0
    others = KernelChecker(with_allowed_contacts(checker.scene, near), checker.joint_names).clearance(points)
    at = leaving.separating_until(points, at)
    return others if at >= len(points) - 1 else min(others, checker.clearance(_from(points, at)))


class SeparationChecker:
    """Checker that tests whether a motion separates given pairs of bodies in resting contact.

    Args:
        exact: the exact checker.
        q: (n,) start of the motion.
        near: pairs of bodies that touch or nearly touch at the start.
    """

    def __init__(self, exact: ExactChecker, q: ArrayLike, near: Iterable[Pair]):
        self.exact, pairs = exact, set(near)
        g = exact.geometries
        self.rows = [p for p, (a, b) in enumerate(exact.pairs) if frozenset((g[a].body, g[b].body)) in pairs]
        self.pairs = exact.pairs[self.rows].reshape(-1, 2)
        exact.set_configuration(q)
        self.first = self._distances()
        self.touching = self.first <= TOUCH
        self.corners = [self._corners(k) for k in range(len(self.pairs))]
        self._bound: MotionBound | None = None

    def forbidden_contact(self, q: ArrayLike) -> Contact | None:
        """Return a forbidden contact at configuration q (n,), or None, while the robot moves bodies out of
        resting contact.

        A contact is forbidden if it is new, deeper than at the start, or dragged along.
        """
        self.exact.set_configuration(q)
        distances = self._distances()
        broken = self._broken(distances, np.minimum(self.first, APART))
        return None if broken is None else self._contact(broken)

    def separated_at(
        self, points: Array, free: Callable[[Array], bool] = lambda q: True
    ) -> tuple[float, Contact | None]:
        """Return the position along a motion at which all pairs in resting contact are separated.

        Args:
            points: (k, n) waypoints.
            free: predicate on configurations (n,); the position is accepted as the start of a certificate
                only if the predicate is True.
        Returns:
            As `separation`.
        """
        best = np.minimum(self.first, APART)
        distances, last = self.first, len(points) - 1
        travel, steps = np.zeros(len(self.first)), 0  # upper bounds of each pair's relative motion [m]
        if not self.touching.any() and free(points[0]):
            return 0.0, None
        for i in range(last):
            a, dq, t = points[i], points[i + 1] - points[i], 0.0
            per_edge = self.bound.along(dq)
            while t < 1.0:
                # The largest step in which no pair can touch unnoticed and no touching pair gets much deeper.
                most = np.maximum(0.5 * distances, np.where(self.touching, STEP, TOUCH))
                before = t
                t = min(t + float(np.min(most / np.maximum(per_edge, 1e-12), initial=np.inf)), 1.0)
                travel, steps = travel + (t - before) * per_edge, steps + 1
                q = a + t * dq
                self.exact.set_configuration(q)
                distances = self._distances()
                broken = self._broken(distances, best, travel)
                if broken is None and steps > STEPS:
                    broken = int(np.argmin(distances))  # the pair stays too close to leave the contact
                if broken is not None:
                    return i + t, self._contact(broken)
                best = np.maximum(best, np.minimum(distances, APART))
                if np.all(distances[self.touching] > APART) and free(q):
                    return i + t, None
        ends = np.flatnonzero(self.touching & (distances <= 0.0))
        return float(last), self._contact(int(ends[0])) if len(ends) else None

    def clearance_reached_at(self, points: Array, at: float, need: Array) -> tuple[float, Contact | None]:
        """Return the first position along a motion at which all pairs that were in resting contact have
        reached their required distances.

        Positions are counted in edges: 2.5 is the middle of the third edge.

        Args:
            points: (k, n) waypoints.
            at: position at which the search starts.
            need: (p,) required distances [m] of all pairs of the checker.
        Returns:
            The position (the end if there is none) and None, or the position where a pair stops separating
            too early and its contact.
        """
        before = np.full(len(self.rows), -np.inf)
        since = np.inf  # [rad or m] joint motion since `before` was measured
        last, place = _between(points, at), at
        for place in _places(points, at):
            q = _between(points, place)
            since, last = since + float(np.max(np.abs(q - last))), q
            self.exact.set_configuration(q)
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

    def separating_until(self, points: Array, at: float) -> float:
        """Return the position along a motion up to which bodies that start in resting contact keep moving
        apart.

        The search starts at `at`; both positions are counted in edges. The result is the end if the pairs
        separate all the time.
        """
        before = -np.inf
        for place in _places(points, at):
            self.exact.set_configuration(_between(points, place))
            now = float(np.min(self._distances(FAR)[self.touching], initial=np.inf))
            if now >= FAR:
                return place
            if now <= before + ROUNDING:
                return place
            before = now
        return float(len(points) - 1)

    @property
    def bound(self) -> MotionBound:
        if self._bound is None:
            self._bound = MotionBound(self.exact, self.pairs)
        return self._bound

    def _distances(self, within: float = 0.02) -> Array:
        """Return the current distance [m] of each pair in resting contact.

        For pairs farther apart than `within`, the values are lower bounds.
        """
        distances = self.exact.pair_gaps(self.pairs)
        for k in np.flatnonzero(distances < within):
            distances[k] = self.exact.pair_distance(int(self.pairs[k, 0]), int(self.pairs[k, 1]))
        return distances

    def _broken(self, distances: Array, best: Array, travel: Array | None = None) -> int | None:
        """Find a contact that is forbidden while a motion separates bodies in resting contact. Return the
        index of the body pair, or None if there is no such contact.

        Forbidden are new contacts, contacts that get deeper, and contacts that are dragged along.

        Args:
            distances: (p,) current distances [m].
            best: (p,) largest distances reached so far [m], limited to `APART`.
            travel: (p,) upper bounds of each pair's relative motion [m], if known.
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
        """Return how far [m] the two bodies of pair `k`, which start in resting contact, have moved relative
        to each other.

        The motion counts from the start. The value is the smaller of the two motions seen from either body.
        """
        now = self._corners(k)
        return min(
            float(np.max(np.linalg.norm(b - a, axis=1))) for a, b in zip(self.corners[k], now, strict=True)
        )

    def _corners(self, k: int) -> tuple[Array, Array]:
        """Return the bounding-box corners of both geometries of resting pair `k`, as two arrays (8, 3). The
        corners of each geometry are in the frame of the other geometry.
        """
        a, b = (self._placed(int(i)) for i in self.pairs[k])
        return (a[1] - b[0][:3, 3]) @ b[0][:3, :3], (b[1] - a[0][:3, 3]) @ a[0][:3, :3]

    def _placed(self, i: int) -> tuple[Array, Array]:
        """Return the pose (4, 4) and the box corners (8, 3) of a geometry in resting contact, in the world
        frame.
        """
        geometry = self.exact.geometries[i]
        T = geometry.T_link_solid.matrix
        if geometry.link >= 0:
            T = self.exact.Ts[geometry.link] @ T
        solid = geometry.solid
        corners = solid.center + np.minimum(solid.half, LARGEST) * CORNERS
        return T, corners @ T[:3, :3].T + T[:3, 3]

    def _contact(self, k: int) -> Contact:
        return self.exact.contact_of(int(self.pairs[k, 0]), int(self.pairs[k, 1]))


def _between(points: Array, at: float) -> Array:
    i = min(int(at), len(points) - 2)
    return points[i] + (at - i) * (points[i + 1] - points[i])


def _from(points: Array, at: float) -> Array:
    """Cut a motion (k, n) at the position `at`, where bodies have left resting contact, and return the
    waypoints (m, n) of the remaining part.

    The position is counted in edges: 2.5 is the middle of the third edge.
    """
    i = min(int(at), len(points) - 2)
    return np.vstack([_between(points, at), points[i + 1 :]])


def _places(points: Array, at: float) -> Iterable[float]:
    """Yield positions along a motion that separates bodies in resting contact.
    The joint steps are at most `COARSE`.

    The positions begin at `at` and are counted in edges: 2.5 is the middle of the third edge.
    """
    i = min(int(at), len(points) - 2)
    for k in range(i, len(points) - 1):
        begin = at - k if k == i else 0.0
        length = float(np.max(np.abs(points[k + 1] - points[k]))) * (1.0 - begin)
        for t in np.linspace(begin, 1.0, max(int(np.ceil(length / COARSE)), 1), endpoint=False):
            yield k + float(t)
    yield float(len(points) - 1)


def _along(at: float, share: float, rest: Array, edges: int) -> float:
    """Convert a position on the rest of a motion, which begins where bodies have left resting contact, to the
    position on the whole motion. Both positions are fractions from 0 to 1.

    Args:
        at: position where the rest begins, counted in edges.
        share: fraction of the rest, from 0 to 1.
        rest: (m, n) waypoints of the rest.
        edges: number of edges of the whole motion.
    """
    i = min(int(at), edges - 1)
    k = share * (len(rest) - 1)  # position along `rest`, whose first edge is the remainder of edge i
    place = at + k * (i + 1 - at) if k < 1 else i + k
    return float(place / edges)
