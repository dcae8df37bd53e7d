"""Fast evaluation of a trajectory at many increasing times."""

from __future__ import annotations

from bisect import bisect_right
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.core.checks import float_array
from armcell.core.errors import InputError
from armcell.core.joints import JointTrajectory

Array = NDArray[np.float64]
T = TypeVar("T", float, Array)


class Playback:
    """Fast evaluator for playing back a trajectory: it returns the positions and velocities at any time.

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

    def at(self, t: float) -> tuple[Array, Array]:
        """Return the position and the velocity, each (n,),
        at a time t [s] of the trajectory that is played back.

        Before the start and after the end, the position is constant.
        """
        known, n = self._times, self._n
        if not known[0] < t < known[-1]:
            return (self._first if t <= known[0] else self._last).copy(), np.zeros(n)
        i = bisect_right(known, t) - 1
        both = np.array(_powers(t - known[i])) @ self._coefficients[i]
        return both[:n], both[n:]

    def at_times(self, times: ArrayLike) -> tuple[Array, Array]:
        """Return the positions and velocities, each (k, n),
        at several times (k,) [s] of the trajectory that is played back.

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
