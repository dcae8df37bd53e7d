"""What has come across a motion that is under way: the rest of it, proven against some of the objects."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.collision.kernel.checker import KernelChecker
from armcell.core import Contact, JointTrajectory
from armcell.scene import PlanningScene
from armcell.timing.chords import acceleration_bounds, positions_at

Array = NDArray[np.float64]

ERROR = 5e-4  # [rad or m] about the most that a joint is off the straight pieces that are proven
LONGEST = 0.05  # [s] of a piece: so exactly is told when the contact comes
SAMPLES = 0.01  # [s] between the states among which the nearest is sought
SAME = 2e-3  # [rad or m] by which another state may be farther than the nearest and still be the one


@dataclass(frozen=True)
class Crossing:
    """The first contact on the rest of a motion.

    Attributes:
        object: the one of the objects asked for.
        time: [s] on the trajectory.
    """

    object: str
    time: float
    contact: Contact | None


def crossing(
    scene: PlanningScene, trajectory: JointTrajectory, passed: float, names: Iterable[str]
) -> Crossing | None:
    """What of some objects a robot, or what it holds, would touch on the rest of a motion; None where that is
    proven free, rounded corners included. Padding is left out, and what the scene allows to touch may touch.

    Args:
        scene: the other joints where they are.
        passed: [s] of the trajectory that is done.
    """
    objects = {name: scene.objects[name] for name in names if name in scene.objects}
    if not objects or passed >= trajectory.duration:
        return None
    bodies = [*scene.model.links, *scene.attached]  # what these do to each other is not asked
    among = {frozenset(pair): True for pair in combinations(bodies, 2)}
    scene = replace(scene, objects=objects, allowed_pairs={**scene.allowed_pairs, **among})
    times, points, room = _pieces(trajectory, passed)
    checker = KernelChecker(scene, trajectory.joint_names)
    if checker.certify(points, room, evidence=False).free:
        return None
    free, not_free = 0, len(points) - 1  # up to which point it is proven free, and up to which not
    while not_free - free > 1:
        middle = (free + not_free) // 2
        if checker.certify(points[: middle + 1], room, evidence=False).free:
            free = middle
        else:
            not_free = middle
    proof = checker.certify(points[free : not_free + 1], room)
    touched = () if proof.contact is None else (proof.contact.body_a, proof.contact.body_b)
    name = next((body for body in touched if body in objects), next(iter(objects)))
    at = times[free] + min(proof.at, 1.0) * (times[not_free] - times[free])
    return Crossing(name, float(at), proof.contact)


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


def _pieces(trajectory: JointTrajectory, passed: float) -> tuple[Array, Array, Array]:
    """The rest as straight pieces: times (k,), positions (k, n), and each joint's greatest error (n,)."""
    most, end = acceleration_bounds(trajectory), trajectory.duration
    largest = float(most.max(initial=0.0))
    longest = min(np.sqrt(8 * ERROR / largest), LONGEST) if largest > 0 else LONGEST
    count = int(np.ceil((end - passed) / longest))
    knots = trajectory.times[(trajectory.times > passed) & (trajectory.times < end)]
    times = np.union1d(np.linspace(passed, end, max(count, 1) + 1), knots)
    return times, positions_at(trajectory, times), most * float(np.diff(times).max()) ** 2 / 8
