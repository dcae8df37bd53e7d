"""The in-process bus: topics, services, parameters and a clock, shared by whoever is in this process.

The served nodes are written once against it; a transport (Unity, ROS 1, ROS 2) is one more publisher,
subscriber and server on it. Messages are passed as they are, not copied: whoever publishes one leaves it
alone afterwards, whoever receives one does not write to it.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from armcell.core import ArmcellError, InputError, UnknownNameError
from armcell.core.checks import require
from armcell.ros.clock import Clock
from armcell.ros.definitions import plain_name
from armcell.ros.names import resolve
from armcell.ros.parameters import Parameters
from armcell.ros.schema import Schema
from armcell.ros.schema import schema as built_in

logger = logging.getLogger(__name__)
QUEUE_SIZE = 10  # ROS scripts' usual one

LOOK_PERIOD = 0.1  # [s] between two looks whether a service is there behind a wire

Put = Callable[[Any], None]
Handler = Callable[[Any], Any]
Finder = Callable[[str], Handler | None]
"""Gives what answers a service behind a wire, by its full name; None where nobody serves it there."""


class ServiceError(ArmcellError):
    """A service call that got no answer: nobody serves it, its handler failed, or time ran out."""


@dataclass(frozen=True)
class TopicInfo:
    """A topic as it is now."""

    name: str
    type: str
    publishers: int
    subscribers: int
    messages: int  # published since the topic came up
    dropped: int  # of its subscriptions' queues, since they came up
    latched: bool = False  # one of its publishers keeps its last message for whoever comes later


class Bus:
    """Thread-safe. Locks are held for bookkeeping only, never while somebody's callback or handler runs."""

    def __init__(self, schema: Schema | None = None):
        self.schema = schema or built_in()
        self.clock = Clock()
        self.parameters = Parameters()
        self._lock = threading.Lock()
        self._topics: dict[str, _Topic] = {}
        self._services: dict[str, Service] = {}
        self._finders: list[Finder] = []
        self._changed = threading.Condition(self._lock)
        self._version = 0  # counts who came and went

    # --- topics ---
    def advertise(self, topic: str, type_name: str, latch: bool = False, owner: object = None) -> Publisher:
        """A publisher. With `latch`, later subscribers get its last message at once.

        Args:
            owner: a transport; its own attachments do not get what it publishes.
        Raises:
            InputError: the topic carries another type, or its name is none.
            UnknownNameError: no such message type.
        """
        return self._join(topic, type_name, lambda t: Publisher(self, t, latch, owner))

    def subscribe(
        self,
        topic: str,
        type_name: str,
        callback: Callable[[Any], None] | None = None,
        queue_size: int = QUEUE_SIZE,
    ) -> Subscription:
        """A subscription: read it with `get`, or give a callback, which runs in a thread of its own.

        Its queue holds `queue_size` messages; a full one drops its oldest and counts that.

        Raises:
            InputError: the topic carries another type, or its name is none.
            UnknownNameError: no such message type.
        """
        subscription = self._join(topic, type_name, lambda t: Subscription(self, t, queue_size))
        if callback is not None:
            subscription.run(callback)
        return subscription

    def attach(self, topic: str, type_name: str, put: Put, owner: object = None) -> Attachment:
        """For transports: `put` is called with each message in the publisher's thread, in order.

        It must be quick, must not fail, and must not use the bus. What publishers of the same `owner`
        publish is not given: it came over the wire that it would go back to.
        """
        return self._join(topic, type_name, lambda t: Attachment(self, t, put, owner))

    def topics(self, besides: object = None) -> list[TopicInfo]:
        """Every topic with a publisher or a subscriber, not counting those of one owner."""
        with self._lock:
            topics = sorted(self._topics.values(), key=lambda t: t.name)
        infos = [t.info(besides) for t in topics]
        return [i for i in infos if i.publishers or i.subscribers or besides is None]

    def topic_type(self, topic: str) -> str | None:
        """The type a topic carries; None when there is no such topic."""
        with self._lock:
            found = self._topics.get(resolve(topic))
            return found.type if found else None

    def _join(self, name: str, type_name: str, make: Callable[[_Topic], Any]) -> Any:
        name, type_name = resolve(name), plain_name(type_name)
        self.schema.definition(type_name)
        with self._lock:
            topic = self._topics.get(name)
            if topic is None:
                topic = _Topic(name, type_name)
            elif topic.type != type_name:
                raise InputError(
                    f"topic {name} carries {topic.type}, not {type_name}",
                    cure="use another topic, or the same type on both sides",
                )
            member = make(topic)
            self._topics[name] = topic
            topic.add(member)
            self._has_changed()
        return member

    def _leave(self, topic: _Topic, member: _Member) -> None:
        with self._lock:
            topic.remove(member)
            if topic.is_empty and self._topics.get(topic.name) is topic:
                del self._topics[topic.name]
            self._has_changed()

    def _has_changed(self) -> None:
        self._version += 1
        self._changed.notify_all()

    def wait_change(self, version: int, timeout: float | None = None) -> int:
        """Wait until somebody has come or gone since `version` (0 at first); the version that is now."""
        with self._changed:
            self._changed.wait_for(lambda: self._version != version, timeout)
            return self._version

    # --- services ---
    def serve(self, name: str, type_name: str, handler: Handler) -> Service:
        """Answer a service: `handler(request)` gives the response, in the caller's thread.

        Raises:
            InputError: somebody serves it already.
            UnknownNameError: no such service type.
        """
        name, type_name = resolve(name), plain_name(type_name)
        self.schema.service(type_name)
        with self._changed:
            if name in self._services:
                raise InputError(f"service {name} is already served", cure="close the other one first")
            service = self._services[name] = Service(self, name, type_name, handler)
            self._has_changed()
        return service

    def find_elsewhere(self, finder: Finder) -> None:
        """For transports: ask here, too, for services that nobody serves on the bus."""
        with self._lock:
            self._finders.append(finder)

    def forget_elsewhere(self, finder: Finder) -> None:
        with self._lock:
            self._finders.remove(finder)

    def _find(self, name: str) -> Handler | None:
        with self._lock:
            finders = list(self._finders)
        return next((found for find in finders if (found := find(name)) is not None), None)

    def call(self, name: str, request: Any) -> Any:
        """Ask a service, on the bus or behind a transport.

        Raises:
            ServiceError: nobody serves it, or the handler failed; says which.
            InputError: the request is of another type.
        """
        name = resolve(name)
        with self._lock:
            service = self._services.get(name)
            served = list(self._services)
        if service is None:
            if (elsewhere := self._find(name)) is not None:
                return elsewhere(request)
            raise ServiceError(str(UnknownNameError("service", name, served)))
        if request._type != f"{service.type}Request":
            raise InputError(f"service {name} takes {service.type}Request, not {request._type}")
        try:
            response = service.handler(request)
        except ArmcellError as error:
            raise ServiceError(f"service {name}: {error}") from error
        except Exception as error:
            logger.exception("service %s failed", name)
            raise ServiceError(f"service {name}: {type(error).__name__}: {error}") from error
        if getattr(response, "_type", None) != f"{service.type}Response":
            raise ServiceError(f"service {name} answered with {type(response).__name__}, not {service.type}")
        return response

    def wait_for_service(self, name: str, timeout: float | None = None) -> bool:
        """Whether a service is there, after waiting for it up to `timeout` [s]."""
        name = resolve(name)
        give_up = None if timeout is None else time.monotonic() + timeout
        while True:
            left = None if give_up is None else max(give_up - time.monotonic(), 0.0)
            with self._changed:
                look = min(LOOK_PERIOD, LOOK_PERIOD if left is None else left) if self._finders else left
                if self._changed.wait_for(lambda: name in self._services, look):
                    return True
            if self._find(name) is not None:
                return True
            if left is not None and left <= 0:
                return False

    def services(self) -> dict[str, str]:
        """Type by name of everything served."""
        with self._lock:
            return {name: service.type for name, service in sorted(self._services.items())}

    # --- time ---
    def stamp(self) -> Any:
        """Now, as builtin_interfaces/Time."""
        return self.schema.message("builtin_interfaces/Time").from_sec(self.clock.now())

    def header(self, frame_id: str = "") -> Any:
        """A std_msgs/Header stamped now."""
        return self.schema.new("std_msgs/Header", stamp=self.stamp(), frame_id=frame_id)


class _Topic:
    """Who publishes and who receives. Its lock makes deliveries come in one order for everybody."""

    def __init__(self, name: str, type_name: str):
        self.name, self.type = name, type_name
        self.lock = threading.Lock()
        self.publishers: list[Publisher] = []
        self.receivers: list[Attachment] = []
        self.messages = 0

    @property
    def is_empty(self) -> bool:
        return not (self.publishers or self.receivers)

    def add(self, member: _Member) -> None:
        with self.lock:
            if isinstance(member, Publisher):
                self.publishers.append(member)
            elif isinstance(member, Attachment):
                self.receivers.append(member)
                for publisher in self.publishers:
                    if publisher.latched is not None and not _same(publisher, member):
                        member.put(publisher.latched)

    def remove(self, member: _Member) -> None:
        with self.lock:
            for members in (self.publishers, self.receivers):
                if member in members:
                    members.remove(member)  # type: ignore[arg-type]

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
    """Whether both belong to one transport."""
    return publisher.owner is not None and publisher.owner is receiver.owner


class _Member:
    """What joins a topic and leaves it by `close`, by the end of a `with` block, or never."""

    def __init__(self, bus: Bus, topic: _Topic, owner: object = None):
        self._bus, self._topic, self.owner = bus, topic, owner
        self.topic, self.type = topic.name, topic.type
        self.closed = False

    def close(self) -> None:
        """Leave the topic. Closing twice is fine."""
        self.closed = True
        self._bus._leave(self._topic, self)

    def __enter__(self) -> Any:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()


class Publisher(_Member):
    """Puts messages on a topic."""

    def __init__(self, bus: Bus, topic: _Topic, latch: bool, owner: object = None):
        super().__init__(bus, topic, owner)
        self.latch = latch
        self.latched: Any = None

    def publish(self, message: Any) -> None:
        """Hand a message to every subscriber; never waits for one.

        Raises:
            InputError: not the topic's type, or the publisher is closed.
        """
        given = getattr(message, "_type", type(message).__name__)
        if given != self.type:
            raise InputError(f"topic {self.topic} carries {self.type}, not {given}")
        if self.closed:
            raise InputError(f"the publisher of {self.topic} is closed")
        self._topic.publish(self, message)

    @property
    def subscribers(self) -> int:
        """How many receive what is published here."""
        return len(self._topic.receivers)


class Attachment(_Member):
    """A transport's function on a topic."""

    def __init__(self, bus: Bus, topic: _Topic, put: Put, owner: object = None):
        super().__init__(bus, topic, owner)
        self.put = put


class Subscription(Attachment):
    """A bounded queue on a topic.

    Attributes:
        dropped: messages that were pushed out unread.
    """

    def __init__(self, bus: Bus, topic: _Topic, queue_size: int):
        require(queue_size >= 1, f"queue size is {queue_size}, it must be at least 1")
        super().__init__(bus, topic, self._put)
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
        """The oldest unread message, or None when none came within `timeout` [s] or it was closed."""
        give_up = None if timeout is None else time.monotonic() + timeout
        with self._arrived:
            while not self._queue and not self.closed:
                left = None if give_up is None else give_up - time.monotonic()
                if left is not None and left <= 0:
                    return None
                self._arrived.wait(left)
            return self._queue.popleft() if self._queue else None

    def join(self, topic: str, type_name: str) -> None:
        """Put another topic's messages into the same queue, so that their order is kept."""
        self._joined.append(self._bus.attach(topic, type_name, self._put))

    def run(self, callback: Callable[[Any], None]) -> None:
        """Call back with each message, from a thread of its own, until closed."""
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


class Service:
    """A served name; `close` stops serving it."""

    def __init__(self, bus: Bus, name: str, type_name: str, handler: Handler):
        self._bus = bus
        self.name, self.type, self.handler = name, type_name, handler

    def close(self) -> None:
        with self._bus._lock:
            if self._bus._services.get(self.name) is self:
                del self._bus._services[self.name]
                self._bus._has_changed()

    def __enter__(self) -> Service:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()
