"""The driver's heart: signs of life to the robots, and the regular look at how they are."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

BEAT = 0.01  # [s] between beats
OVERSLEPT = 3 * BEAT
WAKING = 0.02  # [s] the receiving threads get to catch up after this process was held up


class Heart:
    """Calls `beat` every BEAT seconds from a thread of its own."""

    def __init__(self, beat: Callable[[], None]):
        self._beat = beat
        self._last = self._awake_since = time.monotonic()
        self._beating = False

    def start(self) -> None:
        self._beating = True
        self._thread = threading.Thread(target=self._run, name="ur heart", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        self._beating = False
        self._thread.join(timeout=1.0)

    def _run(self) -> None:
        while self._beating:
            now = time.monotonic()
            if now - self._last > OVERSLEPT:
                self._awake_since = now
            self._last = now
            self._beat()
            time.sleep(BEAT)

    @property
    def awake(self) -> bool:
        """Whether this process was not held up just now, so that an old state is the robot's or network's.

        While it is held up no sign of life leaves it, and the robots' own watchdogs stop them.
        """
        now = time.monotonic()
        return now - self._last < OVERSLEPT and now - self._awake_since > WAKING
