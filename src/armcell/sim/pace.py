"""Synchronization of simulation time with the wall clock."""

from __future__ import annotations

import time
from collections.abc import Callable

from armcell._interrupts import sleep
from armcell.core import InputError


class Pacer:
    """Pacer that lets a simulation run in lock-step with its caller or at a multiple of real time.

    With `time_scale` None the simulation runs in lock-step and never waits; a scale of 2.0 is twice real
    time. The clock starts at the first `wait_until`. If the simulation falls more than `MAX_LAG_S` behind,
    the pacer shifts its clock by the excess lag, so the simulation does not catch up in a rush.
    """

    MAX_LAG_S = 0.1

    def __init__(self, time_scale: float | None = None, clock: Callable[[], float] = time.monotonic,
                 sleep: Callable[[float], None] = sleep):  # fmt: skip
        if time_scale is not None and not 0 < time_scale < float("inf"):
            raise InputError(f"time scale is {time_scale}, it must be above 0 (None: do not wait)")
        self.time_scale = time_scale
        self._clock, self._sleep = clock, sleep
        self._zero: float | None = None  # wall time of simulation time 0

    def reset(self) -> None:
        """Reset the wall clock for pacing a simulation. It starts again at the next `wait_until`."""
        self._zero = None

    def wait_until(self, sim_time: float) -> float:
        """Sleep until the wall clock has caught up with a time [s] of the paced simulation.
        Return the time slept [s].
        """
        if self.time_scale is None:
            return 0.0
        now = self._clock()
        wall = sim_time / self.time_scale
        if self._zero is None:
            self._zero = now - wall
        ahead = self._zero + wall - now
        if ahead > 0:
            self._sleep(ahead)
            return ahead
        if -ahead > self.MAX_LAG_S:
            self._zero += -ahead - self.MAX_LAG_S
        return 0.0
