"""Whether a timed motion is free of contact in a scene, also beside other motions; else where and when not.

The motion gate (`control/gate.py`) asks this for every motion at its start, and again when the scene changes.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.collision.arms import ARM_JOINTS, Arms
from armcell.collision.certificate import Certificate
from armcell.collision.kernel.checker import KernelChecker
from armcell.collision.resting import certify_from_rest
from armcell.core import Contact, JointTrajectory
from armcell.core.checks import require
from armcell.scene import PlanningScene
from armcell.timing.chords import acceleration_bounds, positions_at

Array = NDArray[np.float64]

ERRORS = (5e-4, 5e-5)
"""[rad or m] About the most that a joint is off the straight pieces that are proven: the finer ones are tried
where the coarse ones cannot be proven."""

LONGEST = 0.05  # [s] of a piece: the time of a contact is reported as precisely
SAMPLES = 0.01  # [s] between the states among which the nearest is sought
SAME = 2e-3  # [rad or m] by which another state may be farther than the nearest and still be the one


@dataclass(frozen=True)
class Conflict:
    """The first contact on the rest of a motion.

    Attributes:
        time: [s] on the motion's own clock.
        at_start: the robot is in contact where it is now, deeper than resting contact.
    """

    time: float
    contact: Contact | None
    at_start: bool = False


@dataclass(frozen=True, eq=False)
class Moving:
    """A motion from now on.

    Attributes:
        passed: [s] of the trajectory that is done.
        fade: what is added to the trajectory on its first part, from time 0 on: the speed of an arm that was
            moving when the motion began.
    """

    trajectory: JointTrajectory
    passed: float = 0.0
    fade: JointTrajectory | None = None

    @property
    def remaining(self) -> float:
        """[s] until it rests."""
        return max(self.trajectory.duration - self.passed, 0.0)

    def positions(self, after: Array) -> Array:
        """Commanded positions (k, n) at times (k,) [s] from now, at rest after the end."""
        q = positions_at(self.trajectory, self.passed + after)
        return q if self.fade is None else q + positions_at(self.fade, self.passed + after)

    def accelerations(self) -> Array:
        """The most that each joint (n,) accelerates [rad/s^2 or m/s^2]."""
        most = acceleration_bounds(self.trajectory)
        return most if self.fade is None else most + acceleration_bounds(self.fade)

    def knots(self) -> Array:
        """Times [s] from now at which the motion's polynomials change."""
        times = self.trajectory.times - self.passed
        if self.fade is not None:
            times = np.union1d(times, self.fade.times - self.passed)
        return times[(times > 0) & (times < self.remaining)]


def first_conflict(
    scene: PlanningScene, motion: Moving, others: Sequence[Moving] = (), shift: float = 0.0
) -> Conflict | None:
    """What a robot, or what it holds, would touch on the rest of a motion; None where it is proven free.

    Proven between samples too, rounded corners and the gap between the measured and the commanded start
    included. Padding does not count, and what the scene allows to touch may touch. The motion may lead out
    of resting contact at its start (`certify_from_rest`).

    Args:
        scene: as measured now. Joints that nothing moves stay where they are.
        others: motions of other joints that run beside it, on the same clock.
        shift: [s] that the motion may be late or early against the others.
    Raises:
        InputError: a position that is not finite.
    """
    if motion.remaining <= 0 and not len(motion.trajectory.times):
        return None
    names = tuple(n for m in (motion, *others) for n in m.trajectory.joint_names)
    checker = KernelChecker(scene, names)
    here = scene.positions[checker.columns]
    for late in (0.0,) if not others or shift <= 0 else (0.0, shift, -shift):
        found = _conflict(checker, here, motion, others, late)
        if found is not None:
            return found
    return None


def _conflict(
    checker: KernelChecker, here: Array, motion: Moving, others: Sequence[Moving], late: float
) -> Conflict | None:
    for error in ERRORS:
        times, points, room = _pieces(motion, others, late, error)
        require(bool(np.isfinite(points).all()), "the motion has a position that is not finite")
        times, points = np.concatenate([[0.0], times]), np.vstack([here, points])  # up to where it is sent
        if checker.certify(points, room, evidence=False).free:
            return None
    proof = certify_from_rest(checker, points, room)
    if proof.free:
        return None
    proof = _earliest(checker, points, room, proof)
    at = proof.at * (len(points) - 1)
    time = float(np.interp(at, np.arange(len(times)), times))
    return Conflict(motion.passed + max(time - late, 0.0), proof.contact, proof.at <= 0.0)


def _earliest(checker: KernelChecker, points: Array, room: Array, proof: Certificate) -> Certificate:
    """The first of all failures, where a proof has found one of them."""
    edges = len(points) - 1
    free, not_free = 0, min(int(proof.at * edges) + 1, edges)  # up to which point it is free, and is not
    while not_free - free > 1:
        middle = (free + not_free) // 2
        if checker.certify(points[: middle + 1], room, evidence=False).free:
            free = middle
        else:
            not_free = middle
    if free == 0:
        return proof  # it begins in resting contact, or fails at once
    first = checker.certify(points[free : not_free + 1], room)
    if first.free:
        return proof
    return Certificate(False, (free + first.at * (not_free - free)) / edges, first.contact)


def _pieces(
    motion: Moving, others: Sequence[Moving], late: float, error: float
) -> tuple[Array, Array, Array]:
    """All motions as straight pieces: times (k,) from now, positions (k, n), each joint's error (n,)."""
    starts = [late, *([0.0] * len(others))]  # one that is early has begun already
    every = (motion, *others)
    end = max(m.remaining + max(s, 0.0) for m, s in zip(every, starts, strict=True))
    most = np.concatenate([m.accelerations() for m in every])
    largest = float(most.max(initial=0.0))
    longest = min(float(np.sqrt(8 * error / largest)), LONGEST) if largest > 0 else LONGEST
    count = max(int(np.ceil(end / longest)), 1)
    knots = [m.knots() + s for m, s in zip(every, starts, strict=True)]
    ends = [m.remaining + s for m, s in zip(every, starts, strict=True)]
    times = np.unique(np.concatenate([np.linspace(0.0, end, count + 1), *knots, ends]))
    times = times[(times >= 0.0) & (times <= end)]
    points = np.hstack([m.positions(np.maximum(times - s, 0.0)) for m, s in zip(every, starts, strict=True)])
    return times, points, most * float(np.diff(times).max(initial=0.0)) ** 2 / 8


def conflict_at_any_pace(scene: PlanningScene, motion: Moving, other: Moving) -> bool:
    """Whether two arms could touch if each makes its motion whenever and however slowly it wants.

    For real arms, which a speed slider or a pause slows. True also where no proof is possible: the motions
    are not of two arms that share no joint.
    """
    mine, theirs = (_arm_of(scene, m.trajectory.joint_names) for m in (motion, other))
    if mine is None or theirs is None:
        return True
    if set(scene.model.group(mine).joint_names) & set(scene.model.group(theirs).joint_names):
        return True
    a, room_a = _of_group(scene, motion, mine)
    b, room_b = _of_group(scene, other, theirs)
    return not Arms(scene, (mine, theirs)).apart_at_any_pace(a, room_a, b, room_b, 0.0)


def _of_group(scene: PlanningScene, motion: Moving, group: str) -> tuple[Array, Array]:
    """Positions (k, n) and errors (n,) of all joints of a group; those that nothing moves stay."""
    _, points, room = _pieces(motion, (), 0.0, ERRORS[0])
    joints = scene.model.group(group).joint_names
    columns = [joints.index(n) for n in motion.trajectory.joint_names]
    whole, wide = np.tile(scene.state.reindexed(joints).positions, (len(points), 1)), np.zeros(len(joints))
    whole[:, columns], wide[columns] = points, room
    return whole, wide


def _arm_of(scene: PlanningScene, joint_names: Iterable[str]) -> str | None:
    """The smallest group of an arm that has some joints."""
    wanted = set(joint_names)
    groups = [g for g in scene.model.groups.values() if wanted <= set(g.joint_names)]
    groups = [g for g in groups if len(g.joint_names) >= ARM_JOINTS]
    return min(groups, key=lambda g: len(g.joint_names)).name if groups else None


def passed_at(trajectory: JointTrajectory, q: ArrayLike, most: float) -> float:
    """How far along a trajectory [s] a robot at q (n,) is that may have been slowed.

    Args:
        most: [s] it is no farther than that.
    Returns:
        The earliest time at which the trajectory is about as near to q as it ever is.
    """
    most = min(max(most, 0.0), trajectory.duration)
    times = np.linspace(0.0, most, max(int(np.ceil(most / SAMPLES)), 1) + 1)
    off = np.abs(positions_at(trajectory, times) - np.asarray(q, dtype=float)).max(axis=1)
    return float(times[int(np.argmax(off <= off.min() + SAME))])
