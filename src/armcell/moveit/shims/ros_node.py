"""Shim of rospy's node: exceptions, names, shutdown, and time by the cell's clock."""

from __future__ import annotations

import contextlib
import sys
import threading
import time
from collections.abc import Callable
from typing import Any

from armcell.core import ArmcellError, InputError
from armcell.moveit.ros_time import Duration, Time
from armcell.moveit.session import CHECK, current_session
from armcell.ros.bus import ServiceError
from armcell.ros.names import resolve


class ROSException(Exception):
    """Base class of the exceptions that a ROS node raises, like that of rospy."""


class ROSInterruptException(ROSException, KeyboardInterrupt):
    """Exception of a ROS node, like that of rospy: a blocking call is interrupted because the program shuts
    down.
    """


class ROSInitException(ROSException):
    """Exception of a ROS node, like that of rospy: the node is not initialized or cannot be initialized."""


class ROSSerializationException(ROSException):
    """Exception of a ROS node, like that of rospy: a message cannot be serialized."""


class TransportException(ROSException):
    """Exception of a ROS node, like that of rospy: a connection to another node fails."""


class ServiceException(Exception):
    """Exception of a ROS node, like that of rospy: a service call fails."""


class ROSTimeMovedBackwardsException(ROSInterruptException):
    """Exception of a ROS node, like that of rospy: ROS time moves backwards during a sleep, e.g. because the
    simulation is reset.
    """


# --- names and errors ---
def resolved(name: str) -> str:
    """Convert a name that the ROS node uses to a full graph name. A `~private` name is resolved in the
    namespace of the node.
    """
    try:
        if name.startswith("~"):
            return resolve(name[1:].lstrip("/"), get_name())
        return resolve(name)
    except InputError as error:
        raise ValueError(str(error)) from None


def check_running() -> None:
    if is_shutdown():
        raise ROSInterruptException("rospy shutdown")


@contextlib.contextmanager
def ros_errors(kind: type[Exception]) -> Any:
    """Convert armcell's exceptions in a `with` block to the exceptions that a ROS node would raise in
    rospy.
    """
    try:
        yield
    except (ArmcellError, ServiceError) as error:
        raise kind(str(error)) from error


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
    return resolved(name)


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
        current_session().shut_down("signal")  # runs the hooks, which a signal does not run
    except KeyboardInterrupt:
        current_session().shut_down("interrupted")


# --- time ---
def get_rostime() -> Time:
    return Time.now()


def get_time() -> float:
    return current_session().bus.clock.now()


def sleep(duration: float | Duration) -> None:
    """Let the ROS node sleep for a duration measured by the cell's clock, as rospy.sleep does with
    use_sim_time.

    Args:
        duration: seconds or a Duration.
    """
    seconds = duration.to_sec() if hasattr(duration, "to_sec") else float(duration)  # type: ignore[union-attr]
    if seconds > 0:
        wait_until(get_time() + seconds)


def wait_until(seconds: float) -> None:
    session = current_session()
    clock = session.bus.clock
    try:
        while not clock.wait_until(seconds, timeout=CHECK):
            session.hint_at_missing_joint_states()
            if session.shutting_down.is_set() or not session.served.is_running:
                session.shut_down("signal")
                raise ROSInterruptException("ROS shutdown request")
    except ROSInterruptException:
        raise
    except KeyboardInterrupt:
        session.shut_down("interrupted")
        raise ROSInterruptException("ROS shutdown request") from None


class Rate:
    """Loop timer of a ROS node, like rospy.Rate. Its method `sleep` keeps a loop at a fixed rate [Hz],
    measured by the cell's clock.
    """

    def __init__(self, hz: float, reset: bool = False):
        self.sleep_dur = Duration.from_sec(1.0 / hz)
        self.last_time = Time.now()

    def sleep(self) -> None:
        now = get_time()
        wake = self.last_time.to_sec() + self.sleep_dur.to_sec()
        if wake < now - self.sleep_dur.to_sec():
            wake = now  # after a missed period, do not catch up with a burst
        if wake > now:
            wait_until(wake)
        self.last_time = Time.from_sec(wake)

    def remaining(self) -> Duration:
        passed = get_time() - self.last_time.to_sec()
        return Duration.from_sec(self.sleep_dur.to_sec() - passed)


class Timer(threading.Thread):
    """Timer of a ROS node, like rospy.Timer. It calls a function with a TimerEvent at a fixed period,
    measured by the cell's clock.
    """

    def __init__(
        self, period: Duration, callback: Callable[[Any], None], oneshot: bool = False, reset: bool = False
    ):
        super().__init__(name="rospy timer", daemon=True)
        self._period, self._callback, self._oneshot = period.to_sec(), callback, oneshot
        self._over, self._ended = threading.Event(), current_session().shutting_down
        self.start()

    def shutdown(self) -> None:
        self._over.set()

    def run(self) -> None:
        last_expected = last_real = None
        expected = get_time()
        while not self._over.is_set() and not self._ended.is_set():
            expected += self._period
            try:
                wait_until(expected)
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
    """Expected and actual times of the current and previous calls by a ROS node's timer, like rospy's
    TimerEvent.
    """

    def __init__(
        self, last_expected: Any, last_real: Any, current_expected: Any, current_real: Any, last_duration: Any
    ):
        self.last_expected, self.last_real = last_expected, last_real
        self.current_expected, self.current_real = current_expected, current_real
        self.last_duration = last_duration
