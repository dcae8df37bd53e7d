"""Heartbeat of real arms: keep-alive signals to the robots and periodic safety checks."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

BEAT = 0.01  # [s] between beats


class Heartbeat:
    """Heartbeat: a thread that calls a keep-alive or safety function every `BEAT` seconds."""

    def __init__(self, beat: Callable[[], None]):
        self._beat = beat
        self._beating = False

    def start(self) -> None:
        self._beating = True
        self._thread = threading.Thread(target=self._run, name="heartbeat", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        self._beating = False
        self._thread.join(timeout=1.0)

    @property
    def beats(self) -> bool:
        return self._thread.is_alive()

    def _run(self) -> None:
        while self._beating:
            self._beat()
            time.sleep(BEAT)
