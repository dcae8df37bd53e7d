"""Topics of the in-process message bus, with their publishers, subscriptions and attached transports."""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from armcell.core import InputError
from armcell.core.checks import require

logger = logging.getLogger(__name__)

Put = Callable[[Any], None]


@dataclass(frozen=True)
class TopicInfo:
    """Snapshot of one bus topic: its type, its connections and its message counts."""

    name: str
    type: str
    publishers: int
    subscribers: int
    messages: int  # published since the topic was created
    dropped: int  # messages that full queues of current subscriptions have dropped
    latched: bool = False  # at least one publisher sends its last message to new subscribers


class Topic:
    """Topic of the message bus, with its publishers and receivers.

    The topic's lock ensures that all receivers get the messages in the same order. A member that closes calls
    the bus's function `leave`, which removes the topic without members.
    """

    def __init__(self, name: str, type_name: str, leave: Callable[[Topic, Member], None]):
        self.name, self.type, self.leave = name, type_name, leave
        self.lock = threading.Lock()
        self.publishers: list[Publisher] = []
        self.receivers: list[Attachment] = []
        self.messages = 0

    @property
    def is_empty(self) -> bool:
        return not (self.publishers or self.receivers)

    def add(self, member: Member) -> None:
        with self.lock:
            if isinstance(member, Publisher):
                self.publishers.append(member)
            elif isinstance(member, Attachment):
                self.receivers.append(member)
                for publisher in self.publishers:
                    if publisher.latched is not None and not _same(publisher, member):
                        member.put(publisher.latched)

    def remove(self, member: Member) -> None:
        with self.lock:
            if isinstance(member, Publisher) and member in self.publishers:
                self.publishers.remove(member)
            elif isinstance(member, Attachment) and member in self.receivers:
                self.receivers.remove(member)

    def publish(self, publisher: Publisher, message: Any) -> None:
        with self.lock:
            self.messages += 1
            if publisher.latch:
                publisher.latched = message
            for receiver in self.receivers:
                if not _same(publisher, receiver):
                    receiver.put(message)

    def info(self, besides: object) -> TopicInfo:
        with self.lock:
            publishers = [p for p in self.publishers if besides is None or p.owner is not besides]
            receivers = [r for r in self.receivers if besides is None or r.owner is not besides]
            dropped = sum(r.dropped for r in receivers if isinstance(r, Subscription))
            latched = any(p.latch for p in publishers)
            return TopicInfo(
                self.name, self.type, len(publishers), len(receivers), self.messages, dropped, latched
            )


def _same(publisher: Publisher, receiver: Attachment) -> bool:
    """Return whether a publisher and a receiver of a bus topic belong to the same transport."""
    return publisher.owner is not None and publisher.owner is receiver.owner


class Member:
    """Base class of publishers and receivers on a bus topic. Their method `close` removes them from the
    topic.

    A member is also a context manager that closes at the end of a `with` block.
    """

    def __init__(self, topic: Topic, owner: object = None):
        self._topic, self.owner = topic, owner
        self.topic, self.type = topic.name, topic.type
        self.closed = False

    def close(self) -> None:
        """Remove a publisher or receiver from its bus topic. Further calls have no effect."""
        self.closed = True
        self._topic.leave(self._topic, self)

    def __enter__(self) -> Any:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()


class Publisher(Member):
    """Publisher of messages on one bus topic."""

    def __init__(self, topic: Topic, latch: bool, owner: object = None):
        super().__init__(topic, owner)
        self.latch = latch
        self.latched: Any = None

    def publish(self, message: Any) -> None:
        """Deliver a message to every subscriber of the bus topic, without waiting for any of them.

        Raises:
            InputError: the message has another type than the topic, or the publisher is closed.
        """
        given = getattr(message, "_type", type(message).__name__)
        if given != self.type:
            raise InputError(f"topic {self.topic} carries {self.type}, not {given}")
        if self.closed:
            raise InputError(f"the publisher of {self.topic} is closed")
        self._topic.publish(self, message)

    @property
    def subscribers(self) -> int:
        """Return how many receivers the bus topic has, including the receivers of transports."""
        return len(self._topic.receivers)


class Attachment(Member):
    """Receiver of a bus topic, which passes each message of the topic to a function of a transport."""

    def __init__(self, topic: Topic, put: Put, owner: object = None):
        super().__init__(topic, owner)
        self.put = put


class Subscription(Attachment):
    """Subscription to a bus topic, with a bounded queue of the topic's unread messages.

    Attributes:
        dropped: number of unread messages that the full queue has dropped.
    """

    def __init__(self, topic: Topic, queue_size: int, attach: Callable[[str, str, Put], Attachment]):
        require(queue_size >= 1, f"queue size is {queue_size}, it must be at least 1")
        super().__init__(topic, self._put)
        self._attach = attach
        self.dropped = 0
        self._queue: deque[Any] = deque(maxlen=queue_size)
        self._arrived = threading.Condition()
        self._thread: threading.Thread | None = None
        self._joined: list[Attachment] = []

    def _put(self, message: Any) -> None:
        with self._arrived:
            if len(self._queue) == self._queue.maxlen:
                self.dropped += 1
            self._queue.append(message)
            self._arrived.notify()

    def get(self, timeout: float | None = None) -> Any:
        """Return the oldest unread message of a subscription to a bus topic.

        Args:
            timeout: longest wait for a message [s]; None waits until the subscription is closed.
        Returns:
            The message, or None if the timeout expired or the subscription is closed.
        """
        give_up = None if timeout is None else time.monotonic() + timeout
        with self._arrived:
            while not self._queue and not self.closed:
                left = None if give_up is None else give_up - time.monotonic()
                if left is not None and left <= 0:
                    return None
                self._arrived.wait(left)
            return self._queue.popleft() if self._queue else None

    def join(self, topic: str, type_name: str) -> None:
        """Add a topic to this bus subscription. The subscription queues the messages of all its topics in the
        order in which they arrive.
        """
        self._joined.append(self._attach(topic, type_name, self._put))

    def run(self, callback: Callable[[Any], None]) -> None:
        """Start a thread that calls `callback` with each message of the subscribed bus topic until the
        subscription closes.
        """
        require(self._thread is None, f"the subscription of {self.topic} has a callback already")

        def loop() -> None:
            while (message := self.get()) is not None and not self.closed:
                try:
                    callback(message)
                except Exception:
                    logger.exception("a subscriber of %s failed", self.topic)

        self._thread = threading.Thread(target=loop, name=f"sub {self.topic}", daemon=True)
        self._thread.start()

    def close(self) -> None:
        super().close()
        for attachment in self._joined:
            attachment.close()
        with self._arrived:
            self._arrived.notify_all()
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join(timeout=1.0)
