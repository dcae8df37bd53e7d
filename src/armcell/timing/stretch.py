"""Time scaling of trajectories: slow down, set a duration, synchronize, reverse."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from armcell.core import InputError, JointTrajectory


def check_scaling(value: float, what: str) -> float:
    """Return a velocity or acceleration scaling factor after checking that it is in (0, 1].

    Raises:
        InputError: the factor is outside (0, 1].
    """
    if not np.isfinite(value) or not 0.0 < value <= 1.0:
        raise InputError(f"{what} is {value:g}, it must be in (0, 1]")
    return float(value)


MAX_FACTOR = 1e12
MAX_DURATION = 1e12  # [s]


def stretched(trajectory: JointTrajectory, factor: float) -> JointTrajectory:
    """Return the trajectory slowed down by a factor >= 1.

    Raises:
        InputError: the factor is below 1, which could violate limits, or not finite.
    """
    if not 1.0 <= factor <= MAX_FACTOR:
        raise InputError(f"stretch factor is {factor:g}, it must be from 1 to {MAX_FACTOR:g}")
    v, a = trajectory.velocities, trajectory.accelerations
    return replace(
        trajectory,
        times=trajectory.times * factor,
        velocities=None if v is None else v / factor,
        accelerations=None if a is None else a / factor**2,
    )


def stretched_to(trajectory: JointTrajectory, duration: float) -> JointTrajectory:
    """Return the trajectory slowed down to exactly `duration` [s].

    With r the ratio of the old to the new duration, velocities change by the factor r, accelerations by r^2
    and jerks by r^3, so the trajectory stays within its limits. A trajectory with one point becomes a pause.

    Raises:
        InputError: the duration is shorter than the trajectory, or not finite.
    """
    now = trajectory.duration
    if not np.isfinite(duration) or duration > MAX_DURATION or duration < now * (1.0 - 1e-12):
        raise InputError(
            f"duration is {duration:g} s, the motion needs {now:g} s", cure="motions are only slowed"
        )
    if len(trajectory.times) == 1 and duration > 0.0:
        twice = np.repeat(trajectory.positions, 2, axis=0)
        zero = np.zeros_like(twice)
        return JointTrajectory(trajectory.joint_names, np.array([0.0, duration]), twice, zero, zero)
    if duration <= now:
        return trajectory
    slow = stretched(trajectory, duration / now)
    times = slow.times.copy()
    times[-1] = duration  # exact to the last bit
    return replace(slow, times=times)


def synchronized(trajectories: Sequence[JointTrajectory]) -> tuple[JointTrajectory, ...]:
    """Return all trajectories slowed down to the longest duration, so that they end together."""
    longest = max((t.duration for t in trajectories), default=0.0)
    return tuple(stretched_to(t, longest) for t in trajectories)


def reversed_in_time(trajectory: JointTrajectory) -> JointTrajectory:
    """Return the trajectory from its end to its start; symmetric limits remain satisfied."""
    v, a = trajectory.velocities, trajectory.accelerations
    return replace(
        trajectory,
        times=trajectory.times[-1] - trajectory.times[::-1],
        positions=trajectory.positions[::-1],
        velocities=None if v is None else -v[::-1],
        accelerations=None if a is None else a[::-1],
    )
