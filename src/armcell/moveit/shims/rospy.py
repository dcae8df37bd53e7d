"""rospy: nodes, topics, services, parameters, time and logging, on the in-process bus.

Source of names, defaults and exceptions: rospy's documentation (docs.ros.org/en/noetic/api/rospy).
"""

from __future__ import annotations

import contextlib
import re
import sys
import threading
import time
import traceback
from collections.abc import Callable
from typing import Any

from armcell.core import ArmcellError, InputError, UnknownNameError
from armcell.moveit.ros_time import Duration, Time
from armcell.moveit.session import CHECK, current_session
from armcell.ros.bus import ServiceError
from armcell.ros.names import resolve

DEBUG, INFO, WARN, ERROR, FATAL = 1, 2, 4, 8, 16
QUEUE_SIZE = 100  # where a script gives none: rospy would block, or keep everything


class ROSException(Exception):
    """Base of rospy's errors."""


class ROSInterruptException(ROSException, KeyboardInterrupt):
    """What waits was interrupted by the end of the program."""


class ROSInitException(ROSException):
    """A node that cannot be, or is not there yet."""


class ROSSerializationException(ROSException):
    """A message that cannot be sent."""


class TransportException(ROSException):
    """A connection that failed."""


class ServiceException(Exception):
    """A service call that got no answer."""


class ROSTimeMovedBackwardsException(ROSInterruptException):
    """The simulation was reset while somebody slept."""


# --- the node ---
def init_node(
    name: str, argv: Any = None, anonymous: bool = False, log_level: int | None = None,
    disable_rostime: bool = False, disable_rosout: bool = False, disable_signals: bool = False,
    xmlrpc_port: int = 0, tcpros_port: int = 0,
) -> None:  # fmt: skip
    session = current_session()
    if not name or "/" in name:
        raise ValueError("name must not be empty" if not name else "namespaces are not allowed in node names")
    if anonymous:
        name = f"{name}_{int(time.time() * 1000)}"
    if session.node_name and session.node_name != f"/{name}":
        raise ROSException(
            "rospy.init_node() has already been called with different arguments: "
            + str((name, argv, anonymous))
        )
    session.node_name = f"/{name}"


def get_name() -> str:
    return current_session().node_name or "/unnamed"


def get_caller_id() -> str:
    return get_name()


def get_namespace() -> str:
    return "/"


def get_node_uri() -> str:
    return ""


def get_ros_root(required: bool = False) -> str:
    return ""


def resolve_name(name: str, caller_id: str | None = None) -> str:
    return _resolved(name)


def myargv(argv: list[str] | None = None) -> list[str]:
    return [a for a in (sys.argv if argv is None else argv) if ":=" not in a]


def is_shutdown() -> bool:
    return current_session().shutting_down.is_set()


def is_initialized() -> bool:
    return bool(current_session().node_name)


def signal_shutdown(reason: str) -> None:
    current_session().shut_down(reason)


def on_shutdown(hook: Callable[[], None]) -> None:
    current_session().on_shutdown.append(hook)


def spin() -> None:
    try:
        while not is_shutdown():
            current_session().shutting_down.wait(CHECK)
    except KeyboardInterrupt:
        current_session().shut_down("interrupted")


# --- time ---
def get_rostime() -> Time:
    return Time.now()


def get_time() -> float:
    return current_session().bus.clock.now()


def sleep(duration: float | Duration) -> None:
    """By the cell's clock, as with use_sim_time."""
    seconds = duration.to_sec() if hasattr(duration, "to_sec") else float(duration)  # type: ignore[union-attr]
    if seconds > 0:
        _wait_until(get_time() + seconds)


def _wait_until(seconds: float) -> None:
    session = current_session()
    clock = session.bus.clock
    try:
        while not clock.wait_until(seconds, timeout=CHECK):
            if session.shutting_down.is_set() or not session.served.thread.is_alive():
                raise ROSInterruptException("ROS shutdown request")
    except ROSInterruptException:
        raise
    except KeyboardInterrupt:
        session.shut_down("interrupted")
        raise ROSInterruptException("ROS shutdown request") from None


class Rate:
    """Sleeps so that a loop runs at a rate [Hz] of the cell's clock."""

    def __init__(self, hz: float, reset: bool = False):
        self.sleep_dur = Duration.from_sec(1.0 / hz)
        self.last_time = Time.now()

    def sleep(self) -> None:
        now = get_time()
        wake = self.last_time.to_sec() + self.sleep_dur.to_sec()
        if wake < now - self.sleep_dur.to_sec():
            wake = now  # a period was missed: no burst
        if wake > now:
            _wait_until(wake)
        self.last_time = Time.from_sec(wake)

    def remaining(self) -> Duration:
        passed = get_time() - self.last_time.to_sec()
        return Duration.from_sec(self.sleep_dur.to_sec() - passed)


class Timer(threading.Thread):
    """Calls back with a TimerEvent every period of the cell's clock, until `shutdown`."""

    def __init__(
        self, period: Duration, callback: Callable[[Any], None], oneshot: bool = False, reset: bool = False
    ):
        super().__init__(name="rospy timer", daemon=True)
        self._period, self._callback, self._oneshot = period.to_sec(), callback, oneshot
        self._over = threading.Event()
        self.start()

    def shutdown(self) -> None:
        self._over.set()

    def run(self) -> None:
        last_expected = last_real = None
        expected = get_time()
        while not self._over.is_set() and not is_shutdown():
            expected += self._period
            try:
                _wait_until(expected)
            except ROSInterruptException:
                return
            if self._over.is_set():
                return
            event = TimerEvent(last_expected, last_real, Time.from_sec(expected), Time.now(), None)
            last_expected, last_real = event.current_expected, event.current_real
            self._callback(event)
            if self._oneshot:
                return


class TimerEvent:
    """When a timer should have called and when it did."""

    def __init__(
        self, last_expected: Any, last_real: Any, current_expected: Any, current_real: Any, last_duration: Any
    ):
        self.last_expected, self.last_real = last_expected, last_real
        self.current_expected, self.current_real = current_expected, current_real
        self.last_duration = last_duration


# --- topics ---
class Publisher:
    """Publishes on a topic of the bus."""

    def __init__(
        self, name: str, data_class: type, subscriber_listener: Any = None, tcp_nodelay: bool = False,
        latch: bool = False, headers: Any = None, queue_size: int | None = None,
    ):  # fmt: skip
        self.resolved_name = self.name = _resolved(name)
        self.data_class, self.type = data_class, data_class._type  # type: ignore[attr-defined]
        with _ros_errors(ROSException):
            self._publisher = current_session().bus.advertise(self.name, self.type, latch)

    def publish(self, *args: Any, **kwds: Any) -> None:
        """A message, or the fields to make one of."""
        if len(args) == 1 and not kwds and getattr(args[0], "_type", None) == self.type:
            message = args[0]
        elif len(args) == 1 and not kwds and hasattr(args[0], "_type"):
            raise ROSSerializationException(f"{self.name} carries {self.type}, not {args[0]._type}")
        else:
            message = self.data_class(*args, **kwds)
        if self._publisher.closed:
            raise ROSException("publish() to a closed topic")
        # The script may go on with its message: what is on the bus is left alone.
        with _ros_errors(ROSSerializationException):
            self._publisher.publish(current_session().messages.local(message))

    def get_num_connections(self) -> int:
        return self._publisher.subscribers

    def unregister(self) -> None:
        self._publisher.close()


class Subscriber:
    """Calls back with its own copy of each message, from a thread of its own."""

    def __init__(
        self, name: str, data_class: type, callback: Callable[..., None] | None = None,
        callback_args: Any = None, queue_size: int | None = None, buff_size: int = 65536,
        tcp_nodelay: bool = False,
    ):  # fmt: skip
        session = current_session()
        self.resolved_name = self.name = _resolved(name)
        self.data_class, self.type = data_class, data_class._type  # type: ignore[attr-defined]
        self.callback, self.callback_args = callback, callback_args

        def receive(message: Any) -> None:
            if callback is None:
                return
            own = session.messages.local(message)
            try:
                callback(own) if callback_args is None else callback(own, callback_args)
            except Exception:
                logerr(f"bad callback: {callback}\n{traceback.format_exc()}")

        with _ros_errors(ROSException):
            self._subscription = session.bus.subscribe(
                self.name, self.type, receive, queue_size or QUEUE_SIZE
            )

    def get_num_connections(self) -> int:
        topics = {t.name: t.publishers for t in current_session().bus.topics()}
        return topics.get(self.name, 0)

    def unregister(self) -> None:
        self._subscription.close()


def wait_for_message(topic: str, topic_type: type, timeout: float | None = None) -> Any:
    session = current_session()
    give_up = None if timeout is None else get_time() + timeout
    with session.bus.subscribe(_resolved(topic), topic_type._type) as subscription:  # type: ignore[attr-defined]
        while (message := subscription.get(CHECK)) is None:
            if give_up is not None and get_time() > give_up:
                raise ROSException(f"timeout exceeded while waiting for message on topic {_resolved(topic)}")
            _check_running()
    return session.messages.local(message)


def get_published_topics(namespace: str = "/") -> list[list[str]]:
    return [
        [t.name, t.type]
        for t in current_session().bus.topics()
        if t.publishers and t.name.startswith(namespace)
    ]


# --- services ---
class Service:
    """Serves: the handler may give a response, a list or tuple or dict of its fields, or one value."""

    def __init__(
        self, name: str, service_class: Any, handler: Callable[[Any], Any], buff_size: int = 65536,
        error_handler: Any = None,
    ):  # fmt: skip
        session = current_session()
        self.resolved_name = _resolved(name)

        def answer(request: Any) -> Any:
            given = handler(session.messages.local(request))
            made = _response(service_class._response_class, given)
            return made

        with _ros_errors(ServiceException):
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
    """Calls a service like a function."""

    def __init__(self, name: str, service_class: Any, persistent: bool = False, headers: Any = None):
        self.resolved_name, self.service_class = _resolved(name), service_class
        self.request_class, self.response_class = service_class._request_class, service_class._response_class

    def __call__(self, *args: Any, **kwds: Any) -> Any:
        return self.call(*args, **kwds)

    def call(self, *args: Any, **kwds: Any) -> Any:
        if len(args) == 1 and not kwds and getattr(args[0], "_type", None) == self.request_class._type:
            request = args[0]
        else:
            request = self.request_class(*args, **kwds)
        with _ros_errors(ServiceException):
            return current_session().call(self.resolved_name, request)

    def wait_for_service(self, timeout: float | None = None) -> None:
        wait_for_service(self.resolved_name, timeout)

    def close(self) -> None:
        pass


def wait_for_service(service: str, timeout: float | Duration | None = None) -> None:
    seconds = timeout.to_sec() if hasattr(timeout, "to_sec") else timeout  # type: ignore[union-attr]
    give_up = None if seconds is None else time.monotonic() + seconds
    while not current_session().bus.wait_for_service(_resolved(service), CHECK):
        if give_up is not None and time.monotonic() > give_up:
            raise ROSException(f"timeout exceeded while waiting for service {_resolved(service)}")
        _check_running()


# --- parameters ---
_NONE = object()


def get_param(param_name: str, default: Any = _NONE) -> Any:
    parameters = current_session().bus.parameters
    try:
        return parameters.get(_resolved(param_name))
    except UnknownNameError:
        if default is _NONE:
            raise KeyError(param_name) from None
        return default


def get_param_cached(param_name: str, default: Any = _NONE) -> Any:
    return get_param(param_name, default)


def set_param(param_name: str, param_value: Any) -> None:
    current_session().bus.parameters.set(_resolved(param_name), param_value)


def has_param(param_name: str) -> bool:
    return _resolved(param_name) in current_session().bus.parameters


def delete_param(param_name: str) -> None:
    try:
        current_session().bus.parameters.delete(_resolved(param_name))
    except UnknownNameError:
        raise KeyError(param_name) from None


def search_param(param_name: str) -> str | None:
    return _resolved(param_name) if has_param(param_name) else None


def get_param_names() -> list[str]:
    return current_session().bus.parameters.names()


# --- logging ---
_last: dict[tuple[str, str], float] = {}
_CLOSE = re.compile(r"\bclose (the )?gripper\b", re.IGNORECASE)


def _log(level: str, message: Any, args: tuple[Any, ...]) -> None:
    text = str(message) % args if args else str(message)
    current_session().say(level, text)
    if _CLOSE.search(text) and not current_session().served.node.grippers.closes_by_itself:
        current_session().hint(
            "auto-grip", "nobody closes the gripper when a script only says so: run it with --auto-grip"
        )


def logdebug(msg: Any, *args: Any, **kwargs: Any) -> None:
    """Not shown, as in ROS unless asked for."""


def loginfo(msg: Any, *args: Any, **kwargs: Any) -> None:
    _log("INFO", msg, args)


def logwarn(msg: Any, *args: Any, **kwargs: Any) -> None:
    _log("WARN", msg, args)


def logerr(msg: Any, *args: Any, **kwargs: Any) -> None:
    _log("ERROR", msg, args)


def logfatal(msg: Any, *args: Any, **kwargs: Any) -> None:
    _log("FATAL", msg, args)


def _throttled(level: str) -> Callable[..., None]:
    def log(period: float, msg: Any, *args: Any) -> None:
        key, now = (level, str(msg)), get_time()
        if now - _last.get(key, -1e18) >= period or now < _last.get(key, 0.0):
            _last[key] = now
            _log(level, msg, args)

    return log


def _once(level: str) -> Callable[..., None]:
    def log(msg: Any, *args: Any) -> None:
        if (f"{level} once", str(msg)) not in _last:
            _last[(f"{level} once", str(msg))] = get_time()
            _log(level, msg, args)

    return log


loginfo_throttle, logwarn_throttle, logerr_throttle = (
    _throttled("INFO"),
    _throttled("WARN"),
    _throttled("ERROR"),
)
loginfo_once, logwarn_once, logerr_once = _once("INFO"), _once("WARN"), _once("ERROR")
logwarning, logerror, logfatal_once = logwarn, logerr, _once("FATAL")
logout = loginfo


def logdebug_throttle(period: float, msg: Any, *args: Any) -> None:
    """Not shown."""


def logdebug_once(msg: Any, *args: Any) -> None:
    """Not shown."""


# --- inside ---
def _resolved(name: str) -> str:
    """A graph name; `~private` ones are below the node's."""
    try:
        if name.startswith("~"):
            return resolve(name[1:].lstrip("/"), get_name())
        return resolve(name)
    except InputError as error:
        raise ValueError(str(error)) from None


def _check_running() -> None:
    if is_shutdown():
        raise ROSInterruptException("rospy shutdown")


@contextlib.contextmanager
def _ros_errors(kind: type[Exception]) -> Any:
    """armcell's errors as rospy's."""
    try:
        yield
    except (ArmcellError, ServiceError) as error:
        raise kind(str(error)) from error


class _Exceptions:
    """`rospy.exceptions`."""

    ROSException, ROSInterruptException, ROSInitException = (
        ROSException,
        ROSInterruptException,
        ROSInitException,
    )


exceptions = _Exceptions
AnyMsg = object
