"""Certification of timed motions against a measured, displaced scene and other running motions.

If a motion is not certified collision-free, the result is its first contact with the time. The motion
gate (`execution/motion_gate.py`) certifies every motion at its start and again when the scene changes.
An upper bound of how far the scene's bodies are displaced from the planned scene decides which proofs
remain valid.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.collision.certify import Certificate
from armcell.collision.inter_arm_checker import ARM_JOINTS, InterArmChecker
from armcell.collision.kernel.checker import KernelChecker
from armcell.collision.resting_contact import certify_from_rest
from armcell.core import SE3, Contact, JointTrajectory, Shape
from armcell.core.checks import require
from armcell.core.geometry import local_bounds
from armcell.kinematics import kinematic_tree
from armcell.model import RobotModel
from armcell.scene import PlanningScene
from armcell.timing.chords import acceleration_bounds, positions_at

F64 = NDArray[np.float64]
Solids = tuple[tuple[Shape, SE3], ...]
ERRORS = (5e-4, 5e-5)
"""[rad or m] Approximate largest deviations of a joint from the piecewise linear path to certify, in order of
use: the finer path is used only if the coarse path cannot be certified."""
DISPLACED = 4e-3
"""[m] Largest displacement of bodies from the planned scene for which a motion is certified in the planned
scene; smaller than the padding of planners."""
LONGEST = 0.05  # [s] longest piece of the path, so also the precision of the reported contact time
SAMPLES = 0.01  # [s] time between the samples among which `elapsed_at` searches the nearest state
SAME = 2e-3  # [rad or m] samples that exceed the smallest distance by at most this count as equally near


def displacement(planned: PlanningScene, scene: PlanningScene, joint_names: Iterable[str]) -> float:
    """Return an upper bound [m] on how much closer two bodies can be than at planning time, because objects
    or joints have been displaced. A motion proof can remain valid despite small displacements.

    The result is an upper bound: a motion that keeps this distance from everything in the planned scene is
    collision-free in the other scene.

    Args:
        planned: the scene in which the motion was planned.
        scene: the current scene.
        joint_names: joints that the motion moves; their positions have no effect.
    Returns:
        Infinity if the planned scene has a different robot, lacks an object, or allows a contact that the
        other scene does not allow.
    """
    if planned.model is not scene.model or planned.link_scale or scene.link_scale:
        return math.inf
    if planned.attached.keys() != scene.attached.keys() or not planned.objects.keys() >= scene.objects.keys():
        return math.inf
    if not all(scene.is_allowed(*pair) for pair, yes in planned.allowed.items() if yes) or any(
        planned.is_allowed(*pair) for pair, yes in scene.allowed.items() if not yes
    ):
        return math.inf
    links = _links_moved(planned, scene, joint_names)
    robot = [float(links.max(initial=0.0))] * 2  # [m] displacements of two links, then of each held object
    objects = 0.0
    index = kinematic_tree(scene.model).link_index
    for name, held in scene.attached.items():
        known = planned.attached[name]
        if known.link != held.link or known.touch_links != held.touch_links:
            return math.inf
        if known.object.shapes is not held.object.shapes:
            return math.inf
        own = _moved(known.T_link_object, held.T_link_object, held.object.shapes)
        robot.append(own + float(links[index[held.link]]))
    for name, item in scene.objects.items():
        known = planned.objects[name]
        if known is item:
            continue
        if known.shapes is not item.shapes:
            return math.inf
        objects = max(objects, _moved(known.T_world_object, item.T_world_object, item.shapes))
    second, first = sorted(robot)[-2:]
    return first + max(second, objects)


def _links_moved(planned: PlanningScene, scene: PlanningScene, joint_names: Iterable[str]) -> F64:
    """For a motion proof, return upper bounds (links,) [m] on how far joints outside the motion have
    displaced each link since planning.
    """
    model = scene.model
    q, columns = planned.positions.copy(), model.columns(joint_names)
    q[columns] = scene.positions[columns]
    radius = _link_radii(model)
    if np.array_equal(q, scene.positions):
        return np.zeros(len(radius))
    tree = kinematic_tree(model)
    off = tree.link_transforms(q) - tree.link_transforms(scene.positions)
    return np.linalg.norm(off[:, :3, :3], axis=(1, 2)) * radius + np.linalg.norm(off[:, :3, 3], axis=1)


def _moved(before: SE3, now: SE3, shapes: Solids) -> float:
    """Return an upper bound [m] on the displacement of any point of an object from its planned to its present
    pose. A motion proof tolerates small displacements.
    """
    if before is now:
        return 0.0
    turned = (now.rotation.matrix - before.rotation.matrix).ravel().tolist()
    shift = math.dist(now.translation.tolist(), before.translation.tolist())
    return math.hypot(*turned) * _radius(shapes) + shift if any(turned) else shift


@lru_cache(maxsize=64)
def _link_radii(model: RobotModel) -> F64:
    """Return the distance (links,) [m] from each link's origin to its farthest point, with which a motion
    proof bounds the link's displacement.

    The order is that of the kinematic tree.
    """
    links = [model.links[name] for name in kinematic_tree(model).link_names]
    return np.array([_radius(tuple((c.shape, c.T_link_shape) for c in link.collisions)) for link in links])


@lru_cache(maxsize=256)
def _radius(shapes: Solids) -> float:
    """Return an upper bound on the distance [m] from the origin of an object or link to its shapes, with
    which a motion proof bounds their displacement.
    """
    reach = 0.0
    for shape, T in shapes:
        center, half = local_bounds(shape)
        reach = max(reach, float(np.linalg.norm(T.apply(center)) + np.linalg.norm(half)))
    return reach


@dataclass(frozen=True)
class Conflict:
    """First contact on the remaining part of a timed motion, as found by a motion proof.

    Attributes:
        time: time of the contact on the motion's own clock [s].
        contact: the pair of bodies; None if it is unknown.
        at_start: True if the robot is already in contact, deeper than resting contact.
    """

    time: float
    contact: Contact | None
    at_start: bool = False


@dataclass(frozen=True, eq=False)
class ActiveMotion:
    """Timed motion to be proven collision-free. The robot has possibly already executed the first part of the
    motion's trajectory.

    The methods count times from now, so they describe the remaining part.

    Attributes:
        trajectory: the planned trajectory.
        passed: trajectory time already executed [s].
        blend: offset that is added to the start of the trajectory, from its time 0 on; it fades out the
            velocity of an arm that was moving when the motion began.
    """

    trajectory: JointTrajectory
    passed: float = 0.0
    blend: JointTrajectory | None = None

    @property
    def remaining(self) -> float:
        """Return the remaining duration [s] of a running motion, which the motion proof must cover."""
        return max(self.trajectory.duration - self.passed, 0.0)

    def positions(self, after: F64) -> F64:
        """Return the joint positions (k, n) at times (k,) [s] of an active motion, to prove it
        collision-free. The positions are constant after the end of the motion.
        """
        q = positions_at(self.trajectory, self.passed + after)
        return q if self.blend is None else q + positions_at(self.blend, self.passed + after)

    def accelerations(self) -> F64:
        """Return upper bounds (n,) on the acceleration of each joint in a running motion,
        to prove the motion collision-free.

        Units are [rad/s^2 or m/s^2].
        """
        most = acceleration_bounds(self.trajectory)
        return most if self.blend is None else most + acceleration_bounds(self.blend)

    def knots(self) -> F64:
        """Return the times [s], counted from now, at which one polynomial segment of a motion in a motion
        proof ends and the next one begins.
        """
        times = self.trajectory.times - self.passed
        if self.blend is not None:
            times = np.union1d(times, self.blend.times - self.passed)
        return times[(times > 0) & (times < self.remaining)]


def first_conflict(
    scene: PlanningScene,
    motion: ActiveMotion,
    others: Sequence[ActiveMotion] = (),
    shift: float = 0.0,
    planned: PlanningScene | None = None,
) -> Conflict | None:
    """Prove that a timed motion collides neither with the scene nor with running motions, or return its first
    contact.

    None is a certificate. It covers the robot and all objects that it holds, including the states between
    samples, rounded corners, and the gap between the measured and the commanded start. Padding and contacts
    that the scene allows are ignored. The motion may start in resting contact if it leads out of the contact
    (`certify_from_rest`).

    Args:
        scene: the current scene as measured; joints outside the motions keep their positions.
        motion: the motion to certify.
        others: motions of other joints that run in parallel, on the same clock.
        shift: largest delay or lead of the motion relative to the others [s].
        planned: the scene in which the motion was planned. If the measured scene differs from it by less than
            `DISPLACED`, the function first certifies the motion in this scene, for which the kernel has
            cached data.
    Raises:
        InputError: a position is not finite.
    """
    if motion.remaining <= 0 and not len(motion.trajectory.times):
        return None
    names = tuple(n for m in (motion, *others) for n in m.trajectory.joint_names)
    delays = (0.0,) if not others or shift <= 0 else (0.0, shift, -shift)
    if planned is not None and (off := displacement(planned, scene, names)) < DISPLACED:
        checker = KernelChecker(planned, names)
        here = scene.positions[checker.columns]
        if all(_free(checker, *_timed(here, motion, others, late, ERRORS[0])[1:], off) for late in delays):
            return None
    checker = KernelChecker(scene, names)
    here = scene.positions[checker.columns]
    for late in delays:
        found = _conflict(checker, here, motion, others, late)
        if found is not None:
            return found
    return None


def _free(checker: KernelChecker, points: F64, room: F64, distance: float = 0.0) -> bool:
    return checker.certify(points, room, distance=distance, evidence=False).free


def _conflict(
    checker: KernelChecker, here: F64, motion: ActiveMotion, others: Sequence[ActiveMotion], late: float
) -> Conflict | None:
    for error in ERRORS:
        times, points, room = _timed(here, motion, others, late, error)
        if _free(checker, points, room):
            return None
    proof = certify_from_rest(checker, points, room)
    if proof.free:
        return None
    proof = _earliest(checker, points, room, proof)
    at = proof.at * (len(points) - 1)
    time = float(np.interp(at, np.arange(len(times)), times))
    return Conflict(motion.passed + max(time - late, 0.0), proof.contact, proof.at <= 0.0)


def _earliest(checker: KernelChecker, points: F64, room: F64, proof: Certificate) -> Certificate:
    """Find the first contact of a motion that failed certification, by bisection over its waypoints. The
    contact in `proof`, the failed certificate, may not be the first one.
    """
    edges = len(points) - 1
    free, not_free = 0, min(int(proof.at * edges) + 1, edges)  # last waypoints of a free and a failed prefix
    while not_free - free > 1:
        middle = (free + not_free) // 2
        if _free(checker, points[: middle + 1], room):
            free = middle
        else:
            not_free = middle
    if free == 0:
        return proof  # the motion begins in resting contact or fails on its first edge
    first = checker.certify(points[free : not_free + 1], room)
    if first.free:
        return proof
    return Certificate(False, (free + first.at * (not_free - free)) / edges, first.contact)


def _timed(
    here: F64, motion: ActiveMotion, others: Sequence[ActiveMotion], late: float, error: float
) -> tuple[F64, F64, F64]:
    """Return the path that the motion proof certifies: piecewise linear, from the measured joint positions
    through all running motions.

    Args:
        here: (n,) measured positions, which become the first waypoint.
    Returns:
        As `_pieces`.
    """
    times, points, room = _pieces(motion, others, late, error)
    require(bool(np.isfinite(points).all()), "the motion has a position that is not finite")
    return np.concatenate([[0.0], times]), np.vstack([here, points]), room


def _pieces(
    motion: ActiveMotion, others: Sequence[ActiveMotion], late: float, error: float
) -> tuple[F64, F64, F64]:
    """Convert running motions to one piecewise linear path and bound its deviation from these motions,
    to prove them collision-free.

    Returns:
        Times (k,) [s] from now, positions (k, n), and the largest deviation of each joint (n,) [rad or m].
    """
    starts = [late, *([0.0] * len(others))]  # a negative start means that the motion has already begun
    every = (motion, *others)
    end = max(m.remaining + max(s, 0.0) for m, s in zip(every, starts, strict=True))
    most = np.concatenate([m.accelerations() for m in every])
    largest = float(most.max(initial=0.0))
    longest = min(float(np.sqrt(8 * error / largest)), LONGEST) if largest > 0 else LONGEST
    count = max(int(np.ceil(end / longest)), 1)
    knots = [m.knots() + s for m, s in zip(every, starts, strict=True)]
    ends = [m.remaining + s for m, s in zip(every, starts, strict=True)]
    times = np.sort(np.concatenate([np.linspace(0.0, end, count + 1), *knots, ends]))
    times = times[(times >= 0.0) & (times <= end) & (np.diff(times, prepend=-1.0) > 0.0)]
    points = np.hstack([m.positions(np.maximum(times - s, 0.0)) for m, s in zip(every, starts, strict=True)])
    return times, points, most * float(np.diff(times).max(initial=0.0)) ** 2 / 8


def conflict_at_any_pace(scene: PlanningScene, motion: ActiveMotion, other: ActiveMotion) -> bool:
    """Return whether two arms could touch if each of them executes its motion at an arbitrary time and speed.
    The result is False only if the motions are proven to keep the arms apart.

    A speed slider or a pause can slow down real arms at any time, so their relative timing is unknown. The
    result is also True if no certificate is possible, because the motions do not belong to two arms without
    shared joints.
    """
    mine, theirs = (_arm_of(scene, m.trajectory.joint_names) for m in (motion, other))
    if mine is None or theirs is None:
        return True
    if set(scene.model.group(mine).joint_names) & set(scene.model.group(theirs).joint_names):
        return True
    a, room_a = _of_group(scene, motion, mine)
    b, room_b = _of_group(scene, other, theirs)
    return not InterArmChecker(scene, (mine, theirs)).keeps_clearance_at_any_pace(a, room_a, b, room_b, 0.0)


def _of_group(scene: PlanningScene, motion: ActiveMotion, group: str) -> tuple[F64, F64]:
    """Return a piecewise linear path (k, n) of a group that approximates a timed motion to prove
    collision-free, and the largest deviation (n,) [rad or m] of each joint from this path.

    Joints outside the motion keep their positions in the scene, with deviation 0.
    """
    _, points, room = _pieces(motion, (), 0.0, ERRORS[0])
    joints = scene.model.group(group).joint_names
    columns = [joints.index(n) for n in motion.trajectory.joint_names]
    whole, wide = np.tile(scene.state.reindexed(joints).positions, (len(points), 1)), np.zeros(len(joints))
    whole[:, columns], wide[columns] = points, room
    return whole, wide


def _arm_of(scene: PlanningScene, joint_names: Iterable[str]) -> str | None:
    """Return the name of the arm that executes a motion to prove: the smallest planning group that contains
    all given joints, or None.

    A group counts only if it has at least `ARM_JOINTS` joints. The motion proof treats this group as the arm
    that executes the motion.
    """
    wanted = set(joint_names)
    groups = [g for g in scene.model.groups.values() if wanted <= set(g.joint_names)]
    groups = [g for g in groups if len(g.joint_names) >= ARM_JOINTS]
    return min(groups, key=lambda g: len(g.joint_names)).name if groups else None


def elapsed_at(trajectory: JointTrajectory, q: ArrayLike, most: float) -> float:
    """Return the time [s] on a trajectory that corresponds to measured joint positions q (n,). A motion proof
    needs only the part of the motion after this time.

    Args:
        trajectory: the trajectory that the robot executes.
        q: (n,) measured positions.
        most: upper bound of the result [s].
    Returns:
        The earliest time at which the distance to q is within `SAME` of its minimum.
    """
    most = min(max(most, 0.0), trajectory.duration)
    times = np.linspace(0.0, most, max(int(np.ceil(most / SAMPLES)), 1) + 1)
    off = np.abs(positions_at(trajectory, times) - np.asarray(q, dtype=float)).max(axis=1)
    return float(times[int(np.argmax(off <= off.min() + SAME))])
