"""Time scaling of trajectories: slower by a factor, to a duration, to the longest of several, backwards."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from armcell.core import InputError, JointTrajectory


def check_scaling(value: float, what: str) -> float:
    """A velocity or acceleration scaling factor in (0, 1].

    Raises:
        InputError: outside.
    """
    if not np.isfinite(value) or not 0.0 < value <= 1.0:
        raise InputError(f"{what} is {value:g}, it must be in (0, 1]")
    return float(value)


MAX_FACTOR = 1e12
MAX_DURATION = 1e12  # [s]


def stretched(trajectory: JointTrajectory, factor: float) -> JointTrajectory:
    """The same motion slowed by a factor >= 1.

    Raises:
        InputError: factor below 1 (limits might be broken) or not finite.
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
    """The same motion in exactly `duration` [s], which may not be shorter than it is.

    Every velocity becomes smaller by the ratio of the durations, every acceleration by its square and every
    jerk by its cube, so what was within limits stays within. A trajectory of one point waits.

    Raises:
        InputError: duration shorter than the motion, or not finite.
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
    times[-1] = duration  # to the last bit
    return replace(slow, times=times)


def synchronized(trajectories: Sequence[JointTrajectory]) -> tuple[JointTrajectory, ...]:
    """All motions slowed to the longest one's duration: they start and end together."""
    longest = max((t.duration for t in trajectories), default=0.0)
    return tuple(stretched_to(t, longest) for t in trajectories)


def reversed_in_time(trajectory: JointTrajectory) -> JointTrajectory:
    """The same motion from its end to its start; it keeps every symmetric limit."""
    v, a = trajectory.velocities, trajectory.accelerations
    return replace(
        trajectory,
        times=trajectory.times[-1] - trajectory.times[::-1],
        positions=trajectory.positions[::-1],
        velocities=None if v is None else -v[::-1],
        accelerations=None if a is None else a[::-1],
    )
