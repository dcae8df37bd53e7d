"""Preview player that advances a motion in real time in its own thread."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable

logger = logging.getLogger(__name__)

FRAME = 1 / 30  # [s]
PAUSE = 0.5  # [s] at the end, before the next repetition


class Player:
    """Player for a motion preview.
    It calls `show` in real time with times [s] from 0 to the duration of the motion.

    Args:
        show: draws the motion at a time [s]; called from the player's thread.
        loop: returns True to restart at the end.
        end: called at the end if the player does not restart.
    """

    def __init__(self, show: Callable[[float], None], loop: Callable[[], bool], end: Callable[[], None]):
        self._show, self._loop, self._end = show, loop, end
        self._wake = threading.Condition()
        self._duration: float | None = None
        self._at: float | None = None  # time [s] to show once
        self._closing = False
        self._thread = threading.Thread(target=self._run, name="armcell-preview", daemon=True)
        self._thread.start()

    def play(self, duration: float) -> None:
        """Play the preview of a motion from the beginning. The motion takes `duration` [s]."""
        with self._wake:
            self._duration = duration
            self._wake.notify()

    def seek(self, t: float) -> None:
        """Stop the player of the preview and show the motion at a time [s]."""
        with self._wake:
            self._duration, self._at = None, t
            self._wake.notify()

    def stop(self) -> None:
        with self._wake:
            self._duration = None
            self._wake.notify()

    @property
    def playing(self) -> bool:
        return self._duration is not None

    def close(self) -> None:
        with self._wake:
            self._closing, self._duration = True, None
            self._wake.notify()
        self._thread.join(timeout=5.0)

    def _run(self) -> None:
        while True:
            with self._wake:
                self._wake.wait_for(
                    lambda: self._closing or self._duration is not None or self._at is not None
                )
                if self._closing:
                    return
                duration, at, self._at = self._duration, self._at, None
            try:
                if duration is not None:
                    self._once(duration)
                elif at is not None:
                    self._show(at)
            except Exception:
                logger.exception("could not show the motion")
                self.stop()

    def _once(self, duration: float) -> None:
        began = time.monotonic()
        while self._duration == duration:
            t = time.monotonic() - began
            if t >= duration:
                self._show(duration)
                self._pause(PAUSE, duration)
                if self._duration == duration and not self._loop():
                    self.stop()
                    self._end()
                return
            self._show(t)
            self._pause(FRAME, duration)

    def _pause(self, seconds: float, duration: float) -> None:
        with self._wake:
            self._wake.wait_for(lambda: self._duration != duration, timeout=seconds)
