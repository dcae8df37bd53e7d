"""What joints shall do at every tick of a motion, worked out for many ticks at once."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

AHEAD = 2.0  # [s]


class Targets:
    """Targets for `SimWorld.follow`.

    Attributes:
        steps: physics steps of a tick.
    """

    def __init__(self, wanted: Callable[[Array], tuple[Array, Array]], timestep: float, steps: int):
        """
        Args:
            wanted: positions and velocities (k, n), finite, for the ticks that begin at times (k,) [s].
            timestep: of physics [s].
        """
        self._wanted, self._dt, self.steps = wanted, timestep, steps
        self._times: list[float] = []
        self._rows = np.zeros((0, 0))

    def between(self, now: float, until: float) -> Array:
        """Positions and velocities side by side (k, 2n) of the ticks from now on that begin before a time
        [s]; at least of one."""
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
        times = np.cumsum(steps)[:: self.steps]  # one by one, as the engine adds them up
        self._times = times.tolist()
        self._rows = np.concatenate(self._wanted(times), axis=1)
