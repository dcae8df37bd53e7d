"""Joint-space states, paths and trajectories, and fast playback of a trajectory at increasing times.

Each value has its joint names. At interfaces, `reindexed` converts values to another joint order.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.core.checks import float_array, is_number
from armcell.core.errors import InputError, UnknownNameError

F64 = NDArray[np.float64]
Names = tuple[str, ...]
T = TypeVar("T", float, F64)


def _columns(have: Names, want: Iterable[str]) -> list[int]:
    at = {name: i for i, name in enumerate(have)}
    try:
        return [at[name] for name in want]
    except KeyError as missing:
        raise UnknownNameError("joint", missing.args[0], have) from None


def all_finite(values: F64) -> bool:
    """Return whether all values (n,) of a joint state are finite. For small n, this is faster than NumPy."""
    return math.isfinite(values.dot(values)) or bool(np.isfinite(values).all())


@dataclass(frozen=True, eq=False)
class JointState:
    """State of named joints: their positions [rad or m] and, if known, their velocities.

    Velocities are in rad/s or m/s.
    """

    joint_names: Names
    positions: F64  # (n,)
    velocities: F64 | None = None  # (n,)
    efforts: F64 | None = None  # (n,) [Nm or N]
    time: float = 0.0  # [s]
    WRITTEN_AS: ClassVar[str] = 'JointState.from_mapping({"joint_1": 0.5})'

    def __post_init__(self) -> None:
        n = len(self.joint_names)
        if len(set(self.joint_names)) != n:
            twice = next(name for name in self.joint_names if self.joint_names.count(name) > 1)
            raise InputError(f"joint {twice!r} is named twice")
        for label in ("positions", "velocities", "efforts"):
            values = getattr(self, label)
            if values is None:
                continue
            values = np.array(values, dtype=float)  # a copy: the value owns its numbers
            if values.shape != (n,):
                raise InputError(f"{label} has shape {values.shape}, {n} joints need ({n},)")
            if not all_finite(values):
                bad = [name for name, v in zip(self.joint_names, values, strict=True) if not np.isfinite(v)]
                raise InputError(f"{label} of {', '.join(bad)} is not finite")
            object.__setattr__(self, label, values)

    @staticmethod
    def unchecked(
        joint_names: Names, positions: F64, velocities: F64 | None = None, efforts: F64 | None = None,
        time: float = 0.0,
    ) -> JointState:  # fmt: skip
        """Create a joint state without checking or copying the arrays, for drivers with high sample rates."""
        state = object.__new__(JointState)
        state.__dict__.update(
            joint_names=joint_names, positions=positions, velocities=velocities, efforts=efforts, time=time
        )
        return state

    @staticmethod
    def from_mapping(values: Mapping[str, float]) -> JointState:
        return JointState(tuple(values), np.array(list(values.values()), dtype=float))

    def reindexed(self, joint_names: Iterable[str]) -> JointState:
        """Return a joint state with its joints in a different order, or reduced to some of its joints.

        Raises:
            UnknownNameError: this state does not have the joint.
        """
        names = tuple(joint_names)
        cols = self.columns(names)
        pick = lambda a: None if a is None else a[cols]  # noqa: E731
        return JointState(names, self.positions[cols], pick(self.velocities), pick(self.efforts), self.time)

    def columns(self, joint_names: Iterable[str]) -> list[int]:
        """Return the indices at which the given joints are stored in the arrays of a joint state.

        Raises:
            UnknownNameError: this state does not have the joint.
        """
        return _columns(self.joint_names, joint_names)

    def updated(self, other: JointState) -> JointState:
        """Return a copy of a joint state with the positions of some joints replaced by those in another
        state.
        """
        positions = self.positions.copy()
        positions[_columns(self.joint_names, other.joint_names)] = other.positions
        return JointState(self.joint_names, positions, time=other.time or self.time)

    def as_dict(self) -> dict[str, float]:
        return dict(zip(self.joint_names, self.positions.tolist(), strict=True))

    def __getitem__(self, joint_name: str) -> float:
        return float(self.positions[_columns(self.joint_names, (joint_name,))[0]])


@dataclass(frozen=True, eq=False)
class JointPath:
    """Joint path: waypoints in joint space that are connected by straight segments, without timing."""

    joint_names: Names
    waypoints: F64  # (k, n) [rad or m]

    def __post_init__(self) -> None:
        waypoints = np.array(self.waypoints, dtype=float)
        if waypoints.ndim != 2 or waypoints.shape[1] != len(self.joint_names) or len(waypoints) == 0:
            raise InputError(
                f"waypoints have shape {waypoints.shape}, need (k, {len(self.joint_names)}), k >= 1"
            )
        if not np.all(np.isfinite(waypoints)):
            raise InputError("a waypoint has a value that is not finite")
        object.__setattr__(self, "waypoints", waypoints)

    @property
    def length(self) -> float:
        """Return the length [rad] of a joint path, which is the sum of the Euclidean lengths of its
        segments.
        """
        return float(np.linalg.norm(np.diff(self.waypoints, axis=0), axis=1).sum())

    def reversed(self) -> JointPath:
        return replace(self, waypoints=self.waypoints[::-1])


@dataclass(frozen=True, eq=False)
class JointTrajectory:
    """Timed motion of joints (joint trajectory), optionally with velocities and accelerations, as in ROS's
    trajectory_msgs.
    """

    joint_names: Names
    times: F64  # (k,) [s], from the start, strictly increasing
    positions: F64  # (k, n)
    velocities: F64 | None = None  # (k, n)
    accelerations: F64 | None = None  # (k, n)

    def __post_init__(self) -> None:
        times = np.array(self.times, dtype=float)
        k, n = len(times), len(self.joint_names)
        if times.ndim != 1 or not np.isfinite(times).all():
            raise InputError("trajectory times must be one list of finite numbers")
        if not (times[1:] > times[:-1]).all():
            i = int(np.argmax(np.diff(times) <= 0))
            raise InputError(
                f"trajectory time goes from {times[i]:g} s to {times[i + 1]:g} s: it must increase"
            )
        object.__setattr__(self, "times", times)
        for label in ("positions", "velocities", "accelerations"):
            values = getattr(self, label)
            if values is None:
                continue
            values = np.array(values, dtype=float)
            if values.shape != (k, n):
                raise InputError(f"trajectory {label} have shape {values.shape}, need ({k}, {n})")
            if not np.isfinite(values).all():
                raise InputError(f"trajectory {label} have a value that is not finite")
            object.__setattr__(self, label, values)

    @property
    def duration(self) -> float:
        return float(self.times[-1]) if len(self.times) else 0.0

    @property
    def start(self) -> JointState:
        return JointState(self.joint_names, self.positions[0])

    @property
    def end(self) -> JointState:
        return JointState(self.joint_names, self.positions[-1])

    def reindexed(self, joint_names: Iterable[str]) -> JointTrajectory:
        """Return a joint trajectory with its joints in a different order, or reduced to some of its joints.

        Raises:
            UnknownNameError: this trajectory does not have the joint.
        """
        names = tuple(joint_names)
        if names == self.joint_names:
            return self
        cols = _columns(self.joint_names, names)
        pick = lambda a: None if a is None else a[:, cols]  # noqa: E731
        return JointTrajectory(
            names, self.times, self.positions[:, cols], pick(self.velocities), pick(self.accelerations)
        )

    def sample(self, t: float) -> tuple[F64, F64, F64]:
        """Return the position, velocity and acceleration, each (n,), of a joint trajectory at a time t [s].

        Before the start and after the end, the position is constant.

        The interpolation is quintic with accelerations, cubic with velocities only, otherwise linear (as in
        ROS's joint_trajectory_controller).
        """
        times, n = self.times, len(self.joint_names)
        if len(times) == 0:
            raise InputError("an empty trajectory has no position at any time")
        if not is_number(t, infinite=True):
            raise InputError(f"time is {t!r}, it must be a number")
        zero = np.zeros(n)
        if t <= times[0]:
            return self.positions[0].copy(), zero, zero.copy()
        if t >= times[-1]:
            return self.positions[-1].copy(), zero, zero.copy()
        i = int(np.searchsorted(times, t, side="right")) - 1
        h = times[i + 1] - times[i]
        return self._between(i, t - times[i], [h**k for k in range(6)])

    def samples(self, times: ArrayLike) -> tuple[F64, F64, F64]:
        """Return the positions, velocities and accelerations, each (k, n), of a joint trajectory at several
        times (k,) [s].

        The values equal the results of `sample`, but take less time than single calls.
        """
        known, at = self.times, float_array(times, (None,), "times")
        if len(known) == 0:
            raise InputError("an empty trajectory has no position at any time")
        q = np.where((at <= known[0])[:, None], self.positions[0], self.positions[-1])
        v, a = np.zeros_like(q), np.zeros_like(q)
        rows = np.flatnonzero((at > known[0]) & (at < known[-1]))
        if len(rows):
            i = np.searchsorted(known, at[rows], side="right") - 1
            # powers of scalars, because powers of arrays may differ in the last bit
            powers = np.array([[h**k for k in range(6)] for h in known[i + 1] - known[i]])
            s = (at[rows] - known[i])[:, None]
            q[rows], v[rows], a[rows] = self._between(i, s, list(powers.T[:, :, None]))
        return q, v, a

    def _between(self, i: Any, s: Any, h: Sequence[Any]) -> tuple[F64, F64, F64]:
        """Evaluate the position, velocity and acceleration of a joint trajectory between points i and i + 1,
        at s seconds after point i.

        Args:
            h: powers 0 to 5 of the interval's length. For k times, s and the powers have shape (k, 1).
        """
        p0, p1 = self.positions[i], self.positions[i + 1]
        if self.velocities is None:
            v = (p1 - p0) / h[1]
            return p0 + v * s, v, np.zeros_like(p0)
        v0, v1 = self.velocities[i], self.velocities[i + 1]
        if self.accelerations is None:
            c2 = (3 * (p1 - p0) / h[1] - 2 * v0 - v1) / h[1]
            c3 = (v0 + v1 - 2 * (p1 - p0) / h[1]) / h[2]
            return (
                p0 + s * (v0 + s * (c2 + s * c3)),
                v0 + s * (2 * c2 + 3 * s * c3),
                2 * c2 + 6 * s * c3,
            )
        a0, a1 = self.accelerations[i], self.accelerations[i + 1]
        d = p1 - p0
        c3 = (20 * d - (8 * v1 + 12 * v0) * h[1] - (3 * a0 - a1) * h[2]) / (2 * h[3])
        c4 = (-30 * d + (14 * v1 + 16 * v0) * h[1] + (3 * a0 - 2 * a1) * h[2]) / (2 * h[4])
        c5 = (12 * d - 6 * (v1 + v0) * h[1] + (a1 - a0) * h[2]) / (2 * h[5])
        return (
            p0 + s * (v0 + s * (a0 / 2 + s * (c3 + s * (c4 + s * c5)))),
            v0 + s * (a0 + s * (3 * c3 + s * (4 * c4 + s * 5 * c5))),
            a0 + s * (6 * c3 + s * (12 * c4 + s * 20 * c5)),
        )


class Playback:
    """Fast evaluator for the playback of a joint trajectory: it returns the joints' positions and velocities
    at any time.

    The values agree with `JointTrajectory.sample`; accelerations are not available.

    Position and velocity are polynomials in the time since the start of an interval; the constructor computes
    the coefficients of all intervals.

    Attributes:
        duration: duration of the trajectory [s].
    """

    def __init__(self, trajectory: JointTrajectory):
        t, n = trajectory, len(trajectory.joint_names)
        if len(t.times) == 0:
            raise InputError("an empty trajectory has no position at any time")
        self._n, self._times, self.duration = n, t.times.tolist(), t.duration
        self._knots = t.times
        self._first, self._last = t.positions[0], t.positions[-1]
        p0, d = t.positions[:-1], np.diff(t.positions, axis=0)
        h = np.diff(t.times)[:, None]
        c = np.zeros((len(h), 6, n))  # of 1, s, ..., s^5
        c[:, 0] = p0
        if t.velocities is None:
            c[:, 1] = d / h
        elif t.accelerations is None:
            v0, v1 = t.velocities[:-1], t.velocities[1:]
            c[:, 1] = v0
            c[:, 2] = (3 * d / h - 2 * v0 - v1) / h
            c[:, 3] = (v0 + v1 - 2 * d / h) / h**2
        else:
            v0, v1, a0, a1 = t.velocities[:-1], t.velocities[1:], t.accelerations[:-1], t.accelerations[1:]
            c[:, 1], c[:, 2] = v0, a0 / 2
            c[:, 3] = (20 * d - (8 * v1 + 12 * v0) * h - (3 * a0 - a1) * h**2) / (2 * h**3)
            c[:, 4] = (-30 * d + (14 * v1 + 16 * v0) * h + (3 * a0 - 2 * a1) * h**2) / (2 * h**4)
            c[:, 5] = (12 * d - 6 * (v1 + v0) * h + (a1 - a0) * h**2) / (2 * h**5)
        slopes = np.zeros_like(c)
        slopes[:, :5] = c[:, 1:] * np.arange(1.0, 6.0)[:, None]
        self._coefficients = np.concatenate([c, slopes], axis=2)  # (k - 1, 6, 2n)

    def at(self, t: float) -> tuple[F64, F64]:
        """Return the joints' positions and velocities, each (n,), at a time t [s] of the joint trajectory
        that is played back.

        Before the start and after the end, the position is constant.
        """
        known, n = self._times, self._n
        if not known[0] < t < known[-1]:
            return (self._first if t <= known[0] else self._last).copy(), np.zeros(n)
        i = bisect_right(known, t) - 1
        both = np.array(_powers(t - known[i])) @ self._coefficients[i]
        return both[:n], both[n:]

    def at_times(self, times: ArrayLike) -> tuple[F64, F64]:
        """Return the joints' positions and velocities, each (k, n), at several times (k,) [s] of the joint
        trajectory that is played back.

        Before the start and after the end, the position is constant.
        """
        t, known, n = float_array(times, (None,), "times"), self._knots, self._n
        positions = np.where((t <= known[0])[:, None], self._first, self._last)
        velocities = np.zeros_like(positions)
        inside = ((known[0] < t) & (t < known[-1])).nonzero()[0]
        if len(inside):
            i = known.searchsorted(t[inside], "right") - 1
            powers = np.stack(_powers(t[inside] - known[i]), axis=1)
            both = (powers[:, None] @ self._coefficients[i])[:, 0]
            positions[inside], velocities[inside] = both[:, :n], both[:, n:]
        return positions, velocities


def _powers(s: T) -> tuple[T, T, T, T, T, T]:
    ss = s * s
    return s**0, s, ss, ss * s, ss * ss, ss * ss * s
