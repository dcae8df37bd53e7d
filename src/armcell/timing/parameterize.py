"""Time-optimal parameterization of a path within velocity, acceleration and torque limits."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.core import ArmcellError, InputError, JointTrajectory
from armcell.core.checks import checked, float_array
from armcell.timing import moving_average, topp
from armcell.timing.blend import BlendedPath
from armcell.timing.trajectory_editing import stationary_trajectory

Array = NDArray[np.float64]

ACCELERATION_SHARE = 0.993
"""Fraction of the acceleration limits that the planner uses.

Between trajectory points, the acceleration of the quintic interpolation is slightly higher than planned. If
it still exceeds a limit, the whole motion is slowed down.
"""

TORQUE_SHARE = 0.985
"""Fraction of the torque limits that the planner uses; trajectory points may exceed it by 0.01."""


@dataclass(frozen=True)
@checked()
class TimingSettings:
    """Settings of the time parameterization of a path: allowed deviation at corners, grid, sample time and
    smoothing.
    """

    max_deviation: float = 0.05  # [rad] maximum distance between a corner and the rounded path
    torque_grid: float = 0.02  # [rad] path length between points at which torque limits are enforced
    sample_time: float = 0.008  # [s] between trajectory points
    smoothing: float = 0.032  # [s] window of the moving average that rounds acceleration steps

    def __post_init__(self) -> None:
        for name in ("torque_grid", "sample_time", "smoothing"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0.0):
                raise InputError(f"{name} is {value:g}, it must be positive")


class TorqueModel(Protocol):
    """Protocol of a torque model that the time parameterization uses: it provides joint torques and their
    limits.
    """

    @property
    def limits(self) -> Array:
        """Torque limits (n,) of the joints [Nm or N], which the time parameterization respects."""
        ...

    def torque_coefficients(self, positions: Array, first: Array, second: Array) -> Array:
        """Return coefficients (m, 3, n) with which time parameterization
        computes the joint torques at points of a path.

        The torques are linear in u and x: the coefficients belong to u, x and 1, with path acceleration u and
        squared path speed x.

        Args:
            positions: points of the path (m, n).
            first, second: first and second derivatives of the path (m, n).
        """
        ...

    def torques(self, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike) -> Array:
        """Return the joint torques (m, n) that given motion states (m, n) require, so that the time
        parameterization can check torque limits.
        """
        ...


class TorqueLimitError(ArmcellError):
    """Failure of the time parameterization: at some point of the path, a joint lacks the torque to hold the
    arm still.

    Slower motion cannot help in this case.
    """

    def __init__(self, joint: str, torque: float, limit: float, place: float):
        self.joint, self.torque, self.limit, self.place = joint, torque, limit, place
        super().__init__(
            f"joint {joint!r} takes {torque:.4g} Nm (or N) to hold still at {place:.0%} of the path, "
            f"its limit is {limit:.4g} with {1 - TORQUE_SHARE:.1%} of it kept back "
            "(carry less, or take another way)"
        )


def parameterize(
    path: BlendedPath,
    joint_names: tuple[str, ...],
    velocity: ArrayLike,
    acceleration: ArrayLike,
    settings: TimingSettings = TimingSettings(),
    torque: TorqueModel | None = None,
) -> JointTrajectory:
    """Compute the time parameterization of a path: the fastest trajectory along it within the joint limits
    and, optionally, torque limits.

    The trajectory is at rest at both ends and at the path's sharp corners. Its velocities and accelerations
    are within the limits at all times of its (quintic) interpolation. The trajectory follows the path except
    for the smoothing, see `smoothing_deviation`.

    Args:
        path: the path.
        joint_names: names of the n joints.
        velocity, acceleration: limits (n,) [rad/s], [rad/s^2], already scaled.
        settings: sample time and smoothing.
        torque: model of the torque limits; None for no torque limits.
    Raises:
        InputError: a limit is not positive and finite.
        TorqueLimitError: a joint cannot even hold still at some point of the path.
    """
    velocity = checked_limits(velocity, "velocity", joint_names)
    acceleration = checked_limits(acceleration, "acceleration", joint_names)
    if path.length == 0.0:
        return zero_length_trajectory(path, joint_names)
    motion = fastest_motion(path, joint_names, velocity, acceleration, settings, torque)
    times, q, v, a = moving_average.sample_moving_average(
        path.points[0], path.points[-1], path.arrays, motion, settings.sample_time, settings.smoothing
    )
    peak_v, peak_a = moving_average.peaks(times, q, v, a, velocity, acceleration)
    over = max(peak_v, np.sqrt(peak_a))
    if torque is not None:
        over = max(over, _slowdown(torque, q, v, a))
    if over > 1.0:
        times, v, a = times * over, v / over, a / over**2
    return JointTrajectory(joint_names, times, q, v, a)


def smoothing_deviation(acceleration: ArrayLike, settings: TimingSettings) -> Array:
    """Return a bound (n,) [rad] on how far the smoothing in `parameterize` moves each joint off the path.

    The bound is a w^2 / 24 for the acceleration limit a and the smoothing window w.
    """
    return np.asarray(acceleration, dtype=float) * settings.smoothing**2 / 24


def fastest_motion(
    path: BlendedPath,
    joint_names: tuple[str, ...],
    velocity: Array,
    acceleration: Array,
    settings: TimingSettings,
    torque: TorqueModel | None = None,
) -> tuple[Any, Any, Any, Any, Any]:
    """Compute the fastest motion along a blended path, which is the time parameterization of the path before
    smoothing and sampling.

    Returns:
        The arrays that `topp.fastest` returns.
    Raises:
        TorqueLimitError: a joint cannot even hold still at some point of the path.
    """
    line_step = 0.0 if torque is None else settings.torque_grid
    piece, begin, end = topp.grid(path.kind, path.lengths, path.turn, line_step)
    if torque is None:
        rows, limit = np.empty((0, 2, 3, len(velocity))), velocity  # placeholders, unused
    else:
        limit = TORQUE_SHARE * checked_limits(torque.limits, "effort", joint_names)
        # Grid points, piece by piece: interval i begins at point i + piece[i] and ends at the next.
        at = np.arange(len(piece)) + piece
        place, on = np.empty(at[-1] + 2), np.empty(at[-1] + 2, dtype=np.int64)
        place[at], place[at + 1], on[at], on[at + 1] = begin, end, piece, piece
        rows = torque.torque_coefficients(*path.evaluate(on, place))
        still = np.abs(rows[:, 2]) / limit
        if still.max() > 1.0:
            i, joint = np.unravel_index(np.argmax(still), still.shape)
            raise TorqueLimitError(
                joint_names[joint], abs(float(rows[i, 2, joint])), float(torque.limits[joint]),
                float(path.starts[on[i]] + place[i]) / path.length,
            )  # fmt: skip
        rows = np.stack([rows[at], rows[at + 1]], axis=1)
    return topp.fastest(
        path.arrays, path.rests, piece, begin, end, velocity, ACCELERATION_SHARE * acceleration, rows, limit
    )


def _slowdown(torque: TorqueModel, q: Array, v: Array, a: Array) -> float:
    """Return the factor by which a trajectory must be slowed down after time parameterization, so that it
    respects the torque limits.

    The part of a torque beyond the torque for holding still is proportional to the squared speed.
    """
    still = np.zeros_like(q)
    holding = torque.torques(q, still, still)
    moving = torque.torques(q, v, a) - holding
    room = (TORQUE_SHARE + 0.01) * torque.limits - holding * np.sign(moving)
    return float(np.sqrt(np.max(np.abs(moving) / room)))


def zero_length_trajectory(path: BlendedPath, joint_names: tuple[str, ...]) -> JointTrajectory:
    """Return the time parameterization of a path of length zero: a trajectory with a single point."""
    return stationary_trajectory(joint_names, path.points[0])


def checked_limits(values: ArrayLike, kind: str, joint_names: tuple[str, ...]) -> Array:
    """Check one kind of joint limits for the time parameterization, and return them as a finite array (n,).

    Raises:
        InputError: a limit is missing, not positive or not finite.
    """
    # a copy, because the compiled code requires writable arrays
    limits = np.array(float_array(values, None, f"{kind} limits", finite=False))
    if limits.shape != (len(joint_names),):
        raise InputError(f"{limits.shape} {kind} limits given for {len(joint_names)} joints")
    good = (limits > 0.0) & (limits < np.inf)
    if not good.all():
        raise InputError(
            f"joint {joint_names[int(np.argmin(good))]!r} has no {kind} limit",
            hint="give one in the robot's joint_limits.yaml",
        )
    return limits
