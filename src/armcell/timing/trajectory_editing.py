"""Editing of timed trajectories: slow down, delay, cut, extend, concatenate, merge, reverse."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.core import InputError, JointState, JointTrajectory
from armcell.core.checks import float_array

Array = NDArray[np.float64]

MAX_FACTOR = 1e12
MAX_DURATION = 1e12  # [s]
SAME_TIME = 1e-9  # [s] points of merged motions that are closer become one point


def check_scaling(value: float, what: str) -> float:
    """Check that a scaling factor for the velocity or acceleration of a trajectory is greater than 0 and at
    most 1.

    Raises:
        InputError: the factor is outside (0, 1].
    """
    if not np.isfinite(value) or not 0.0 < value <= 1.0:
        raise InputError(f"{what} is {value:g}, it must be in (0, 1]")
    return float(value)


# --- time ---
def slow_down(trajectory: JointTrajectory, factor: float) -> JointTrajectory:
    """Slow down a trajectory by a factor of at least 1.

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


def slow_down_to_duration(trajectory: JointTrajectory, duration: float) -> JointTrajectory:
    """Slow down a trajectory so that it takes exactly `duration` [s].

    With r the ratio of the old to the new duration, velocities change by the factor r, accelerations by r^2
    and jerks by r^3, so the trajectory stays within its limits. A trajectory with one point becomes a pause.

    Raises:
        InputError: the duration is shorter than the trajectory, or not finite.
    """
    now = trajectory.duration
    if not np.isfinite(duration) or duration > MAX_DURATION or duration < now * (1.0 - 1e-12):
        raise InputError(
            f"duration is {duration:g} s, the motion needs {now:g} s", hint="motions are only slowed"
        )
    if len(trajectory.times) == 1 and duration > 0.0:
        twice = np.repeat(trajectory.positions, 2, axis=0)
        zero = np.zeros_like(twice)
        return JointTrajectory(trajectory.joint_names, np.array([0.0, duration]), twice, zero, zero)
    if duration <= now:
        return trajectory
    slow = slow_down(trajectory, duration / now)
    times = slow.times.copy()
    times[-1] = duration  # exact to the last bit
    return replace(slow, times=times)


def synchronize_trajectories(trajectories: Sequence[JointTrajectory]) -> tuple[JointTrajectory, ...]:
    """Slow down several trajectories to the duration of the longest one, so that all of them end at the same
    time.
    """
    longest = max((t.duration for t in trajectories), default=0.0)
    return tuple(slow_down_to_duration(t, longest) for t in trajectories)


def reverse_trajectory(trajectory: JointTrajectory) -> JointTrajectory:
    """Reverse a trajectory in time, so that it leads from its end to its start.

    Symmetric limits remain satisfied.
    """
    v, a = trajectory.velocities, trajectory.accelerations
    return replace(
        trajectory,
        times=trajectory.times[-1] - trajectory.times[::-1],
        positions=trajectory.positions[::-1],
        velocities=None if v is None else -v[::-1],
        accelerations=None if a is None else a[::-1],
    )


def delay_trajectory(trajectory: JointTrajectory, wait: float) -> JointTrajectory:
    """Delay a trajectory by `wait` [s] > 0: the joints first stand still at its start position."""
    later = replace(trajectory, times=trajectory.times + wait)
    return with_start_state(trajectory.start, later)


# --- points ---
def stationary_trajectory(
    joint_names: Iterable[str], positions: ArrayLike, time: float = 0.0
) -> JointTrajectory:
    """Create a trajectory with a single point, at which joints rest at positions (n,) at `time` [s]."""
    q = float_array(positions, (None,), "positions")[None]
    return JointTrajectory(tuple(joint_names), np.array([time]), q, np.zeros_like(q), np.zeros_like(q))


def with_start_state(state: JointState, trajectory: JointTrajectory) -> JointTrajectory:
    """Add a point at time 0 to the beginning of a trajectory, with the positions and velocities of a given
    state.

    Args:
        state: state of at least the trajectory's joints; without velocities the joints are at rest.
        trajectory: trajectory whose first point is later than 0 s.
    Raises:
        UnknownNameError: the state does not have a joint.
    """
    here = state.reindexed(trajectory.joint_names)
    rest = np.zeros(len(here.joint_names))
    moving = rest if here.velocities is None else here.velocities
    v, a = trajectory.velocities, trajectory.accelerations
    return replace(
        trajectory,
        times=np.concatenate([[0.0], trajectory.times]),
        positions=np.vstack([here.positions, trajectory.positions]),
        velocities=None if v is None else np.vstack([moving, v]),
        accelerations=None if a is None else np.vstack([rest, a]),
    )


def trajectory_section(
    trajectory: JointTrajectory, begin: float, end: float, apart: float = 0.0
) -> JointTrajectory:
    """Return the part of a trajectory between two times [s]; the time stamps of its points stay the same.

    Args:
        trajectory: with velocities and accelerations.
        begin, end: within the trajectory, begin < end. The part has a point at each.
        apart: omit the trajectory's points that are this close [s] to `begin` or `end`, or closer.
    Raises:
        InputError: the trajectory has no velocities or no accelerations.
    """
    if trajectory.velocities is None or trajectory.accelerations is None:
        raise InputError("a part of a trajectory needs velocities and accelerations")
    known = trajectory.times
    inner = np.flatnonzero((known > begin + apart) & (known < end - apart))
    rows = [_point(trajectory, begin), *(_row(trajectory, int(i)) for i in inner), _point(trajectory, end)]
    q, v, a = (np.array(column) for column in zip(*rows, strict=True))
    return JointTrajectory(trajectory.joint_names, np.array([begin, *known[inner], end]), q, v, a)


def _point(trajectory: JointTrajectory, t: float) -> tuple[Array, Array, Array]:
    """Return the position, velocity and acceleration (n,) at a time [s] at which a trajectory is cut.

    Unlike `JointTrajectory.sample`, the function does not assume rest at the trajectory's ends.
    """
    if t == trajectory.times[0]:
        return _row(trajectory, 0)
    return _row(trajectory, -1) if t == trajectory.duration else trajectory.sample(t)


def _row(trajectory: JointTrajectory, i: int) -> tuple[Array, Array, Array]:
    v, a = trajectory.velocities, trajectory.accelerations
    assert v is not None and a is not None  # `section` checks them
    return trajectory.positions[i], v[i], a[i]


# --- several trajectories ---
def with_resting_joints(
    trajectory: JointTrajectory, state: JointState, joint_names: Iterable[str]
) -> JointTrajectory:
    """Extend a trajectory to all joints in `joint_names`, in this order. The added joints rest at their
    positions in `state`.

    Raises:
        UnknownNameError: neither the trajectory nor the state has a joint.
    """
    names = tuple(joint_names)
    missing = tuple(n for n in names if n not in trajectory.joint_names)
    if not missing:
        return trajectory.reindexed(names)
    k = len(trajectory.times)
    still = np.zeros((k, len(missing)))
    v, a = trajectory.velocities, trajectory.accelerations
    rest = np.tile(state.reindexed(missing).positions, (k, 1))
    return JointTrajectory(
        (*trajectory.joint_names, *missing),
        trajectory.times,
        np.hstack([trajectory.positions, rest]),
        None if v is None else np.hstack([v, still]),
        None if a is None else np.hstack([a, still]),
    ).reindexed(names)


def concatenate_trajectories(*parts: JointTrajectory) -> JointTrajectory:
    """Join trajectories of the same joints one after the other: each part begins when the previous part ends.

    The first point of a part is dropped, because it equals the last point of the previous part. Velocities
    (accelerations) are kept if all parts have them.

    Raises:
        InputError: no parts, or parts with different joint names.
    """
    if not parts or any(part.joint_names != parts[0].joint_names for part in parts):
        raise InputError("only trajectories of the same joints in the same order can be concatenated")
    times, clock = [parts[0].times], parts[0].duration
    for part in parts[1:]:
        times.append(clock + part.times[1:] - part.times[0])
        clock += part.times[-1] - part.times[0]

    def stacked(kind: str) -> Array | None:
        rows = [getattr(part, kind) for part in parts]
        if any(each is None for each in rows):
            return None
        return np.vstack([rows[0], *(each[1:] for each in rows[1:])])

    return JointTrajectory(
        parts[0].joint_names,
        np.concatenate(times),
        np.vstack([parts[0].positions, *(part.positions[1:] for part in parts[1:])]),
        stacked("velocities"),
        stacked("accelerations"),
    )


def merge_trajectories(*trajectories: JointTrajectory) -> JointTrajectory:
    """Merge trajectories of different joints that start at the same time into one trajectory.

    The joints of a shorter motion stay at its end.
    """
    times = np.unique(np.concatenate([t.times for t in trajectories]))
    times = times[np.concatenate([[True], np.diff(times) > SAME_TIME])]
    times[-1] = max(times[-1], *(t.duration for t in trajectories))
    q, v, a = map(np.hstack, zip(*(t.samples(times) for t in trajectories), strict=True))
    return JointTrajectory(tuple(n for t in trajectories for n in t.joint_names), times, q, v, a)
