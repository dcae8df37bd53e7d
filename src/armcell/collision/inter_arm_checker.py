"""Collision checks between the arms of one robot: scenes without other arms, clearance of motions.

When the motion of one arm is planned, a scene "without" the other arms serves to certify it against the world
and the arm itself. This module certifies the rest: the motions of several arms on one clock keep the arms and
their held objects apart.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import combinations, pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.collision.certify_timed import TimedCertificate
from armcell.collision.exact_checker import ExactChecker
from armcell.collision.kernel.checker import KernelChecker
from armcell.collision.kernel.motion import first_below_clearance
from armcell.collision.view_cone import links_in_hull
from armcell.core import Contact, InputError, JointTrajectory
from armcell.kinematics import kinematic_tree
from armcell.model import RobotModel
from armcell.scene import PlanningScene
from armcell.timing.chords import chords

Array = NDArray[np.float64]

CLEARANCE = 0.02  # [m] default clearance between the arms
ARM_JOINTS = 5  # smallest number of joints of an arm's group; a smaller group is a hand, a finger, or a lift
FINE = 0.01  # [rad] smallest boxes of joint positions in `certify_any_time`


@lru_cache(maxsize=64)
def moved_links(model: RobotModel, group: str) -> frozenset[str]:
    """Return all links that move with the joints of an arm, including links that are mounted on the arm, for
    checks between arms.
    """
    return links_of_joints(model, model.group(group).joint_names)


def arms_in_hull(scene: PlanningScene, corners: NDArray[np.float64], arms: Iterable[str]) -> list[str]:
    """Return which of the given arms reach into the convex hull of some points, such as a camera's view.

    Args:
        corners: (k, 3) points [m, world frame].
    """
    moved = {arm: moved_links(scene.model, arm) for arm in arms}
    others = set(scene.model.links).difference(*moved.values())
    inside = links_in_hull(scene, corners, others).keys()
    return [arm for arm in moved if moved[arm] & inside]


@lru_cache(maxsize=64)
def links_of_joints(model: RobotModel, joint_names: tuple[str, ...]) -> frozenset[str]:
    """Return all links that move with joints of a robot, for checks between arms."""
    tree, columns = kinematic_tree(model), set(model.columns(joint_names))
    return frozenset(
        name
        for name in model.links
        if any(int(tree.column[j]) in columns and tree.kind[j] != 0 for j in tree.path_to(name))
    )


@lru_cache(maxsize=64)
def _blind_model(model: RobotModel, links: frozenset[str]) -> RobotModel:
    """Return a copy of the robot model for the inter-arm checker, in which the links of some arms are not
    checked for collisions with any other link.
    """
    pairs = {frozenset((a, b)): "Other arm" for a in links for b in model.links if a != b}
    return replace(model, disabled_collisions={**model.disabled_collisions, **pairs})


@lru_cache(maxsize=64)
def _between_model(model: RobotModel, groups: tuple[str, ...], mover: str | None) -> RobotModel:
    """Return a copy of the robot model for the inter-arm checker, in which only collisions between different
    arms are checked.

    Args:
        mover: check only the collisions of this arm's links with those of the other arms; None: every arm.
    """
    side = {link: k for k, g in enumerate(groups) for link in moved_links(model, g)}
    focus = None if mover is None else groups.index(mover)
    pairs = combinations(model.links, 2)
    never = {
        frozenset((p, q)): "One arm" for p, q in pairs if not _are_tested(side.get(p), side.get(q), focus)
    }
    return replace(model, disabled_collisions={**model.disabled_collisions, **never})


def _are_tested(a: int | None, b: int | None, focus: int | None) -> bool:
    """Return whether the inter-arm checker tests a body of arm `a` against a body of arm `b`. An index of
    None means that the body belongs to no arm.

    Args:
        focus: index of the only arm that is checked against the others; None: every pair of arms is checked.
    """
    return a is not None and b is not None and a != b and (focus is None or focus in (a, b))


@lru_cache(maxsize=64)
def arms_of(model: RobotModel, group: str) -> tuple[str, ...]:
    """Return the groups of the single arms in a planning group, to check these arms against each other. The
    result is empty if the group is a single arm.

    The result has two or more groups, and no arm moves a link of another. A group of several arms is never
    part of the result, only its arms are.
    """
    joints = set(model.group(group).joint_names)
    parts: dict[frozenset[str], str] = {}
    for name, part in model.groups.items():
        if len(part.joint_names) < ARM_JOINTS or not set(part.joint_names) < joints:
            continue
        if not arms_of(model, name):
            parts.setdefault(frozenset(part.joint_names), name)
    largest = [name for own, name in parts.items() if not any(own < other for other in parts)]
    links = [moved_links(model, name) for name in largest]
    return tuple(largest) if len(links) > 1 and not any(a & b for a, b in combinations(links, 2)) else ()


def sides_of(scene: PlanningScene, groups: tuple[str, ...]) -> dict[str, int]:
    """Return a mapping from each body (link or held object) to the arm that moves it, for collision checks
    between arms.

    Args:
        groups: the arms' groups; the result maps a body's name to an index of this tuple.
    """
    side = {link: k for k, g in enumerate(groups) for link in moved_links(scene.model, g)}
    return side | {name: side[body.link] for name, body in scene.attached.items() if body.link in side}


def nearest_between(exact: ExactChecker, sides: Mapping[str, int], q: ArrayLike) -> Contact | None:
    """Return the closest pair of bodies that belong to different arms (inter-arm distance) at the robot
    configuration q (n,).

    Pairs whose contact the scene allows are ignored.

    Args:
        exact: the exact checker.
        sides: side of each body by name; other bodies are ignored.
        q: (n,) configuration.
    """
    side = np.array([sides.get(g.body, -1) for g in exact.geometries])
    pairs = exact.pairs[(side[exact.pairs] >= 0).all(axis=1) & (np.diff(side[exact.pairs]) != 0).ravel()]
    exact.set_configuration(q)
    best, nearest = np.inf, None
    gaps = exact.pair_gaps(pairs)
    for p in np.argsort(gaps, kind="stable"):
        if gaps[p] >= best:
            break
        distance = exact.pair_distance(int(pairs[p, 0]), int(pairs[p, 1]))
        if distance < best:
            best, nearest = distance, (int(pairs[p, 0]), int(pairs[p, 1]))
    return None if nearest is None else exact.contact_of(*nearest)


def check_arms(model: RobotModel, groups: Sequence[str], what: str = "group") -> None:
    """Check that planning groups belong to different arms, so that an inter-arm check is possible: at least
    two groups, each with joints, and no shared joint.

    Args:
        what: what the caller was given for each arm, for the message.
    Raises:
        InputError: they are not the groups of different arms.
    """
    if len(groups) < 2:
        raise InputError(f"{len(groups)} {what}{'s' * (not groups)} given, at least two arms need one each")
    joints = {g: set(model.group(g).joint_names) for g in groups}
    if empty := [g for g in groups if not joints[g]]:
        raise InputError(f"group {empty[0]!r} has no joints")
    for a, b in combinations(groups, 2):
        if shared := sorted(joints[a] & joints[b]):
            raise InputError(f"groups {a!r} and {b!r} share {shared[0]!r}: they are not different arms")


def combined_group(model: RobotModel, groups: Iterable[str]) -> str:
    """Return the name of the planning group that combines exactly the joints of several arms, in order to
    check the arms against each other.

    Raises:
        InputError: the model has no such group.
        UnknownNameError: no such group.
    """
    groups = tuple(groups)
    wanted = {n for group in groups for n in model.group(group).joint_names}
    for group in model.groups.values():
        if set(group.joint_names) == wanted:
            return group.name
    raise InputError(
        f"no planning group has the joints of {' and '.join(map(repr, groups))}",
        hint="add one under 'groups' in robot.yaml",
    )


def without_arms(scene: PlanningScene, *groups: str) -> PlanningScene:
    """Return the scene without some arms and their held objects, to check one arm without the collisions
    between arms.

    The arms are placed at their model's default state, so that cached data of one plan can be reused for the
    next, wherever the arms are.
    """
    links = frozenset[str]().union(*(moved_links(scene.model, group) for group in groups))
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
    """Return the column indices of the joints that move the given links. These links belong to arms that are
    left out of a collision check.
    """
    names = [model.parent_joint[n].name for n in links if n in model.parent_joint]
    return [i for i, n in enumerate(model.joint_names) if n in set(names)]


@dataclass(frozen=True, eq=False)
class InterArmChecker:
    """Inter-arm collision checker, which tests the arms of a robot and the objects they hold against each
    other, but not against the world.

    Positions `q` are those of the first group followed by those of the others. The gripper fingers are
    assumed fully open, which is conservative.

    Attributes:
        groups: two or more arms.
        mover: test only this arm against all others; None: test every pair of arms.
    """

    scene: PlanningScene
    groups: tuple[str, ...]
    mover: str | None = None

    def __post_init__(self) -> None:
        check_arms(self.scene.model, self.groups)

    @cached_property
    def joint_names(self) -> tuple[str, ...]:
        return tuple(n for g in self.groups for n in self.scene.model.group(g).joint_names)

    @cached_property
    def _bare(self) -> PlanningScene:
        scene, model = self.scene, self.scene.model
        q = model.default_positions()
        for gripper in model.grippers.values():
            q[model.columns(gripper.joint_names)] = gripper.joint_position(gripper.max_width)
        side = sides_of(scene, self.groups)
        held = {name: side[name] for name in scene.attached if name in side}
        inner_pairs = {pair: True for pair, yes in scene.allowed_pairs.items() if yes and pair <= set(side)}
        bare = replace(
            scene, model=_between_model(model, self.groups, self.mover),
            positions=np.clip(q, model.lower, model.upper),
            attached={n: scene.attached[n] for n in held}, objects={}, allowed_pairs=inner_pairs,
            allowed_defaults={}, padding=0.0, link_padding={},
        )  # fmt: skip
        focus = None if self.mover is None else self.groups.index(self.mover)
        for name, mine in held.items():
            others = [n for n in (*model.links, *held) if n != name]
            bare = bare.with_allowed(name, [n for n in others if not _are_tested(mine, side.get(n), focus)])
        return bare

    @cached_property
    def checker(self) -> KernelChecker:
        return KernelChecker(self._bare, self.joint_names)

    @cached_property
    def exact(self) -> ExactChecker:
        """Return the slow inter-arm checker for single configurations, which tests body pairs of different
        arms exactly.
        """
        return ExactChecker(self._bare, self.joint_names)

    def find_too_close(self, points: ArrayLike, room: Array | None = None, clearance: float = 0.0) -> float:
        """Return a position along a motion at which the inter-arm checker finds arms closer than `clearance`,
        or -1.0 if there is none.

        The position is counted in edges: 2.5 is the middle of the third edge. -1.0 is a certificate for the
        whole motion.

        Args:
            points: (k, n) waypoints of a piecewise linear motion of all arms.
            room: (n,) largest deviation of each joint from the straight edges [rad or m].
            clearance: distance to keep [m].
        """
        points = np.ascontiguousarray(points, dtype=np.float64)
        if len(points) == 1:
            points = np.vstack([points, points])
        room = np.zeros(points.shape[1]) if room is None else room
        return float(first_below_clearance(self.checker.handle, points, room, float(clearance)))

    def first_too_close(self, points: ArrayLike, room: Array | None = None, clearance: float = 0.0) -> float:
        """Return the first position along a motion at which the inter-arm checker finds arms closer than
        `clearance`, or -1.0 if there is none.

        Like `find_too_close`, but the position is on the first edge where the arms are too close.
        """
        points = np.ascontiguousarray(points, dtype=np.float64)
        found, at = -1.0, self.find_too_close(points, room, clearance)
        while at >= 0:
            found = at
            if at < 1:
                break
            at = self.find_too_close(points[: int(at) + 1], room, clearance)  # all edges before this edge
        return found

    def contact(self, q: ArrayLike) -> Contact | None:
        """Return the two bodies of different arms that are nearest to each other at configuration q (n,)
        (inter-arm pair).
        """
        return self.exact.nearest(q)

    def certify(
        self,
        *motions: JointTrajectory,
        starts: tuple[float, ...] = (),
        clearance: float = 0.0,
        begin: float | None = None,
        until: float | None = None,
        evidence: bool = True,
    ) -> TimedCertificate:
        """Certify with the inter-arm checker that arms stay apart while their motions run on a common clock.
        Otherwise return the bodies that touch and the time.

        Each arm stays still before and after its motion.

        Args:
            motions: the motion of each arm, in the order of the groups.
            starts: start time of each motion [s, common clock]; by default, all start at 0.
            clearance: distance to keep [m].
            begin, until: time interval to certify; by default from the earlier start to the later end.
            evidence: if the certification fails, find the pair and the first time (takes milliseconds);
                otherwise the certificate reports any time at which it fails.
        Raises:
            InputError: a trajectory has other joints, has no velocities, or is not at rest at its ends.
        """
        starts = starts or (0.0,) * len(motions)
        for trajectory, group in zip(motions, self.groups, strict=True):
            names = self.scene.model.group(group).joint_names
            if trajectory.joint_names != names:
                raise InputError(f"the trajectory's joints are not those of group {group!r}, in its order")
        ends = [s + t.duration for s, t in zip(starts, motions, strict=True)]
        begin = min(starts) if begin is None else begin
        until = max(ends) if until is None else until
        times, points, room = chords(motions, starts, begin, max(until, begin))
        at = (self.first_too_close if evidence else self.find_too_close)(points, room, clearance)
        if at < 0:
            return TimedCertificate(True)
        i = min(int(at), len(points) - 2)
        time = float(times[i] + (at - i) * (times[i + 1] - times[i]))
        q = points[i] + (at - i) * (points[i + 1] - points[i])
        return TimedCertificate(False, time, self.contact(q) if evidence else None)

    def certify_any_time(
        self, first: JointTrajectory, second: JointTrajectory, clearance: float = 0.0
    ) -> bool:
        """Certify with the inter-arm checker that two arms stay apart for all start times and speeds of their
        motions. For more arms, certify each pair.

        The function tests every position of one motion against every position of the other: it tests boxes of
        joint positions of the second motion against the whole first motion, and splits boxes that are too
        large.

        Args:
            first: motion of the first arm.
            second: motion of the second arm.
            clearance: distance to keep [m].
        """
        _, a, room_a = chords((first,), (0.0,), 0.0, first.duration)
        _, b, room_b = chords((second,), (0.0,), 0.0, second.duration)
        return self.keeps_clearance_at_any_pace(a, room_a, b, room_b, clearance)

    def keeps_clearance_at_any_pace(
        self, a: Array, room_a: Array, b: Array, room_b: Array, clearance: float
    ) -> bool:
        """Certify with the inter-arm checker that two arms stay apart on piecewise linear motions, whatever
        the relative timing of the motions.

        Args:
            a, b: (k, n) waypoints of the first and of the second arm.
            room_a, room_b: (n,) largest deviation of each joint from the straight edges [rad or m].
            clearance: distance to keep [m].
        """
        waiting = [(0, len(b) - 1)]
        while waiting:
            i, j = waiting.pop()
            low, high = b[i : j + 1].min(axis=0), b[i : j + 1].max(axis=0)
            if j - i <= 1 and (halves := self._halves(b[i], b[j])) is not None:
                # Split a long edge into parts.
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
        return self.find_too_close(points, np.concatenate([room_a, room]), clearance) < 0
