"""A timed motion as straight pieces on a common clock, with a proven bound of what they leave out (Numba)."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from armcell.core import InputError, JointTrajectory

Array = NDArray[np.float64]


def positions_at(trajectory: JointTrajectory, times: Array) -> Array:
    """Positions (k, n) at times (k,) [s] of the trajectory's clock, held at both ends; as `sample`."""
    v, a = trajectory.velocities, trajectory.accelerations
    kind = 0 if v is None else 1 if a is None else 2
    none = np.zeros((0, 0))
    return _positions(
        np.ascontiguousarray(times, dtype=np.float64), trajectory.times, trajectory.positions,
        none if v is None else v, none if a is None else a, kind,
    )  # fmt: skip


def acceleration_bounds(trajectory: JointTrajectory) -> Array:
    """The most that each joint (n,) accelerates anywhere between the points; 0 for straight pieces.

    A polynomial is within its Bernstein coefficients; those of the second derivative are taken.
    """
    p, v, a = trajectory.positions, trajectory.velocities, trajectory.accelerations
    if v is None or len(p) < 2:
        return np.zeros(p.shape[1])
    h = np.diff(trajectory.times)[:, None]
    if a is None:
        b = [p[:-1], p[:-1] + h * v[:-1] / 3, p[1:] - h * v[1:] / 3, p[1:]]
    else:
        b = [
            p[:-1], p[:-1] + h * v[:-1] / 5, p[:-1] + 2 * h * v[:-1] / 5 + h**2 * a[:-1] / 20,
            p[1:] - 2 * h * v[1:] / 5 + h**2 * a[1:] / 20, p[1:] - h * v[1:] / 5, p[1:],
        ]  # fmt: skip
    n = len(b) - 1
    second = [np.abs(b[i + 2] - 2 * b[i + 1] + b[i]) * n * (n - 1) / h**2 for i in range(n - 1)]
    return np.max(second, axis=(0, 1))


def chords(
    trajectories: tuple[JointTrajectory, ...], starts: tuple[float, ...], begin: float, end: float,
    error: float = 5e-4,
) -> tuple[Array, Array, Array]:  # fmt: skip
    """Several motions on one clock as straight pieces.

    Args:
        starts: when each motion begins [s of the common clock]; before and after it stands still.
        begin, end: the part of the common clock that is wanted.
        error: about the most that a joint may be off the pieces [rad or m].
    Returns:
        Times (k,), positions (k, n) of all joints side by side, and a bound (n,) of each joint's error.
    Raises:
        InputError: a motion whose velocity jumps (none given, or not at rest at its ends).
    """
    for t in trajectories:
        _check_smooth(t)
    most = [acceleration_bounds(t) for t in trajectories]
    largest = max((float(m.max(initial=0.0)) for m in most), default=0.0)
    step = np.sqrt(8 * error / largest) if largest > 0 else np.inf
    count = max(int(np.ceil((end - begin) / step)), 1) if end > begin else 1
    times = np.linspace(begin, max(end, begin), count + 1)
    h = times[1] - times[0]
    points = np.hstack([positions_at(t, times - s) for t, s in zip(trajectories, starts, strict=True)])
    return times, points, np.concatenate(most) * h**2 / 8


def _check_smooth(trajectory: JointTrajectory) -> None:
    if len(trajectory.times) == 0:
        raise InputError("an empty trajectory has no position at any time")
    v = trajectory.velocities
    if len(trajectory.times) == 1:
        return
    if v is None or max(np.abs(v[0]).max(initial=0.0), np.abs(v[-1]).max(initial=0.0)) > 1e-6:
        raise InputError(
            "the trajectory does not begin and end at rest with velocities given", cure="time it with armcell"
        )


@njit(cache=True)
def _positions(at, times, p, v, a, kind):
    n, last = p.shape[1], len(times) - 1
    out, i = np.empty((len(at), n)), 0
    for k in range(len(at)):
        t = at[k]
        if t <= times[0] or last == 0:
            out[k] = p[0]
            continue
        if t >= times[last]:
            out[k] = p[last]
            continue
        if times[i] > t:
            i = 0
        while times[i + 1] <= t:
            i += 1
        h, s = times[i + 1] - times[i], t - times[i]
        for j in range(n):
            d = p[i + 1, j] - p[i, j]
            if kind == 0:
                out[k, j] = p[i, j] + d * s / h
                continue
            v0, v1 = v[i, j], v[i + 1, j]
            if kind == 1:
                c2, c3 = (3 * d / h - 2 * v0 - v1) / h, (v0 + v1 - 2 * d / h) / h**2
                out[k, j] = p[i, j] + s * (v0 + s * (c2 + s * c3))
                continue
            a0, a1 = a[i, j], a[i + 1, j]
            c3 = (20 * d - (8 * v1 + 12 * v0) * h - (3 * a0 - a1) * h**2) / (2 * h**3)
            c4 = (-30 * d + (14 * v1 + 16 * v0) * h + (3 * a0 - 2 * a1) * h**2) / (2 * h**4)
            c5 = (12 * d - 6 * (v1 + v0) * h + (a1 - a0) * h**2) / (2 * h**5)
            out[k, j] = p[i, j] + s * (v0 + s * (a0 / 2 + s * (c3 + s * (c4 + s * c5))))
    return out


__all__ = ["acceleration_bounds", "chords", "positions_at"]
