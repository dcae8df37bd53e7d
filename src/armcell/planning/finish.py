"""From waypoints to a proven, timed motion: round the corners, certify, parameterise."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.collision import Certificate, ExactChecker
from armcell.core import JointTrajectory
from armcell.model import RobotModel
from armcell.timing import BlendedPath, TimingSettings, parameterize

Array = NDArray[np.float64]

SAGITTA = 2e-4
"""[rad] by which the certified chords may differ from the rounded path."""

CLEARANCE_CUTOFF = 0.25  # [m] distances beyond this are reported as this


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


def clearance_along(checker: ExactChecker, trajectory: JointTrajectory, samples: int = 24) -> float:
    """Smallest distance [m] at evenly spread trajectory points, at most `CLEARANCE_CUTOFF`."""
    index = np.unique(np.linspace(0, len(trajectory.times) - 1, samples).round().astype(int))
    best = CLEARANCE_CUTOFF
    for i in index:
        contact = checker.nearest(trajectory.positions[i], best)
        best = best if contact is None else min(best, contact.distance)
    return float(best)
