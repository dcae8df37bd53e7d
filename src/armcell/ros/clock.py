"""The clock of the message bus: wall-clock time, or simulation time that a caller sets."""

from __future__ import annotations

import threading
import time

from armcell.core.checks import require


class Clock:
    """Clock of the message bus. It returns Unix time in seconds, or simulation time once `set` has been
    called.
    """

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._simulated: float | None = None

    @property
    def is_simulated(self) -> bool:
        return self._simulated is not None

    def now(self) -> float:
        """Return the current time [s] of the bus's clock: simulation time if it was set, otherwise Unix
        time.
        """
        simulated = self._simulated
        return time.time() if simulated is None else simulated

    def set(self, seconds: float) -> None:
        """Set the clock of the message bus to `seconds`. From now on, the clock shows simulation time.

        Time may jump backward, for example when the simulation is reset.
        """
        require(0 <= seconds < float("inf"), f"time is {seconds}, it must be 0 s or later")
        with self._changed:
            self._simulated = float(seconds)
            self._changed.notify_all()

    def wait_until(self, seconds: float, timeout: float | None = None) -> bool:
        """Wait until the clock of the message bus reaches the time `seconds` [s].

        Args:
            seconds: target time on this clock.
            timeout: longest wait in wall-clock time [s]; None waits forever.
        Returns:
            True if the clock reached the target, False if the timeout expired first.
        """
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
