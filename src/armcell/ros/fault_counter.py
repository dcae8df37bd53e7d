"""A counter for faults in received messages, so that each kind is logged only once."""

from __future__ import annotations

import threading
from collections import Counter

MORE = "more"  # the shared kind for every new fault beyond the limit


class FaultCounter:
    """Thread-safe counter of faults in received messages. It counts each kind of fault separately.

    Args:
        most: maximum number of distinct kinds. Later kinds share one counter, so that a faulty sender can
            flood neither the log nor the memory.
    """

    def __init__(self, most: int = 100):
        self._most = most
        self._lock = threading.Lock()
        self._counts: Counter[str] = Counter()

    def count(self, kind: str) -> bool:
        """Count a fault in a received message.
        Return whether a fault of this kind occurs for the first time and must be logged.
        """
        with self._lock:
            if kind not in self._counts and len(self._counts) >= self._most:
                kind = MORE
            self._counts[kind] += 1
            return self._counts[kind] == 1

    @property
    def total(self) -> int:
        with self._lock:
            return sum(self._counts.values())
