"""Shim of rospy's communication: publishers, subscribers and services on the bus."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable
from typing import Any

from armcell.moveit.ros_time import Duration
from armcell.moveit.session import CHECK, current_session
from armcell.moveit.shims.ros_node import (
    ROSException,
    ROSSerializationException,
    ServiceException,
    check_running,
    get_time,
    resolved,
    ros_errors,
    spin,
)

QUEUE_SIZE = 100  # default of this shim; without a queue size rospy blocks or queues without limit


# --- topics ---
class Publisher:
    """Publisher of a ROS topic, like rospy.Publisher. It publishes on the bus."""

    def __init__(
        self, name: str, data_class: type, subscriber_listener: Any = None, tcp_nodelay: bool = False,
        latch: bool = False, headers: Any = None, queue_size: int | None = None,
    ):  # fmt: skip
        self.resolved_name = self.name = resolved(name)
        self.data_class, self.type = data_class, data_class._type  # type: ignore[attr-defined]
        with ros_errors(ROSException):
            self._publisher = current_session().bus.advertise(self.name, self.type, latch)

    def publish(self, *args: Any, **kwds: Any) -> None:
        """Publish a message on a ROS topic, like rospy.Publisher. The message is given directly or by the
        values of its fields.
        """
        if len(args) == 1 and not kwds and getattr(args[0], "_type", None) == self.type:
            message = args[0]
        elif len(args) == 1 and not kwds and hasattr(args[0], "_type"):
            raise ROSSerializationException(f"{self.name} carries {self.type}, not {args[0]._type}")
        else:
            message = self.data_class(*args, **kwds)
        if self._publisher.closed:
            raise ROSException("publish() to a closed topic")
        # Publish a copy, because the script may change its message afterwards.
        with ros_errors(ROSSerializationException):
            self._publisher.publish(current_session().messages.local(message))

    def get_num_connections(self) -> int:
        return self._publisher.subscribers

    def unregister(self) -> None:
        self._publisher.close()


class Subscriber:
    """Subscriber of a ROS topic, like rospy.Subscriber. Its thread calls a function with a copy of each
    message, which the function may modify.
    """

    def __init__(
        self, name: str, data_class: type, callback: Callable[..., None] | None = None,
        callback_args: Any = None, queue_size: int | None = None, buff_size: int = 65536,
        tcp_nodelay: bool = False,
    ):  # fmt: skip
        session = current_session()
        self.resolved_name = self.name = resolved(name)
        self.data_class, self.type = data_class, data_class._type  # type: ignore[attr-defined]
        self.callback, self.callback_args = callback, callback_args

        def receive(message: Any) -> None:
            if callback is None:
                return
            own = session.messages.local(message)
            try:
                callback(own) if callback_args is None else callback(own, callback_args)
            except Exception:
                session.say("ERROR", f"bad callback: {callback}\n{traceback.format_exc()}")

        with ros_errors(ROSException):
            self._subscription = session.close_on_shutdown(
                session.bus.subscribe(self.name, self.type, receive, queue_size or QUEUE_SIZE)
            )

    def get_num_connections(self) -> int:
        topics = {t.name: t.publishers for t in current_session().bus.topics()}
        return topics.get(self.name, 0)

    def unregister(self) -> None:
        self._subscription.close()


def wait_for_message(topic: str, topic_type: type, timeout: float | None = None) -> Any:
    session = current_session()
    give_up = None if timeout is None else get_time() + timeout
    with session.bus.subscribe(resolved(topic), topic_type._type) as subscription:  # type: ignore[attr-defined]
        while (message := subscription.get(CHECK)) is None:
            if give_up is not None and get_time() > give_up:
                raise ROSException(f"timeout exceeded while waiting for message on topic {resolved(topic)}")
            check_running()
    return session.messages.local(message)


def get_published_topics(namespace: str = "/") -> list[list[str]]:
    graph = current_session().graph
    if graph is not None:
        return graph.node.ask_master("getPublishedTopics", namespace)
    return [
        [t.name, t.type]
        for t in current_session().bus.topics()
        if t.publishers and t.name.startswith(namespace)
    ]


# --- services ---
class Service:
    """Server of a ROS service on the bus, like rospy.Service.

    The handler may return a response message, a list, tuple or dict of its fields, or the value of its first
    field.
    """

    def __init__(
        self, name: str, service_class: Any, handler: Callable[[Any], Any], buff_size: int = 65536,
        error_handler: Any = None,
    ):  # fmt: skip
        session = current_session()
        self.resolved_name = resolved(name)

        def answer(request: Any) -> Any:
            return _response(service_class._response_class, handler(session.messages.local(request)))

        with ros_errors(ServiceException):
            self._service = session.bus.serve(self.resolved_name, service_class._type, answer)

    def shutdown(self, reason: str = "") -> None:
        self._service.close()

    def spin(self) -> None:
        spin()


def _response(cls: Any, given: Any) -> Any:
    if getattr(given, "_type", None) == cls._type:
        return given
    if given is None:
        raise ServiceException("service handler returned None")
    if isinstance(given, dict):
        return cls(**given)
    return cls(*given) if isinstance(given, list | tuple) else cls(given)


class ServiceProxy:
    """Client of a ROS service, which can be called like a function, as in rospy.ServiceProxy."""

    def __init__(self, name: str, service_class: Any, persistent: bool = False, headers: Any = None):
        self.resolved_name, self.service_class = resolved(name), service_class
        self.request_class, self.response_class = service_class._request_class, service_class._response_class

    def __call__(self, *args: Any, **kwds: Any) -> Any:
        return self.call(*args, **kwds)

    def call(self, *args: Any, **kwds: Any) -> Any:
        if len(args) == 1 and not kwds and getattr(args[0], "_type", None) == self.request_class._type:
            request = args[0]
        else:
            request = self.request_class(*args, **kwds)
        with ros_errors(ServiceException):
            return current_session().call(self.resolved_name, request)

    def wait_for_service(self, timeout: float | None = None) -> None:
        wait_for_service(self.resolved_name, timeout)

    def close(self) -> None:
        pass


def wait_for_service(service: str, timeout: float | Duration | None = None) -> None:
    seconds = timeout.to_sec() if hasattr(timeout, "to_sec") else timeout  # type: ignore[union-attr]
    give_up = None if seconds is None else time.monotonic() + seconds
    while not current_session().bus.wait_for_service(resolved(service), CHECK):
        if give_up is not None and time.monotonic() > give_up:
            raise ROSException(f"timeout exceeded while waiting for service {resolved(service)}")
        check_running()
