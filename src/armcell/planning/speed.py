"""A limit for how fast a point moves through the room."""

from __future__ import annotations

import numpy as np

from armcell.core import InputError, JointTrajectory
from armcell.planning.placed import Placed
from armcell.timing import stretched

BETWEEN = 4  # speeds that are looked at from one point of a trajectory to the next


def check_speed(speed: float | None) -> None:
    """Raise an InputError unless a speed [m/s] is positive, or None."""
    if speed is not None and not (np.isfinite(speed) and speed > 0):
        raise InputError(f"max_cartesian_speed is {speed:g} m/s, it must be positive")


def slowed(trajectory: JointTrajectory, placed: Placed, speed: float) -> JointTrajectory:
    """The whole motion stretched in time, so that the point's speed nowhere exceeds `speed` [m/s]."""
    return stretched(trajectory, max(1.0, peak_speed(trajectory, placed) / speed))


def peak_speed(trajectory: JointTrajectory, placed: Placed) -> float:
    """Highest speed [m/s] of a point, at the trajectory's points and between them."""
    times = trajectory.times
    fractions = np.arange(BETWEEN) / BETWEEN
    moments = np.append((times[:-1, None] + np.diff(times)[:, None] * fractions).ravel(), times[-1:])
    states = (trajectory.sample(float(t)) for t in moments)
    return max((float(np.linalg.norm(placed.velocity(q, qd))) for q, qd, _ in states), default=0.0)
