"""From waypoints to a proven, timed motion: round the corners, certify, parameterise."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.collision import Certificate, ExactChecker, MotionBound
from armcell.core import JointTrajectory
from armcell.model import RobotModel
from armcell.timing import BlendedPath, TimingSettings, parameterize

Array = NDArray[np.float64]

SAGITTA = 2e-4
"""[rad] by which the certified chords may differ from the rounded path."""

CLEARANCE_CUTOFF = 0.25  # [m] distances beyond this are reported as this
CLEARANCE_TOLERANCE = 5e-4  # [m]


@dataclass(frozen=True, eq=False)
class Finished:
    """A certified motion, or the certificate that says where it touches."""

    certificate: Certificate
    trajectory: JointTrajectory | None = None
    path: BlendedPath | None = None


class Certifier(Protocol):
    """What proves motions: the exact checker or the kernel."""

    model: RobotModel
    joint_names: tuple[str, ...]

    def certify(self, waypoints: ArrayLike, slack: ArrayLike | None = None) -> Certificate: ...


def finish(
    checker: Certifier,
    waypoints: ArrayLike,
    velocity_scaling: float,
    acceleration_scaling: float,
    timing: TimingSettings = TimingSettings(),
) -> Finished:
    """Blend, certify and time a path (k, n).

    Corners whose rounding touches something are cut less, at last not at all (the motion stops there).
    """
    points = np.asarray(waypoints, dtype=float)
    deviation = np.full(max(len(points) - 2, 0), timing.max_deviation)
    # What the timed motion may differ from the certified chords: the chords' own error, and what the
    # smoothing of the accelerations leaves the path by, a t^2 / 24 (see `timing.parameterize`).
    limits = checker.model.limits(checker.joint_names, "acceleration") * acceleration_scaling
    slack = SAGITTA + limits * timing.smoothing**2 / 24
    for attempt in range(4):
        path = BlendedPath(points, deviation)
        certificate = checker.certify(path.polyline(SAGITTA), slack if path.pieces else None)
        if certificate.free:
            trajectory = _timed(checker, path, velocity_scaling, acceleration_scaling, timing)
            return Finished(certificate, trajectory, path)
        if len(deviation) == 0:
            break
        deviation = deviation * 0.3 if attempt < 2 else np.zeros_like(deviation)
    # A start or goal within the slack of something cannot be proven with it: the bare edges can.
    path = BlendedPath(points, 0.0)
    certificate = checker.certify(path.points)
    if not certificate.free:
        return Finished(certificate)
    trajectory = _timed(checker, path, velocity_scaling, acceleration_scaling, timing)
    return Finished(certificate, trajectory, path)


def _timed(
    checker: Certifier, path: BlendedPath, v: float, a: float, timing: TimingSettings
) -> JointTrajectory:
    names = checker.joint_names
    velocity = checker.model.limits(names, "velocity") * v
    acceleration = checker.model.limits(names, "acceleration") * a
    return parameterize(path, names, velocity, acceleration, timing)


def clearance_along(checker: ExactChecker, trajectory: JointTrajectory) -> float:
    """Smallest distance [m] along a motion, within `CLEARANCE_TOLERANCE`, at most `CLEARANCE_CUTOFF`.

    Between two trajectory points a pair can come closer than at either by no more than half of what it
    moves, so stretches that cannot beat the smallest distance found are left out.
    """
    points = trajectory.positions
    bound = MotionBound(checker)
    moved = np.zeros(len(points))
    if len(checker.pairs):
        moved[1:] = np.cumsum([bound.along(b - a).max() for a, b in itertools.pairwise(points)])
    best = CLEARANCE_CUTOFF

    def at(i: int) -> float:
        nonlocal best
        contact = checker.nearest(points[i], CLEARANCE_CUTOFF)
        distance = CLEARANCE_CUTOFF if contact is None else contact.distance
        best = min(best, distance)
        return distance

    stretches = [(0, len(points) - 1, at(0), at(len(points) - 1))]
    while stretches:
        i, j, di, dj = stretches.pop()
        if j - i < 2 or (di + dj - (moved[j] - moved[i])) / 2 >= best - CLEARANCE_TOLERANCE:
            continue
        k = (i + j) // 2
        dk = at(k)
        stretches += [(i, k, di, dk), (k, j, dk, dj)]
    return float(best)
