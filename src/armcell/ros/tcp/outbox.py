"""What waits to be sent on one connection: bounded, and never making the sender wait.

Commands and service answers are kept; a topic's messages wait in a queue of their own, whose oldest is
dropped when it is full. So a client that reads slowly gets the newest state of every topic, and memory
stays within a cap.
"""

from __future__ import annotations

import threading
from collections import Counter, deque
from collections.abc import Callable
from typing import NamedTuple

Part = bytes | memoryview


class Caps(NamedTuple):
    """Limits of one outbox."""

    messages: int = 10  # per topic
    topic_bytes: int = 8 << 20  # per topic, though always one message
    control_bytes: int = 64 << 20  # commands and answers; beyond: the connection is given up


class Outbox:
    """Thread-safe; any number of threads put, one takes.

    Args:
        on_overflow: called when more commands wait than the cap allows; must be quick.

    Attributes:
        dropped: messages dropped, by topic.
        waiting_bytes: what waits now.
    """

    def __init__(self, caps: Caps = Caps(), on_overflow: Callable[[], None] = lambda: None):
        self._caps, self._on_overflow = caps, on_overflow
        self._condition = threading.Condition()
        self._control: deque[tuple[Part, ...]] = deque()
        self._control_bytes = 0
        self._topics: dict[str, deque[tuple[Part, ...]]] = {}
        self._bytes: Counter[str] = Counter()
        self._turns: deque[str] = deque()  # one entry per waiting message: whose turn it is
        self._closed = self._finishing = False
        self.dropped: Counter[str] = Counter()
        self.overflowed = False

    @property
    def waiting_bytes(self) -> int:
        return self._control_bytes + sum(self._bytes.values())

    def put(self, *parts: Part) -> None:
        """A command or answer; its parts go out together, before any topic's messages."""
        with self._condition:
            if self._closed or self._finishing or self.overflowed:
                return
            self._control.append(parts)
            self._control_bytes += _size(parts)
            self.overflowed = self._control_bytes > self._caps.control_bytes
            self._condition.notify()
        if self.overflowed:
            self._on_overflow()

    def put_message(self, topic: str, *parts: Part) -> None:
        """A topic's message; pushes out older ones of that topic when its queue is full."""
        size = _size(parts)
        with self._condition:
            if self._closed or self._finishing:
                return
            queue = self._topics.setdefault(topic, deque())
            gone = 0
            while queue and (
                len(queue) >= self._caps.messages or self._bytes[topic] + size > self._caps.topic_bytes
            ):
                self._bytes[topic] -= _size(queue.popleft())
                gone += 1
            self.dropped[topic] += gone
            if not gone:
                self._turns.append(topic)
            for _ in range(gone - 1):  # the first one's turn is the new message's
                self._turns.remove(topic)
            queue.append(parts)
            self._bytes[topic] += size
            self._condition.notify()

    def forget(self, topic: str) -> None:
        """Drop what waits of a topic nobody wants any more (not counted as dropped)."""
        with self._condition:
            for _ in self._topics.pop(topic, ()):
                self._turns.remove(topic)
            self._bytes.pop(topic, None)

    @property
    def is_empty(self) -> bool:
        return not (self._control or self._turns)

    def wait(self, timeout: float | None) -> bool:
        """Whether something waits, after waiting for that.

        Raises:
            EOFError: closed, or more commands wait than the cap allows.
        """
        with self._condition:
            self._condition.wait_for(
                lambda: self._control or self._turns or self._closed or self._finishing, timeout
            )
            if self._closed or self.overflowed or (self._finishing and self.is_empty):
                raise EOFError
            return not self.is_empty

    def take(self, max_bytes: int) -> list[Part]:
        """Parts to send now, in order: about `max_bytes`, at least one frame if any waits."""
        with self._condition:
            taken: list[Part] = []
            size = 0
            while size < max_bytes and (self._control or self._turns):
                if self._control:
                    parts = self._control.popleft()
                    self._control_bytes -= _size(parts)
                else:
                    topic = self._turns.popleft()
                    parts = self._topics[topic].popleft()
                    self._bytes[topic] -= _size(parts)
                taken += parts
                size += _size(parts)
            return taken

    def finish(self) -> None:
        """Take nothing more, but let what waits go out before the end."""
        with self._condition:
            self._finishing = True
            self._condition.notify_all()

    def close(self) -> None:
        with self._condition:
            self._closed = True
            self._condition.notify_all()


def _size(parts: tuple[Part, ...]) -> int:
    return sum(len(p) for p in parts)
