"""Shim of rospy: nodes, topics, services, parameters, time and logging on the bus.

Source of names, defaults and exceptions: rospy's documentation (docs.ros.org/en/noetic/api/rospy).
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

from armcell.core import UnknownNameError
from armcell.moveit.ros_time import Duration, Time
from armcell.moveit.session import current_session
from armcell.moveit.shims.ros_node import (
    Rate,
    ROSException,
    ROSInitException,
    ROSInterruptException,
    ROSSerializationException,
    ROSTimeMovedBackwardsException,
    ServiceException,
    Timer,
    TimerEvent,
    TransportException,
    get_caller_id,
    get_name,
    get_namespace,
    get_node_uri,
    get_ros_root,
    get_rostime,
    get_time,
    init_node,
    is_initialized,
    is_shutdown,
    myargv,
    on_shutdown,
    resolve_name,
    resolved,
    signal_shutdown,
    sleep,
    spin,
)
from armcell.moveit.shims.ros_topics_services import (
    Publisher,
    Service,
    ServiceProxy,
    Subscriber,
    get_published_topics,
    wait_for_message,
    wait_for_service,
)

DEBUG, INFO, WARN, ERROR, FATAL = 1, 2, 4, 8, 16


# --- parameters ---
_NONE = object()


def get_param(param_name: str, default: Any = _NONE) -> Any:
    parameters = current_session().bus.parameters
    try:
        return parameters.get(resolved(param_name))
    except UnknownNameError:
        if default is _NONE:
            raise KeyError(param_name) from None
        return default


def get_param_cached(param_name: str, default: Any = _NONE) -> Any:
    return get_param(param_name, default)


def set_param(param_name: str, param_value: Any) -> None:
    current_session().bus.parameters.set(resolved(param_name), param_value)


def has_param(param_name: str) -> bool:
    return resolved(param_name) in current_session().bus.parameters


def delete_param(param_name: str) -> None:
    try:
        current_session().bus.parameters.delete(resolved(param_name))
    except UnknownNameError:
        raise KeyError(param_name) from None


def search_param(param_name: str) -> str | None:
    return resolved(param_name) if has_param(param_name) else None


def get_param_names() -> list[str]:
    return current_session().bus.parameters.names()


# --- logging ---
_CLOSE = re.compile(r"\bclose (the )?gripper\b", re.IGNORECASE)


def _log(level: str, message: Any, args: tuple[Any, ...]) -> None:
    text = str(message) % args if args else str(message)
    current_session().say(level, text)
    if _CLOSE.search(text):
        current_session().claims_to_close = True


def logdebug(msg: Any, *args: Any, **kwargs: Any) -> None:
    """Ignore a debug message, because rospy.logdebug shows nothing by default."""


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
        key, now, last = (level, str(msg)), get_time(), current_session().logged
        if now - last.get(key, -1e18) >= period or now < last.get(key, 0.0):
            last[key] = now
            _log(level, msg, args)

    return log


def _once(level: str) -> Callable[..., None]:
    def log(msg: Any, *args: Any) -> None:
        key, logged = (f"{level} once", str(msg)), current_session().logged
        if key not in logged:
            logged[key] = get_time()
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
    """Discard the debug message. rospy's `logdebug_throttle` logs a message at most once per `period` [s],
    but rospy hides debug messages by default.
    """


def logdebug_once(msg: Any, *args: Any) -> None:
    """Ignore a debug message that would be logged only once,
    because rospy does not show debug messages by default.
    """


class _Exceptions:
    """Namespace of the exceptions in `rospy.exceptions`."""

    ROSException, ROSInterruptException, ROSInitException = (
        ROSException,
        ROSInterruptException,
        ROSInitException,
    )


exceptions = _Exceptions
AnyMsg = object

__all__ = [
    "DEBUG",
    "ERROR",
    "FATAL",
    "INFO",
    "WARN",
    "AnyMsg",
    "Duration",
    "Publisher",
    "ROSException",
    "ROSInitException",
    "ROSInterruptException",
    "ROSSerializationException",
    "ROSTimeMovedBackwardsException",
    "Rate",
    "Service",
    "ServiceException",
    "ServiceProxy",
    "Subscriber",
    "Time",
    "Timer",
    "TimerEvent",
    "TransportException",
    "delete_param",
    "exceptions",
    "get_caller_id",
    "get_name",
    "get_namespace",
    "get_node_uri",
    "get_param",
    "get_param_cached",
    "get_param_names",
    "get_published_topics",
    "get_ros_root",
    "get_rostime",
    "get_time",
    "has_param",
    "init_node",
    "is_initialized",
    "is_shutdown",
    "logdebug",
    "logdebug_once",
    "logdebug_throttle",
    "logerr",
    "logerr_once",
    "logerr_throttle",
    "logerror",
    "logfatal",
    "logfatal_once",
    "loginfo",
    "loginfo_once",
    "loginfo_throttle",
    "logout",
    "logwarn",
    "logwarn_once",
    "logwarn_throttle",
    "logwarning",
    "myargv",
    "on_shutdown",
    "resolve_name",
    "search_param",
    "set_param",
    "signal_shutdown",
    "sleep",
    "spin",
    "wait_for_message",
    "wait_for_service",
]
