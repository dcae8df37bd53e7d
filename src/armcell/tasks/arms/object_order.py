"""Search for the order of objects per arm with which several arms finish early; estimates of tour times.

With this order, the arms rarely wait for each other.

The estimate assumes straight joint-space motions: from above the nearest grasp of an object to the hand's
pose above the object's zone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from itertools import chain, combinations, permutations, product
from math import factorial, prod
from operator import itemgetter

import numpy as np
from numpy.typing import NDArray

from armcell.collision.inter_arm_checker import CLEARANCE, InterArmChecker, check_arms
from armcell.core import SE3, InputError
from armcell.core.checks import require
from armcell.grasping import grasp_candidates, hand_of, place_candidates
from armcell.scene import PlanningScene
from armcell.tasks.settings import TaskSettings
from armcell.tasks.stages.grasp import ReachEstimator

F64 = NDArray[np.float64]
Order = tuple[str, ...]
Span = tuple[float, float, float]  # start of a segment, end of its motion, end of its work [s]
EXHAUSTIVE = 4  # objects per arm up to which all orders are compared,
ALL_ORDERS = 600  # if all arms together have at most this many
DETOUR = 1.2  # [s] lost by a detour around another arm: mean of ten in batches of dual_ur10_sort
SLACK = 0.5  # [s] uncertainty of an estimated time
SAMPLES = 16  # per motion
DECIMALS = 3  # [rad] positions that agree to these decimals share a cache entry


@dataclass(frozen=True)
class CycleTimes:
    """Estimated times for grasping and for placing one object. The cost of an object order adds them to the
    travel times of the arm.

    The defaults are means of 64 picks and 64 placements of two UR10 at a task's default speeds.
    """

    fetch: float = 3.4  # [s] to open, approach, close and lift
    put: float = 3.0  # [s] to lower, open and retreat

    def __post_init__(self) -> None:
        for name in ("fetch", "put"):
            require(getattr(self, name) >= 0, f"{name} is {getattr(self, name):g}, it must not be negative")


@dataclass(frozen=True, eq=False)
class TourSegment:
    """Segment of the tour in which an arm handles its objects in a given order: one motion between two joint
    positions (n,), followed by work at its end.
    """

    motion: float  # [s]
    work: float = 0.0  # [s]
    zone: str = ""  # reserved from the start of the motion to the end of the work
    motion_ends: tuple[F64, F64] | None = None


class TourEstimator:
    """Estimator for the cost of a tour: the time in which an arm carries
    objects to their destinations in a given order and returns.

    Unreachable objects contribute no travel time.

    Args:
        zone: the destination object of each object.
    Raises:
        UnknownNameError: no such object.
    """

    def __init__(
        self,
        scene: PlanningScene,
        group: str,
        zone: Mapping[str, str],
        settings: TaskSettings,
        cycle_times: CycleTimes,
    ):
        self.scene, self.zone, self.settings, self.cycle_times = scene, zone, settings, cycle_times
        gripper = scene.model.gripper(arm_group=group)
        self._reaching = ReachEstimator(scene, gripper, settings.approach_distance)
        self._start = scene.positions[self._reaching.ik.columns]
        hand = hand_of(scene.model, gripper)
        candidates = partial(grasp_candidates, pose_error=settings.pose_error)
        self._grasps = {item: candidates(scene.object(item), hand)[0] for item in zone}
        self._placed = {item: self._on_zone(item) for item in zone}
        self._until = cache(self._fetched)  # orders with a common prefix share its segments

    def __call__(self, order: tuple[str, ...]) -> tuple[TourSegment, ...]:
        segments, q = self._until(order)
        seconds = self._reaching.seconds(q, self._start, self.settings.free)
        return (*segments, TourSegment(seconds, motion_ends=(q, self._start)))

    def _fetched(self, order: tuple[str, ...]) -> tuple[tuple[TourSegment, ...], F64]:
        """Return the tour segments in which an arm carries objects to their destinations in `order`, and the
        joint positions (n,) after the last segment. The return motion is not included.
        """
        if not order:
            return (), self._start
        (before, q), item, s = self._until(order[:-1]), order[-1], self.settings
        fetch, put, zone = self.cycle_times.fetch, self.cycle_times.put, self.zone[item]
        found = self._motions(item, q)
        if found is None:
            return (*before, TourSegment(0.0, fetch), TourSegment(0.0, put, zone)), q
        seconds, over, there = found
        bring = self._reaching.seconds(over, there, s.carry)
        return (
            *before,
            TourSegment(seconds, fetch, motion_ends=(q, over)),
            TourSegment(bring, put, zone, (over, there)),
        ), there

    def _motions(self, item: str, q: F64) -> tuple[float, F64, F64] | None:
        """Estimate, to compare object orders, the motions with which an arm carries one object. Return the
        time [s] to reach the object, and the joint positions (n,) above the object and above its destination.
        """
        s, pose = self.settings, self.scene.object(item).T_world_object
        near = self._reaching.nearest_first(pose, self._grasps[item], q, s.free)
        if not near or near[0].q is None:
            return None
        above = (self._placed[item] @ near[0].grasp.T_object_tcp).shifted(0.0, 0.0, s.lower_distance)
        there = self._reaching.ik_near(above, near[0].q)
        return None if there is None else (near[0].seconds, near[0].q, there)

    def _on_zone(self, item: str) -> SE3:
        """Predict the world pose of an object after an arm has placed it in its zone. The comparison of
        object orders needs this pose.
        """
        body, zone = self.scene.object(item), self.scene.object(self.zone[item])
        try:
            return place_candidates(body, zone)[0].T_world_object
        except InputError:  # for example a box with walls: keep the present rotation
            return SE3(body.T_world_object.rotation, zone.T_world_object.translation)


Tour = tuple[TourSegment, ...]


def orders(
    scene: PlanningScene,
    streams: Mapping[str, Sequence[str]],
    to: Callable[[str], str],
    settings: TaskSettings = TaskSettings(),
    cycle_times: CycleTimes = CycleTimes(),
) -> dict[str, list[str]]:
    """Estimate the order in which several arms should take their objects,
    so that all arms finish their work and return as early as possible.

    With up to four objects for each of two arms, or three for each of three, all orders are compared;
    otherwise a local search exchanges two objects or reverses an order. The given order wins ties.

    Args:
        streams: the objects of each arm, by planning group.
        to: the destination of an object: a zone that only one arm at a time may reserve.
        settings: speeds and distances of the following picks and placements.
        cycle_times: durations of grasping and placing.
    Raises:
        InputError: fewer than two arms, arms with common joints, or an object is named twice.
        UnknownNameError: no such group or object.
    """
    groups = tuple(streams)
    check_arms(scene.model, groups, "stream")
    named = [item for stream in streams.values() for item in stream]
    twice = sorted({item for item in named if named.count(item) > 1})
    if twice:
        raise InputError(f"{', '.join(twice)} given twice", hint="name each object once, for one arm")
    tours = [
        TourEstimator(scene, group, {item: to(item) for item in stream}, settings, cycle_times)
        for group, stream in streams.items()
    ]
    best = best_order(tuple(streams.values()), tours, ConflictCache(scene, groups))
    return {group: list(order) for group, order in zip(groups, best, strict=True)}


def best_order(
    streams: Sequence[Sequence[str]],
    tours: Sequence[Callable[[Order], Tour]],
    conflicts: ConflictCache | None = None,
) -> tuple[Order, ...]:
    """Return, for each arm, the sequence in which the arm should take its objects so that all arms finish as
    early as possible.

    Args:
        tours: for each arm, computes its tour for an order.
        conflicts: cache of the conflicts of an arm's motions with another arm at work; None: no conflicts.
    """
    tours = [cache(tour) for tour in tours]

    def finish(every: tuple[Order, ...], conflicts: ConflictCache | None = None) -> tuple[float, float]:
        segments = [tour(order) for tour, order in zip(tours, every, strict=True)]
        tables = timetable(segments)
        lost = [0.0] * len(tours) if conflicts is None else detours(segments, tables, conflicts)
        ends = [(spans[-1][2] if spans else 0.0) + more for spans, more in zip(tables, lost, strict=True)]
        return round(max(ends), 6), round(sum(ends), 6)

    best = tuple(tuple(stream) for stream in streams)
    least = finish(best, conflicts)
    while True:
        found = best
        for undisturbed, every in sorted(((finish(e), e) for e in _near(best)), key=itemgetter(0)):
            if undisturbed >= least:
                break  # detours only add time, so no later one is better
            if (ends := finish(every, conflicts)) < least:
                found, least = every, ends
        if found == best:
            return best
        best = found


def _near(every: tuple[Order, ...]) -> Iterable[tuple[Order, ...]]:
    """Yield the next candidates in the local search for the best object order. A candidate has one sequence
    of objects for each arm.

    These are all orders if there are few, else those that differ by one change.
    """
    lengths = [len(order) for order in every]
    if max(lengths) <= EXHAUSTIVE and prod(map(factorial, lengths)) <= ALL_ORDERS:
        return product(*map(permutations, every))
    return chain.from_iterable(
        ((*every[:k], changed, *every[k + 1 :]) for changed in _changed(order))
        for k, order in enumerate(every)
    )


def _changed(order: Order) -> Iterator[Order]:
    yield order
    yield order[::-1]
    for i, k in combinations(range(len(order)), 2):
        yield (*order[:i], order[k], *order[i + 1 : k], order[i], *order[k + 1 :])


def timetable(arms: Sequence[Tour]) -> list[list[Span]]:
    """Compute for given object orders when each arm executes each segment of its tour, if only one arm at a
    time may reserve a zone.

    An arm waits at the start of a segment until its zone is free. The arm that requests a zone first gets it.

    Returns:
        For each arm and segment: the start, the end of the motion, and the end of the work [s].
    """
    now, free = [0.0] * len(arms), dict[str, float]()
    spans: list[list[Span]] = [[] for _ in arms]
    while True:
        asks = [(now[k], k) for k, segments in enumerate(arms) if len(spans[k]) < len(segments)]
        if not asks:
            return spans
        time, k = min(asks)
        segment = arms[k][len(spans[k])]
        begin = max(time, free.get(segment.zone, 0.0)) if segment.zone else time
        there = begin + segment.motion
        now[k] = there + segment.work
        if segment.zone:
            free[segment.zone] = now[k]
        spans[k].append((begin, there, now[k]))


def detours(arms: Sequence[Tour], tables: Sequence[Sequence[Span]], conflicts: ConflictCache) -> list[float]:
    """Return how much time [s] each arm loses through detours around other working arms,
    for a given order of objects.
    """
    lost = [0.0] * len(arms)
    for k, j in permutations(range(len(arms)), 2):
        for segment, (begin, there, _) in zip(arms[k], tables[k], strict=True):
            for other, (_, since, until) in zip(arms[j], tables[j], strict=True):
                if other.work == 0.0 or since > there + SLACK or until < begin - SLACK:
                    continue
                if segment.zone and segment.zone == other.zone:
                    continue  # they take turns
                share = conflicts.conflict_section(k, segment, j, other)
                if share is None:
                    continue
                first, last = (begin + s * segment.motion for s in share)
                if first < until + SLACK and last > since - SLACK:
                    lost[k] += DETOUR
    return lost


class ConflictCache:
    """Cache used to compare object orders of several arms. It stores the section of one arm's motion in which
    the arm comes too close to another arm at work.
    """

    def __init__(self, scene: PlanningScene, groups: tuple[str, ...]):
        pairs = combinations(range(len(groups)), 2)
        self._pairs = {(i, k): InterArmChecker(scene, (groups[i], groups[k])) for i, k in pairs}
        self._known: dict[tuple[int, int, bytes], tuple[float, float] | None] = {}

    def conflict_section(
        self, arm: int, segment: TourSegment, other_arm: int, other: TourSegment
    ) -> tuple[float, float] | None:
        """Return in which section of its motion an arm comes too close to another arm that is working, to
        compare object orders. Return None if the arms keep their clearance or one of the motions is unknown.

        The section is a pair of fractions (0..1) of the motion. `detours` tests whether the arm passes this
        section while the other arm works.

        Args:
            arm: index of the moving arm.
            segment: tour segment with the motion.
            other_arm: index of the working arm.
            other: tour segment of the other arm, which works at the end of its motion.
        """
        if segment.motion_ends is None or other.motion_ends is None:
            return None
        working = other.motion_ends[1]
        key = arm, other_arm, np.round(np.concatenate([*segment.motion_ends, working]), DECIMALS).tobytes()
        if key not in self._known:
            self._known[key] = self._near(arm, other_arm, segment.motion_ends, working)
        return self._known[key]

    def _near(
        self, arm: int, other_arm: int, ends: tuple[F64, F64], working: F64
    ) -> tuple[float, float] | None:
        arms = self._pairs[min(arm, other_arm), max(arm, other_arm)]
        share = np.linspace(0.0, 1.0, SAMPLES)[:, None]
        moving, resting = ends[0] + share * (ends[1] - ends[0]), np.tile(working, (SAMPLES, 1))
        points = np.hstack([moving, resting] if arm < other_arm else [resting, moving])
        first = arms.first_too_close(points, clearance=CLEARANCE)
        if first < 0:
            return None
        edges = SAMPLES - 1
        last = edges - int(arms.first_too_close(points[::-1], clearance=CLEARANCE))
        return int(first) / edges, last / edges
