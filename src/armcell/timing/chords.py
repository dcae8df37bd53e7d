"""Approximation of timed motions by straight pieces on a common clock (Numba).

Each joint's approximation error has a proven bound.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from armcell.core import InputError, JointTrajectory

Array = NDArray[np.float64]

_NONE = np.zeros((0, 0))


def positions_at(trajectory: JointTrajectory, times: Array) -> Array:
    """Return the joint positions (k, n) of a trajectory at trajectory times (k,) [s]. Chords (straight
    pieces) between these positions approximate the trajectory.

    Before the first point and after the last, the joints hold their positions, as in `sample`.
    """
    return _positions(np.ascontiguousarray(times, dtype=np.float64), *_arrays(trajectory))


def _arrays(trajectory: JointTrajectory) -> tuple[Array, Array, Array, Array, int]:
    """Return a trajectory's times, positions, velocities, accelerations and interpolation kind, to
    approximate the trajectory by chords.

    The kind is 0 for positions only, 1 with velocities, 2 with velocities and accelerations.
    """
    v, a = trajectory.velocities, trajectory.accelerations
    kind = 0 if v is None else 1 if a is None else 2
    return trajectory.times, trajectory.positions, _NONE if v is None else v, _NONE if a is None else a, kind


def acceleration_bounds(trajectory: JointTrajectory) -> Array:
    """Return an upper bound (n,) on each joint's acceleration in a trajectory. This bound limits the error
    when chords (straight pieces) approximate the trajectory.

    A polynomial is bounded by its Bernstein coefficients; the bound uses those of the second derivative.
    Straight pieces have the bound 0.
    """
    return _accelerations(*_arrays(trajectory))


def chords(
    trajectories: tuple[JointTrajectory, ...], starts: tuple[float, ...], begin: float, end: float,
    error: float = 5e-4,
) -> tuple[Array, Array, Array]:  # fmt: skip
    """Approximate several motions on a common clock by straight pieces (chords).

    Args:
        starts: start of each motion [s of the common clock]; its joints rest before and after the motion.
        begin, end: section of the common clock to approximate [s].
        error: approximate maximum deviation of a joint from the pieces [rad or m].
    Returns:
        Times (k,), positions (k, n) of all joints side by side, and a bound (n,) of each joint's error.
    Raises:
        InputError: a motion's velocity jumps (it has no velocities, or is not at rest at its ends).
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
            "the trajectory does not begin and end at rest with velocities given", hint="time it with armcell"
        )


@njit(cache=True)
def _accelerations(times, p, v, a, kind):
    n = 3 if kind == 1 else 5
    most, b = np.zeros(p.shape[1]), np.empty(n + 1)
    if kind == 0:
        return most
    for i in range(len(times) - 1):
        h = times[i + 1] - times[i]
        for j in range(p.shape[1]):
            b[0], b[1] = p[i, j], p[i, j] + h * v[i, j] / n
            b[n - 1], b[n] = p[i + 1, j] - h * v[i + 1, j] / n, p[i + 1, j]
            if kind == 2:
                b[2] = p[i, j] + 2 * h * v[i, j] / n + h * h * a[i, j] / 20
                b[3] = p[i + 1, j] - 2 * h * v[i + 1, j] / n + h * h * a[i + 1, j] / 20
            for k in range(n - 1):
                second = abs(b[k + 2] - 2 * b[k + 1] + b[k]) * n * (n - 1) / (h * h)
                most[j] = max(most[j], second)
    return most


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
