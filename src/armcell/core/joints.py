"""Joint-space states, paths and trajectories, each with its joint names.

At interfaces, `reindexed` converts values to another joint order.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.core.checks import float_array, is_number
from armcell.core.errors import InputError, UnknownNameError

Array = NDArray[np.float64]
Names = tuple[str, ...]


def _columns(have: Names, want: Iterable[str]) -> list[int]:
    at = {name: i for i, name in enumerate(have)}
    try:
        return [at[name] for name in want]
    except KeyError as missing:
        raise UnknownNameError("joint", missing.args[0], have) from None


def all_finite(values: Array) -> bool:
    """Return whether all values (n,) of a joint state are finite; for small n, this is faster than NumPy."""
    return math.isfinite(values.dot(values)) or bool(np.isfinite(values).all())


@dataclass(frozen=True, eq=False)
class JointState:
    """State of named joints: their positions [rad or m] and, if known, their velocities.

    Velocities are in rad/s or m/s.
    """

    joint_names: Names
    positions: Array  # (n,)
    velocities: Array | None = None  # (n,)
    efforts: Array | None = None  # (n,) [Nm or N]
    time: float = 0.0  # [s]

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
        joint_names: Names, positions: Array, velocities: Array | None = None, efforts: Array | None = None,
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
    """Path in joint space: waypoints that are connected by straight segments, without timing."""

    joint_names: Names
    waypoints: Array  # (k, n) [rad or m]

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
        """Return the length [rad] of a path in joint space, the sum of the Euclidean lengths of its
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
    times: Array  # (k,) [s], from the start, strictly increasing
    positions: Array  # (k, n)
    velocities: Array | None = None  # (k, n)
    accelerations: Array | None = None  # (k, n)

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

    def sample(self, t: float) -> tuple[Array, Array, Array]:
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

    def samples(self, times: ArrayLike) -> tuple[Array, Array, Array]:
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

    def _between(self, i: Any, s: Any, h: Sequence[Any]) -> tuple[Array, Array, Array]:
        """Evaluate position, velocity and acceleration of a joint trajectory at a time s [s] after its point
        i.

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
