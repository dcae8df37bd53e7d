"""From waypoints on a manifold to a timed motion that is proven, free of contact and in its constraints."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from armcell.collision.kernel.checker import KernelChecker
from armcell.core import JointTrajectory, PlanRequest
from armcell.planning.constraints.description import Manifold
from armcell.planning.finish import SAGITTA
from armcell.timing import (
    BlendedPath,
    TimingSettings,
    TorqueModel,
    jerk_limited,
    parameterize,
    smoothing_departure,
)

Array = NDArray[np.float64]

LADDER = ((0.05, 0.032), (0.01, 0.032), (0.01, 0.016), (2e-3, 0.008), (5e-4, 4e-3))
"""Corners cut by at most so much [rad], window of the smoothing [s]: the next where the one before does not
keep to the constraints or touches something. With smaller ones the motion jerks more and takes longer."""

PIECES = 4  # chords between two points of the trajectory, on which the constraints are proven


def timed(
    checker: KernelChecker, manifold: Manifold, waypoints: Array, request: PlanRequest,
    torque: TorqueModel | None = None,
) -> JointTrajectory | None:  # fmt: skip
    """The motion along waypoints (k, n), proven as it will be executed, or None if that fails."""
    names, model = checker.joint_names, checker.model
    velocity = model.limits(names, "velocity") * request.velocity_scaling
    acceleration = model.limits(names, "acceleration") * request.acceleration_scaling
    for deviation, smoothing in LADDER:
        settings = TimingSettings(max_deviation=deviation, smoothing=smoothing)
        path = BlendedPath(waypoints, deviation, smooth=request.jerk_limits)
        slack = np.full(len(names), SAGITTA)
        if not request.jerk_limits:
            slack += smoothing_departure(acceleration, settings)
        if path.length > 0 and not checker.certify(path.polyline(SAGITTA), slack, evidence=False).free:
            # A start or goal within the slack of something: without it, where nothing else is left.
            if (deviation, smoothing) != LADDER[-1]:
                continue
            if not checker.certify(path.polyline(SAGITTA), evidence=False).free:
                return None
        if request.jerk_limits:
            jerk = model.limits(names, "jerk")
            trajectory = jerk_limited(path, names, velocity, acceleration, jerk, settings)
        else:
            trajectory = parameterize(path, names, velocity, acceleration, settings, torque)
        if manifold.leaves(*chords(trajectory)) < 0:
            return trajectory
    return None


def chords(trajectory: JointTrajectory) -> tuple[Array, Array]:
    """Points (m, n) on a trajectory, and how far (n,) [rad] its quintics can be from the lines between.

    A curve is within h^2 / 8 times its largest acceleration of its chord over a time h. The acceleration of a
    quintic is a cubic, within the hull of its Bernstein coefficients.
    """
    times, q = trajectory.times, trajectory.positions
    v, a = trajectory.velocities, trajectory.accelerations
    if len(times) == 1 or v is None or a is None:
        return np.vstack([q, q]), np.zeros(q.shape[1])
    h = np.diff(times)[:, None]
    d = np.diff(q, axis=0)
    v0, v1, a0, a1 = v[:-1], v[1:], a[:-1], a[1:]
    middle = 5 * d / h - 2 * (v0 + v1) + h * (a1 - a0) / 4  # of the velocity's Bernstein coefficients
    b1, b2 = 4 / h * (middle - v0 - h * a0 / 4), 4 / h * (v1 - h * a1 / 4 - middle)  # the acceleration's
    most = np.max(np.abs(np.stack([a0, b1, b2, a1])), axis=0)
    room = np.max(most * (h / PIECES) ** 2 / 8, axis=0)
    control = np.stack([  # of the quintic
        q[:-1], q[:-1] + h * v0 / 5, q[:-1] + 2 * h * v0 / 5 + h * h * a0 / 20,
        q[1:] - 2 * h * v1 / 5 + h * h * a1 / 20, q[1:] - h * v1 / 5, q[1:],
    ])  # fmt: skip
    s = np.arange(PIECES)[:, None] / PIECES
    basis = np.hstack([n * s**i * (1 - s) ** (5 - i) for i, n in enumerate((1, 5, 10, 10, 5, 1))])
    points = np.einsum("pc,cin->ipn", basis, control).reshape(-1, q.shape[1])
    return np.vstack([points, q[-1]]), room


__all__ = ["chords", "timed"]
