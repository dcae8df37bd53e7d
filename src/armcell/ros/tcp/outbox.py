"""Bounded send queues of one ROS-TCP connection; adding to them never blocks.

Commands and service answers are always kept. Each topic has its own queue, which drops its oldest message
when it is full. A client that reads slowly therefore gets the newest state of every topic, and memory use is
bounded.
"""

from __future__ import annotations

import threading
from collections import Counter, deque
from collections.abc import Callable
from typing import NamedTuple

Part = bytes | memoryview


class OutboxLimits(NamedTuple):
    """Limits on the size of the outbox of a ROS-TCP connection."""

    messages: int = 10  # per topic
    topic_bytes: int = 8 << 20  # per topic; one message is always kept
    control_bytes: int = 64 << 20  # for commands and answers; exceeding it ends the connection


class Outbox:
    """Thread-safe queues of the data that a ROS-TCP connection must send. Many threads add data and one
    thread sends it.

    Args:
        on_overflow: called when waiting commands exceed `OutboxLimits.control_bytes`; must return quickly.

    Attributes:
        dropped: number of dropped messages by topic.
        waiting_bytes: bytes that wait to be sent.
    """

    def __init__(self, caps: OutboxLimits = OutboxLimits(), on_overflow: Callable[[], None] = lambda: None):
        self._caps, self._on_overflow = caps, on_overflow
        self._condition = threading.Condition()
        self._control: deque[tuple[Part, ...]] = deque()
        self._control_bytes = 0
        self._topics: dict[str, deque[tuple[Part, ...]]] = {}
        self._bytes: Counter[str] = Counter()
        self._turns: deque[str] = deque()  # topic of each waiting message, in sending order
        self._closed = self._finishing = False
        self.dropped: Counter[str] = Counter()
        self.overflowed = False

    @property
    def waiting_bytes(self) -> int:
        return self._control_bytes + sum(self._bytes.values())

    def put(self, *parts: Part) -> None:
        """Queue a ROS-TCP command or answer in the outbox, ahead of all messages of topics."""
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
        """Queue a message of a ROS-TCP topic in the outbox. If the queue is full, the oldest messages are
        dropped.
        """
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
            for _ in range(gone - 1):  # the new message takes the turn of the first dropped one
                self._turns.remove(topic)
            queue.append(parts)
            self._bytes[topic] += size
            self._condition.notify()

    def forget(self, topic: str) -> None:
        """Discard the queued messages of a ROS-TCP topic that has lost its subscribers. They do not count as
        dropped.
        """
        with self._condition:
            for _ in self._topics.pop(topic, ()):
                self._turns.remove(topic)
            self._bytes.pop(topic, None)

    @property
    def is_empty(self) -> bool:
        return not (self._control or self._turns)

    def wait(self, timeout: float | None) -> bool:
        """Wait until the ROS-TCP outbox contains data to send. Return False on timeout.

        Args:
            timeout: limit [s]; None waits without limit.
        Raises:
            EOFError: the outbox is closed, or waiting commands exceed `OutboxLimits.control_bytes`.
        """
        with self._condition:
            self._condition.wait_for(
                lambda: self._control or self._turns or self._closed or self._finishing, timeout
            )
            if self._closed or self.overflowed or (self._finishing and self.is_empty):
                raise EOFError
            return not self.is_empty

    def take(self, max_bytes: int) -> list[Part]:
        """Remove the next parts of ROS-TCP frames from the outbox and return them in the order in which they
        must be sent.

        Args:
            max_bytes: approximate size [bytes]; at least one frame is returned if any waits.
        """
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
        """Accept no further messages in the ROS-TCP outbox, but still send the messages that are queued."""
        with self._condition:
            self._finishing = True
            self._condition.notify_all()

    def close(self) -> None:
        with self._condition:
            self._closed = True
            self._condition.notify_all()


def _size(parts: tuple[Part, ...]) -> int:
    return sum(len(p) for p in parts)
