"""Worker thread that processes only the newest request, e.g. of a dragged control."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable

logger = logging.getLogger(__name__)


class LatestTaskWorker:
    """Worker thread that runs only the latest function submitted under each name.
    Older functions that have not started yet are dropped.
    """

    def __init__(self) -> None:
        self._wake = threading.Condition()
        self._waiting: dict[str, Callable[[], None]] = {}
        self._closing = False
        self._thread = threading.Thread(target=self._run, name="armcell-latest", daemon=True)
        self._thread.start()

    def submit(self, name: str, work: Callable[[], None]) -> None:
        with self._wake:
            self._waiting[name] = work
            self._wake.notify()

    def close(self) -> None:
        with self._wake:
            self._closing = True
            self._wake.notify()
        self._thread.join(timeout=5.0)

    def _run(self) -> None:
        while True:
            with self._wake:
                self._wake.wait_for(lambda: self._closing or self._waiting)
                if self._closing:
                    return
                work = self._waiting.pop(next(iter(self._waiting)))
            try:
                work()
            except Exception:  # the next request may succeed
                logger.exception("could not follow a drag")
