"""The in-process message bus: topics, services, parameters, and a clock of wall or simulation time.

Nodes use only the bus; each transport (Unity, ROS 1, ROS 2) acts as one more publisher, subscriber and server
on it. The bus passes messages by reference: a publisher must not change a message after publishing it, and
receivers must not write to it.
"""

from __future__ import annotations

import copy
import logging
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from armcell.core import ArmcellError, InputError, UnknownNameError
from armcell.core.checks import require
from armcell.ros.definitions import plain_name
from armcell.ros.names import NameMap, resolve
from armcell.ros.parameters import Parameters, RemappedParameters
from armcell.ros.schema import Schema
from armcell.ros.schema import schema as built_in
from armcell.ros.topics import Attachment, Member, Publisher, Put, Subscription, Topic, TopicInfo


class Clock:
    """Clock of the message bus. It returns Unix time in seconds, or simulation time once `set` has been
    called.
    """

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._simulated: float | None = None

    @property
    def is_simulated(self) -> bool:
        return self._simulated is not None

    def now(self) -> float:
        """Return the current time [s] of the bus's clock: simulation time if it was set, otherwise Unix
        time.
        """
        simulated = self._simulated
        return time.time() if simulated is None else simulated

    def set(self, seconds: float) -> None:
        """Set the clock of the message bus to `seconds`. From now on, the clock shows simulation time.

        Time may jump backward, for example when the simulation is reset.
        """
        require(0 <= seconds < float("inf"), f"time is {seconds}, it must be 0 s or later")
        with self._changed:
            self._simulated = float(seconds)
            self._changed.notify_all()

    def wait_until(self, seconds: float, timeout: float | None = None) -> bool:
        """Wait until the clock of the message bus reaches the time `seconds` [s].

        Args:
            seconds: target time on this clock.
            timeout: longest wait in wall-clock time [s]; None waits forever.
        Returns:
            True if the clock reached the target, False if the timeout expired first.
        """
        give_up = None if timeout is None else time.monotonic() + timeout
        with self._changed:
            while (left := seconds - self.now()) > 0:
                wall = None if give_up is None else give_up - time.monotonic()
                if wall is not None and wall <= 0:
                    return False
                if not self.is_simulated:
                    wall = left if wall is None else min(left, wall)
                self._changed.wait(wall)
        return True


logger = logging.getLogger(__name__)

QUEUE_SIZE = 10  # usual value in ROS scripts

LOOK_PERIOD = 0.1  # [s] polling period for a service behind a transport

Handler = Callable[[Any], Any]

Finder = Callable[[str], Handler | None]

"""Returns the handler of a service behind a transport by full name; None without a server."""


class ServiceError(ArmcellError):
    """Failure of a service call on the message bus: no server, an error in the handler, or a timeout."""


class Bus:
    """Thread-safe in-process message bus with topics, services, parameters and a clock.

    The bus never holds a lock while a callback or service handler runs.
    """

    def __init__(self, schema: Schema | None = None):
        self.schema = schema or built_in()
        self.clock = Clock()
        self._names: NameMap | None = None
        self._root, self._parameters = self, Parameters()
        self._lock = threading.Lock()
        self._topics: dict[str, Topic] = {}
        self._services: dict[str, Service] = {}
        self._finders: list[Finder] = []
        self._changed = threading.Condition(self._lock)
        self._versions = [0]  # counts changes of publishers, subscribers and services; shared by all views

    def with_remapping(self, names: NameMap | None) -> Bus:
        """Return a view of the message bus that applies the namespace and name remappings of a program.

        Transports use the bus itself, so that a namespace or remapping has the same effect on all of them.
        """
        view = copy.copy(self)
        view._names = names
        return view

    @property
    def names(self) -> NameMap | None:
        """Return the namespace and remappings that this view of the message bus applies to names, or None if
        there are none.
        """
        return self._names

    @property
    def parameters(self) -> Parameters:
        found = self._root._parameters
        return found if self._names is None else RemappedParameters(found, self._names)

    @parameters.setter
    def parameters(self, parameters: Parameters) -> None:
        self._root._parameters = parameters

    def full_name(self, name: str) -> str:
        """Return the name of a topic or service on the message bus, given the name that a program uses.

        Raises:
            InputError: ROS does not accept the name.
        """
        return resolve(name) if self._names is None else self._names.to_graph(name)

    def _own_name(self, name: str) -> str:
        return name if self._names is None else self._names.to_bus(name)

    # --- topics ---
    def advertise(self, topic: str, type_name: str, latch: bool = False, owner: object = None) -> Publisher:
        """Advertise a topic on the message bus and return a publisher for it.

        Args:
            topic: name of the topic.
            type_name: message type, `pkg/Name`.
            latch: if True, each new subscriber receives the last message immediately.
            owner: the transport that publishes; its own attachments do not receive these messages.
        Raises:
            InputError: the topic has another type, or the name is invalid.
            UnknownNameError: the message type does not exist.
        """
        return self._join(topic, type_name, lambda t: Publisher(t, latch, owner))

    def subscribe(
        self,
        topic: str,
        type_name: str,
        callback: Callable[[Any], None] | None = None,
        queue_size: int = QUEUE_SIZE,
    ) -> Subscription:
        """Subscribe to a topic of the message bus; read messages with `get`, or pass a callback.

        The callback runs in a separate thread. When the queue is full, the oldest message is dropped and
        counted.

        Args:
            topic: name of the topic.
            type_name: message type, `pkg/Name`.
            callback: called with each message.
            queue_size: maximum number of unread messages.
        Raises:
            InputError: the topic has another type, or the name is invalid.
            UnknownNameError: the message type does not exist.
        """
        subscription = self._join(topic, type_name, lambda t: Subscription(t, queue_size, self.attach))
        if callback is not None:
            subscription.run(callback)
        return subscription

    def attach(self, topic: str, type_name: str, put: Put, owner: object = None) -> Attachment:
        """Attach a transport (such as the ROS 2 bridge) to a topic of the message bus. The bus passes each
        message to the transport's function `put`, in the publisher's thread.

        `put` receives the messages in order. It must be quick, must not raise, and must not use the bus. It
        does not receive messages of publishers with the same `owner`, because those messages arrived through
        the same transport.

        Args:
            topic: name of the topic.
            type_name: message type, `pkg/Name`.
            put: called with each message.
            owner: the transport.
        """
        return self._join(topic, type_name, lambda t: Attachment(t, put, owner))

    def topics(self, besides: object = None) -> list[TopicInfo]:
        """List the topics of the message bus, each with its number of publishers and subscribers.

        Args:
            besides: an owner whose publishers and subscribers are not counted; topics without others are
                omitted.
        """
        with self._lock:
            topics = sorted(self._topics.values(), key=lambda t: t.name)
        infos = [replace(i, name=self._own_name(i.name)) for i in (t.info(besides) for t in topics)]
        return [i for i in infos if i.publishers or i.subscribers or besides is None]

    def topic_type(self, topic: str) -> str | None:
        """Return the message type of a topic on the message bus, or None if the topic does not exist."""
        with self._lock:
            found = self._topics.get(self.full_name(topic))
            return found.type if found else None

    def _join(self, name: str, type_name: str, make: Callable[[Topic], Any]) -> Any:
        name, type_name = self.full_name(name), plain_name(type_name)
        self.schema.definition(type_name)
        with self._lock:
            topic = self._topics.get(name)
            if topic is None:
                topic = Topic(name, type_name, self._leave)
            elif topic.type != type_name:
                raise InputError(
                    f"topic {name} carries {topic.type}, not {type_name}",
                    hint="use another topic, or the same type on both sides",
                )
            member = make(topic)
            self._topics[name] = topic
            topic.add(member)
            self._has_changed()
        return member

    def _leave(self, topic: Topic, member: Member) -> None:
        with self._lock:
            topic.remove(member)
            if topic.is_empty and self._topics.get(topic.name) is topic:
                del self._topics[topic.name]
            self._has_changed()

    def _has_changed(self) -> None:
        self._versions[0] += 1
        self._changed.notify_all()

    def wait_change(self, version: int, timeout: float | None = None) -> int:
        """Wait until a publisher, subscriber or service is added or removed on the message bus.

        Args:
            version: version that the previous call returned; 0 for the first call.
            timeout: longest wait [s]; None waits forever.
        Returns:
            The new version of the bus.
        """
        with self._changed:
            self._changed.wait_for(lambda: self._versions[0] != version, timeout)
            return self._versions[0]

    # --- services ---
    def serve(self, name: str, type_name: str, handler: Handler) -> Service:
        """Register a service on the message bus. Each call runs `handler(request)` to get the response.

        The handler runs in the caller's thread.

        Raises:
            InputError: the bus already has a server for this name.
            UnknownNameError: the service type does not exist.
        """
        name, type_name = self.full_name(name), plain_name(type_name)
        self.schema.service(type_name)
        with self._changed:
            if name in self._services:
                raise InputError(f"service {name} is already served", hint="close the other one first")
            service = self._services[name] = Service(self, name, type_name, handler)
            self._has_changed()
        return service

    def add_service_finder(self, finder: Finder) -> None:
        """Register a function that finds services elsewhere if the message bus has no server for them."""
        with self._lock:
            self._finders.append(finder)

    def remove_service_finder(self, finder: Finder) -> None:
        with self._lock:
            self._finders.remove(finder)

    def _find(self, name: str) -> Handler | None:
        with self._lock:
            finders = list(self._finders)
        return next((found for find in finders if (found := find(name)) is not None), None)

    def call(self, name: str, request: Any) -> Any:
        """Call a service of the message bus, or a service that a transport provides from another program, and
        return the response.

        Raises:
            ServiceError: the service has no server, or its handler failed; the message states the cause.
            InputError: the request has another type.
        """
        name = self.full_name(name)
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
        """Wait for a service on the message bus. Return False if it is missing after `timeout` [s]."""
        name = self.full_name(name)
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
        """Return the services on the message bus as a dict from service name to type."""
        with self._lock:
            return {self._own_name(name): service.type for name, service in sorted(self._services.items())}

    # --- time ---
    def stamp(self) -> Any:
        """Return the current time of the bus's clock as a builtin_interfaces/Time message."""
        return self.schema.message("builtin_interfaces/Time").from_sec(self.clock.now())

    def header(self, frame_id: str = "") -> Any:
        """Return a std_msgs/Header with the current time of the bus's clock."""
        return self.schema.new("std_msgs/Header", stamp=self.stamp(), frame_id=frame_id)


class Service:
    """Registration of a service on the message bus; `close` removes the service."""

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
