"""Certification of timed motions against obstacles that move along known trajectories.

Like `certify_path`, but over time: in a time interval, the robot and the obstacle move by at most known
bounds. A pair whose distance in the middle of the interval exceeds these bounds is collision-free in the
whole interval.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import comb

import numpy as np
from numpy.typing import NDArray

from armcell.collision.certify import MotionBound
from armcell.collision.exact_checker import ExactChecker
from armcell.core import Contact, InputError, JointTrajectory
from armcell.scene import MovingObject, PlanningScene

Array = NDArray[np.float64]

NEAREST = 1e-4
"""[m] Pairs whose distance exceeds the clearance by less than this count as touching."""

SHORT = 1e-3
"""[s] Precision of the reported contact time."""


@dataclass(frozen=True)
class TimedCertificate:
    """Result of an attempt to certify a timed motion against moving obstacles.

    Attributes:
        free: True if the motion is certified collision-free.
        time: time of the contact [s, obstacles' clock]; only if not `free`.
        contact: pair of bodies in contact, or None if unknown; only if not `free`.
    """

    free: bool
    time: float = np.inf
    contact: Contact | None = None


def certify_timed(
    scene: PlanningScene,
    trajectory: JointTrajectory,
    moving: Sequence[MovingObject],
    start_time: float = 0.0,
    clearance: float = 0.0,
    until: float | None = None,
) -> TimedCertificate:
    """Certify that a timed motion keeps its distance from moving obstacles, or find the first contact.

    The certificate covers only pairs of a moving obstacle and the robot (or an object it holds); static
    obstacles must be certified separately. Contacts that the scene allows for an obstacle's name are ignored.

    Args:
        scene: the scene with the robot.
        trajectory: the motion of the robot.
        moving: the moving obstacles.
        start_time: time at which the motion begins [s, obstacles' clock].
        clearance: distance to keep [m].
        until: time until which the robot holds its final position [s, obstacles' clock]; by default the
            certificate ends with the motion.
    Raises:
        InputError: the trajectory is empty, two obstacles have the same name, or the clearance is negative.
    """
    if len(trajectory.times) == 0:
        raise InputError("an empty trajectory cannot be certified")
    if not (np.isfinite(clearance) and clearance >= 0):
        raise InputError(f"clearance is {clearance:g}, it must be a number of meters >= 0")
    names = [item.name for item in moving]
    if len(set(names)) != len(names):
        raise InputError(f"two moving obstacles have one name: {', '.join(sorted(names))}")
    if not moving:
        return TimedCertificate(True)
    world = _Moving(scene, trajectory, moving, start_time, clearance)
    return world.certify(start_time, max(start_time + trajectory.duration, until or start_time))


class _Moving:
    """The robot and the moving obstacles at one time of a motion to certify, together with the body pairs to
    check and bounds on the motion of each pair.
    """

    def __init__(self, scene, trajectory, moving, start_time, clearance):
        others = {k: v for k, v in scene.objects.items() if k not in {m.name for m in moving}}
        scene = replace(scene, objects=others)
        for item in moving:
            scene = scene.with_object(item.object)
        self.scene, self.trajectory, self.start, self.clearance = scene, trajectory, start_time, clearance
        self.checker = ExactChecker(scene, trajectory.joint_names)
        by_name = {item.name: item for item in moving}
        geometries = self.checker.geometries
        self.parts = []  # (geometry, its obstacle, T_object_solid)
        for i, g in enumerate(geometries):
            if g.link < 0 and g.body in by_name:
                item = by_name[g.body]
                self.parts.append((i, item, item.object.T_world_object.inverse() @ g.T_link_solid))
        pairs = [
            (a, b, item)
            for a, g in enumerate(geometries) if g.link >= 0
            for b, item, _ in self.parts if not scene.is_allowed(g.body, item.name)
        ]  # fmt: skip
        self.items = [item for _, _, item in pairs]
        self.checker.pairs = np.array([(a, b) for a, b, _ in pairs], dtype=np.int64).reshape(-1, 2)
        self.bound = MotionBound(self.checker)
        self.travelled = _travelled(trajectory)

    def set_configuration(self, t: float) -> None:
        self.checker.set_configuration(self.trajectory.sample(t - self.start)[0])
        for i, item, T in self.parts:
            self.checker.set_object_pose(i, item.pose(t) @ T)

    def joint_travel(self, a: float, b: float) -> Array:
        """Return upper bounds (n,) on how far each joint moves [rad or m] between two times of a timed
        motion, to certify the motion.
        """
        times = np.array([a, b]) - self.start
        ends = np.array([np.interp(times, self.trajectory.times, row) for row in self.travelled.T])
        return ends[:, 1] - ends[:, 0]

    def certify(self, begin: float, end: float) -> TimedCertificate:
        checker = self.checker
        stack = [(begin, end, np.arange(len(checker.pairs)))]
        while stack:
            a, b, left = stack.pop()
            middle = (a + b) / 2
            self.set_configuration(middle)
            joints = np.maximum(self.joint_travel(a, middle), self.joint_travel(middle, b))
            robot, moved = self.bound.along(joints), {}
            for item in {id(self.items[p]): self.items[p] for p in left}.values():
                moved[id(item)] = max(item.travel(a, middle), item.travel(middle, b))
            need = robot[left] + np.array([moved[id(self.items[p])] for p in left]) + self.clearance
            unproven = []
            for k in np.flatnonzero(checker.pair_gaps(checker.pairs[left]) <= need):
                i, j = (int(n) for n in checker.pairs[left[k]])
                if checker.pair_distance(i, j, outer=True) > need[k]:
                    continue
                distance = checker.pair_distance(i, j)
                if distance > need[k]:
                    continue
                unproven.append((left[k], distance, need[k]))
            if not unproven:
                continue
            worst = min(unproven, key=lambda u: u[1])
            # To find the first contact, bisect an uncertified interval down to its minimum length.
            small = all(n - self.clearance <= NEAREST for _, _, n in unproven) and b - a <= SHORT
            if small or b - a < SHORT / 1000:
                i, j = (int(n) for n in checker.pairs[worst[0]])
                return TimedCertificate(False, middle, checker.contact_of(i, j))
            rest = np.array([u[0] for u in unproven])
            stack.append((middle, b, rest))
            stack.append((a, middle, rest))
        return TimedCertificate(True)


def _travelled(trajectory: JointTrajectory) -> Array:
    """Return upper bounds (k, n) on the distance that each joint has
    traveled so far along a timed motion, to certify the motion.

    On each segment, the Bernstein coefficients of a polynomial's derivative bound the derivative (Farouki,
    "The Bernstein polynomial basis: a centennial retrospective", CAGD 2012).
    """
    p, h = trajectory.positions, np.diff(trajectory.times)[:, None]
    out = np.zeros((len(p), p.shape[1]))
    if len(p) < 2:
        return out
    d = p[1:] - p[:-1]
    if trajectory.velocities is None:
        speed = [d / h]
    else:
        v0, v1 = trajectory.velocities[:-1], trajectory.velocities[1:]
        if trajectory.accelerations is None:
            c = [v0, (3 * d - (2 * v0 + v1) * h) / h**2, ((v0 + v1) * h - 2 * d) / h**3]
        else:
            a0, a1 = trajectory.accelerations[:-1], trajectory.accelerations[1:]
            c = [
                v0, a0 / 2,
                (20 * d - (8 * v1 + 12 * v0) * h - (3 * a0 - a1) * h**2) / (2 * h**3),
                (-30 * d + (14 * v1 + 16 * v0) * h + (3 * a0 - 2 * a1) * h**2) / (2 * h**4),
                (12 * d - 6 * (v1 + v0) * h + (a1 - a0) * h**2) / (2 * h**5),
            ]  # fmt: skip
        rate = [(k + 1) * c[k] * h**k for k in range(len(c))]  # power-basis coefficients for a parameter 0..1
        n = len(rate) - 1
        speed = [
            np.asarray(sum(comb(i, k) / comb(n, k) * rate[k] for k in range(i + 1))) for i in range(n + 1)
        ]  # fmt: skip
    out[1:] = np.cumsum(np.max(np.abs(speed), axis=0) * h, axis=0)
    return out
