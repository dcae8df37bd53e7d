"""The bus's time: the wall's, or a simulation's that somebody sets."""

from __future__ import annotations

import threading
import time

from armcell.core.checks import require


class Clock:
    """Seconds since 1970, or a simulation's own seconds once `set` has been called."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._simulated: float | None = None

    @property
    def is_simulated(self) -> bool:
        return self._simulated is not None

    def now(self) -> float:
        """[s]"""
        simulated = self._simulated
        return time.time() if simulated is None else simulated

    def set(self, seconds: float) -> None:
        """Simulation time from now on. May go back: a simulation was reset."""
        require(0 <= seconds < float("inf"), f"time is {seconds}, it must be 0 s or later")
        with self._changed:
            self._simulated = float(seconds)
            self._changed.notify_all()

    def wait_until(self, seconds: float, timeout: float | None = None) -> bool:
        """Wait for this clock to show a time [s]; false when `timeout` seconds of wall time passed first."""
        give_up = None if timeout is None else time.monotonic() + timeout
        with self._changed:
            while (left := seconds - self.now()) > 0:
                wall = None if give_up is None else give_up - time.monotonic()
                if wall is not None and wall <= 0:
                    return False
                if not self.is_simulated:
                    wall = left if wall is None else min(left, wall)
                self._changed.wait(wall)
        return True
