"""What is wrong with others' messages: each kind is said once, all are counted."""

from __future__ import annotations

import threading
from collections import Counter

MORE = "more"  # one kind for all that come after the most


class Complaints:
    """Counts mistakes by kind. Thread-safe.

    Args:
        most: kinds that are told apart: whoever makes up new mistakes fills neither the log nor the memory.
    """

    def __init__(self, most: int = 100):
        self._most = most
        self._lock = threading.Lock()
        self._counts: Counter[str] = Counter()

    def is_new(self, kind: str) -> bool:
        """Count a mistake; whether it is the first of its kind, which is the one to be said."""
        with self._lock:
            if kind not in self._counts and len(self._counts) >= self._most:
                kind = MORE
            self._counts[kind] += 1
            return self._counts[kind] == 1

    @property
    def total(self) -> int:
        with self._lock:
            return sum(self._counts.values())
