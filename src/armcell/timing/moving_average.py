"""Smoothing of piecewise linear motions by a moving average over a time window.

The average keeps every speed limit. Its acceleration is the change of speed over the window, divided by the
window, so a long enough window keeps every acceleration limit. At a corner, the average deviates from the
pieces by at most window * (change of speed) / 8. Between its points the average is exactly quadratic, so
cubic interpolation is exact.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.core import InputError, JointTrajectory

Array = NDArray[np.float64]

SAME = 1e-7  # [s] times with a smaller difference count as equal
GROWTH = 1.15


def smooth_by_moving_average(
    joint_names: tuple[str, ...], times: ArrayLike, points: ArrayLike, acceleration: ArrayLike,
    longest: float = 4.0,
) -> JointTrajectory:  # fmt: skip
    """Smooth a piecewise linear motion by a moving average, and return it as a trajectory within the
    acceleration limits.

    The trajectory is as fast as the given motion and takes one averaging window longer. Its time 0 is half a
    window before the start of the given motion.

    Args:
        joint_names: names of the n joints.
        times, points: (k,) increasing times [s] and (k, n) positions of the given motion.
        acceleration: (n,) limits [rad/s^2].
        longest: maximum length of the window [s].
    Raises:
        InputError: no window up to `longest` keeps the limits, because the given motion is too fast.
    """
    t, p = np.asarray(times, dtype=float), np.asarray(points, dtype=float)
    limit = np.asarray(acceleration, dtype=float)
    t = t - t[0]
    speeds = np.diff(p, axis=0) / np.diff(t)[:, None] if len(t) > 1 else np.zeros((0, p.shape[1]))
    window = max(float(np.max(np.abs(speeds) / limit, initial=0.0)), 0.01)
    while window <= longest:
        found = _averaged(t, p, speeds, window)
        change = np.abs(np.diff(found[2], axis=0)) / np.maximum(np.diff(found[0])[:, None], 1e-12)
        if np.all(change <= limit * (1 + 1e-9)):
            return JointTrajectory(joint_names, found[0], found[1], found[2])
        window *= GROWTH
    raise InputError(f"no window up to {longest:g} s keeps the acceleration limits")


def _averaged(t: Array, p: Array, speeds: Array, window: float) -> tuple[Array, Array, Array]:
    knots = np.unique(np.concatenate([t, t + window]))
    knots = knots[np.concatenate([[True], np.diff(knots) > SAME])]
    area = np.concatenate(
        [np.zeros((1, p.shape[1])), np.cumsum((p[1:] + p[:-1]) / 2 * np.diff(t)[:, None], axis=0)]
    )

    def integral(x: Array) -> Array:
        """Return the integral of a piecewise linear motion from time 0 to `x`; a moving average is the
        difference of two such integrals.
        """
        k = np.clip(np.searchsorted(t, x, side="right") - 1, 0, len(t) - 1)
        e = np.clip(x, t[0], t[-1]) - t[k]
        v = speeds[np.minimum(k, len(speeds) - 1)] if len(speeds) else np.zeros((len(x), p.shape[1]))
        inside = area[k] + p[k] * e[:, None] + v * (e**2)[:, None] / 2
        outside = np.where((x < t[0])[:, None], p[0], p[-1]) * (x - np.clip(x, t[0], t[-1]))[:, None]
        return inside + outside

    def position(x: Array) -> Array:
        return np.column_stack([np.interp(x, t, column) for column in p.T])

    q = (integral(knots) - integral(knots - window)) / window
    v = (position(knots) - position(knots - window)) / window
    q[0], q[-1] = p[0], p[-1]
    v[0] = v[-1] = 0.0
    return knots, q, v
