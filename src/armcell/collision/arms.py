"""Two arms of one robot: what each moves, each without the other, and both on one clock.

That one arm keeps off the world and itself is proven when its motion is planned, in a scene "without" the
other arm. What is left to prove is that two motions, on one clock, keep the arms (and what they hold) apart.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import combinations, pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.collision.certify_timed import TimedCertificate
from armcell.collision.exact import ExactChecker
from armcell.collision.kernel.apart import first_not_apart
from armcell.collision.kernel.checker import KernelChecker
from armcell.core import Contact, InputError, JointTrajectory
from armcell.kinematics import kinematic_tree
from armcell.model import RobotModel
from armcell.scene import PlanningScene
from armcell.timing.chords import chords

Array = NDArray[np.float64]

CLEARANCE = 0.02  # [m] between the arms, where nothing else is said
ARM_JOINTS = 5  # of a group that is an arm; one with fewer is a hand, a finger, a lift
FINE = 0.01  # [rad] of a joint: the finest boxes of positions that `certify_any_time` looks at


@lru_cache(maxsize=64)
def moved_links(model: RobotModel, group: str) -> frozenset[str]:
    """Links that a group's joints move, what is mounted on them (a gripper's fingers) included."""
    tree, columns = kinematic_tree(model), set(model.columns(model.group(group).joint_names))
    return frozenset(
        name
        for name in model.links
        if any(int(tree.column[j]) in columns and tree.kind[j] != 0 for j in tree.path_to(name))
    )


@lru_cache(maxsize=64)
def _blind_model(model: RobotModel, links: frozenset[str]) -> RobotModel:
    """The model in which some links touch nothing."""
    pairs = {frozenset((a, b)): "Other arm" for a in links for b in model.links if a != b}
    return replace(model, disabled_collisions={**model.disabled_collisions, **pairs})


@lru_cache(maxsize=64)
def _between_model(model: RobotModel, a: frozenset[str], b: frozenset[str]) -> RobotModel:
    """The model in which only a link of one set and a link of the other can touch."""
    pairs = combinations(model.links, 2)
    never = {
        frozenset((p, q)): "One arm" for p, q in pairs if not ((p in a and q in b) or (p in b and q in a))
    }
    return replace(model, disabled_collisions={**model.disabled_collisions, **never})


@lru_cache(maxsize=64)
def arms_of(model: RobotModel, group: str) -> tuple[str, ...]:
    """The arms that a group is made of, by their groups: two or more that do not move each other, or none."""
    joints = set(model.group(group).joint_names)
    parts: dict[frozenset[str], str] = {}
    for name, part in model.groups.items():
        if len(part.joint_names) >= ARM_JOINTS and set(part.joint_names) < joints:
            parts.setdefault(frozenset(part.joint_names), name)
    largest = [name for own, name in parts.items() if not any(own < other for other in parts)]
    links = [moved_links(model, name) for name in largest]
    return tuple(largest) if len(links) > 1 and not any(a & b for a, b in combinations(links, 2)) else ()


def sides_of(scene: PlanningScene, groups: tuple[str, ...]) -> dict[str, int]:
    """By body that one of some arms moves (its links, what it holds), the number of the arm."""
    side = {link: k for k, g in enumerate(groups) for link in moved_links(scene.model, g)}
    return side | {name: side[body.link] for name, body in scene.attached.items() if body.link in side}


def nearest_between(exact: ExactChecker, sides: Mapping[str, int], q: ArrayLike) -> Contact | None:
    """The nearest pair of bodies of different sides at q, of those that may not touch."""
    side = np.array([sides.get(g.body, -1) for g in exact.geometries])
    pairs = exact.pairs[(side[exact.pairs] >= 0).all(axis=1) & (np.diff(side[exact.pairs]) != 0).ravel()]
    exact.place(q)
    best, nearest = np.inf, None
    gaps = exact.pair_gaps(pairs)
    for p in np.argsort(gaps, kind="stable"):
        if gaps[p] >= best:
            break
        distance = exact.pair_distance(int(pairs[p, 0]), int(pairs[p, 1]))
        if distance < best:
            best, nearest = distance, (int(pairs[p, 0]), int(pairs[p, 1]))
    return None if nearest is None else exact.contact_of(*nearest)


def check_two(model: RobotModel, groups: tuple[str, str]) -> None:
    """Raises InputError unless two groups have joints and share none."""
    names = [set(model.group(g).joint_names) for g in groups]
    if not all(names):
        raise InputError(f"group {groups[0] if not names[0] else groups[1]!r} has no joints")
    if shared := sorted(names[0] & names[1]):
        raise InputError(f"groups {groups[0]!r} and {groups[1]!r} share {shared[0]!r}: they are not two arms")


def without_arm(scene: PlanningScene, group: str) -> PlanningScene:
    """The scene for planning whatever moves beside an arm: the arm and what it holds are not in the way.

    The arm stands at its model's default, wherever it is, so that what was prepared for one plan serves
    the next.
    """
    links = moved_links(scene.model, group)
    model = _blind_model(scene.model, links)
    q, at = scene.positions.copy(), _columns_of(scene.model, links)
    q[at] = scene.model.default_positions()[at]
    held = {name for name, body in scene.attached.items() if body.link in links}
    attached = {n: b for n, b in scene.attached.items() if n not in held}
    allowed = {
        pair: yes
        for pair, yes in scene.allowed_pairs.items()
        if not pair & held and (yes or not pair & links)
    }
    return replace(scene, model=model, positions=q, attached=attached, allowed_pairs=allowed)


def _columns_of(model: RobotModel, links: frozenset[str]) -> list[int]:
    """Of all joints that carry one of some links."""
    names = [model.parent_joint[n].name for n in links if n in model.parent_joint]
    return [i for i, n in enumerate(model.joint_names) if n in set(names)]


@dataclass(frozen=True, eq=False)
class Arms:
    """Two groups of a scene's robot, with what they hold, and nothing else of the world.

    Positions `q` are those of the first group followed by those of the second. Fingers are taken as wide
    open: a little more than they need.
    """

    scene: PlanningScene
    groups: tuple[str, str]

    def __post_init__(self) -> None:
        check_two(self.scene.model, self.groups)

    @cached_property
    def joint_names(self) -> tuple[str, ...]:
        return tuple(n for g in self.groups for n in self.scene.model.group(g).joint_names)

    @cached_property
    def _bare(self) -> PlanningScene:
        scene, model = self.scene, self.scene.model
        a, b = (moved_links(model, g) for g in self.groups)
        q = model.default_positions()
        for gripper in model.grippers.values():
            q[model.columns((gripper.joint_name,))] = gripper.joint_position(gripper.max_width)
        side = sides_of(scene, self.groups)
        held = {name: side[name] for name in scene.attached if name in side}
        told = {pair: True for pair, yes in scene.allowed_pairs.items() if yes and pair <= set(side)}
        bare = replace(
            scene, model=_between_model(model, a, b), positions=np.clip(q, model.lower, model.upper),
            attached={n: scene.attached[n] for n in held}, objects={}, allowed_pairs=told,
            allowed_defaults={}, padding=0.0, link_padding={},
        )  # fmt: skip
        for name, mine in held.items():
            bare = bare.with_allowed(
                name, [n for n in (*model.links, *held) if n != name and side.get(n) in (None, mine)]
            )
        return bare

    @cached_property
    def checker(self) -> KernelChecker:
        return KernelChecker(self._bare, self.joint_names)

    @cached_property
    def exact(self) -> ExactChecker:
        """The slow judge of the same pairs: with coal, one configuration at a time."""
        return ExactChecker(self._bare, self.joint_names)

    def apart(self, points: ArrayLike, room: Array | None = None, clearance: float = 0.0) -> float:
        """Where on a piecewise linear motion (k, n) the arms come nearer than `clearance` [m], in edges.

        -1.0 where they are proven not to. `room` (n,) is how far each joint may be off the edges.
        """
        points = np.ascontiguousarray(points, dtype=np.float64)
        if len(points) == 1:
            points = np.vstack([points, points])
        room = np.zeros(points.shape[1]) if room is None else room
        return float(first_not_apart(self.checker.handle, points, room, float(clearance)))

    def first_near(self, points: ArrayLike, room: Array | None = None, clearance: float = 0.0) -> float:
        """As `apart`, but the first edge of all where they come too near."""
        points = np.ascontiguousarray(points, dtype=np.float64)
        found, at = -1.0, self.apart(points, room, clearance)
        while at >= 0:
            found = at
            if at < 1:
                break
            at = self.apart(points[: int(at) + 1], room, clearance)  # all edges before that one
        return found

    def contact(self, q: ArrayLike) -> Contact | None:
        """The nearest pair of bodies of the two arms at q."""
        return self.exact.nearest(q)

    def certify(
        self,
        first: JointTrajectory,
        second: JointTrajectory,
        starts: tuple[float, float] = (0.0, 0.0),
        clearance: float = 0.0,
        begin: float | None = None,
        until: float | None = None,
        evidence: bool = True,
    ) -> TimedCertificate:
        """Prove that two motions on one clock keep the arms apart; where not, the pair and the time.

        Each arm stands still before its motion and after it.

        Args:
            starts: when each begins [s of the common clock].
            clearance: distance to keep [m].
            begin, until: the time looked at, by default from the earlier start to the later end.
            evidence: where the proof fails, find the first time of all and the pair (that takes
                milliseconds); else the time is that of any place where it fails.
        Raises:
            InputError: a trajectory of other joints, without velocities, or not at rest at its ends.
        """
        for trajectory, group in zip((first, second), self.groups, strict=True):
            names = self.scene.model.group(group).joint_names
            if trajectory.joint_names != names:
                raise InputError(f"the trajectory's joints are not those of group {group!r}, in its order")
        ends = [s + t.duration for s, t in zip(starts, (first, second), strict=True)]
        begin = min(starts) if begin is None else begin
        until = max(ends) if until is None else until
        times, points, room = chords((first, second), starts, begin, max(until, begin))
        at = (self.first_near if evidence else self.apart)(points, room, clearance)
        if at < 0:
            return TimedCertificate(True)
        i = min(int(at), len(points) - 2)
        time = float(times[i] + (at - i) * (times[i + 1] - times[i]))
        q = points[i] + (at - i) * (points[i + 1] - points[i])
        return TimedCertificate(False, time, self.contact(q) if evidence else None)

    def certify_any_time(
        self, first: JointTrajectory, second: JointTrajectory, clearance: float = 0.0
    ) -> bool:
        """Prove that the arms keep apart whenever each of two motions is made, and at whatever pace.

        Every position of the one is proven against every position of the other: of the second motion, boxes
        of joint positions are held against the whole of the first, and halved where they are too large.
        """
        _, a, room_a = chords((first,), (0.0,), 0.0, first.duration)
        _, b, room_b = chords((second,), (0.0,), 0.0, second.duration)
        return self.apart_at_any_pace(a, room_a, b, room_b, clearance)

    def apart_at_any_pace(self, a: Array, room_a: Array, b: Array, room_b: Array, clearance: float) -> bool:
        """`certify_any_time` for piecewise linear motions (k, n); `room` (n,): how far off."""
        waiting = [(0, len(b) - 1)]
        while waiting:
            i, j = waiting.pop()
            low, high = b[i : j + 1].min(axis=0), b[i : j + 1].max(axis=0)
            if j - i <= 1 and (halves := self._halves(b[i], b[j])) is not None:
                # One edge that is long: in parts of its own.
                parts = [(0.5 * (p + q), 0.5 * np.abs(q - p)) for p, q in halves]
                if not all(self._apart_from(a, room_a, m, r + room_b, clearance) for m, r in parts):
                    return False
                continue
            if self._apart_from(a, room_a, 0.5 * (low + high), 0.5 * (high - low) + room_b, clearance):
                continue
            if j - i <= 1:
                return False
            middle = (i + j) // 2
            waiting += [(i, middle), (middle, j)]
        return True

    @staticmethod
    def _halves(p: Array, q: Array) -> list[tuple[Array, Array]] | None:
        count = int(np.ceil(np.abs(q - p).max() / FINE))
        if count <= 1:
            return None
        at = [p + (q - p) * k / count for k in range(count + 1)]
        return list(pairwise(at))

    def _apart_from(self, a: Array, room_a: Array, q: Array, room: Array, clearance: float) -> bool:
        points = np.hstack([a, np.tile(q, (len(a), 1))])
        return self.apart(points, np.concatenate([room_a, room]), clearance) < 0


def merged(first: JointTrajectory, second: JointTrajectory) -> JointTrajectory:
    """Two motions of different joints that begin together as one; the shorter stands still at its end."""
    times = np.union1d(first.times, second.times)
    times = times[np.concatenate([[True], np.diff(times) > 1e-9])]
    if times[-1] < max(first.duration, second.duration):
        times[-1] = max(first.duration, second.duration)
    q, v, a = map(np.hstack, zip(first.samples(times), second.samples(times), strict=True))
    return JointTrajectory(first.joint_names + second.joint_names, times, q, v, a)
