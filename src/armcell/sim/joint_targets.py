"""Joint targets for every tick of a motion, sampled in batches ahead of time."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

AHEAD = 2.0  # [s] length of a batch


class JointTargets:
    """Joint targets of a simulated motion at every tick, sampled ahead of time in batches.

    Attributes:
        steps: physics steps per tick.
    """

    def __init__(self, wanted: Callable[[Array], tuple[Array, Array]], timestep: float, steps: int):
        """Store the function that yields the joint targets of a motion.

        Args:
            wanted: function from times (k,) [s], at which ticks begin, to finite positions and velocities (k,
                n).
            timestep: physics time step [s].
            steps: physics steps per tick.
        """
        self._wanted, self._dt, self.steps = wanted, timestep, steps
        self._times: list[float] = []
        self._rows = np.zeros((0, 0))

    def between(self, now: float, until: float) -> Array:
        """Return the joint targets (k, 2n) of a simulated motion for all
        ticks that start in the interval [`now`, `until`) [s].

        Each row holds the positions, then the velocities. The result has at least one row.
        """
        times = self._times
        first = bisect_left(times, now)
        if first == len(times) or times[first] != now or times[-1] < until:
            self._look_ahead(now, max(until, now + AHEAD))
            times, first = self._times, 0
        end = max(bisect_left(times, until, first), first + 1)
        return self._rows[first:end]

    def _look_ahead(self, now: float, end: float) -> None:
        count = int((end - now) / (self._dt * self.steps)) + 2
        steps = np.full(count * self.steps, self._dt)
        steps[0] = now
        times = np.cumsum(steps)[:: self.steps]  # adds step by step like MuJoCo, so the rounding is the same
        self._times = times.tolist()
        self._rows = np.concatenate(self._wanted(times), axis=1)
