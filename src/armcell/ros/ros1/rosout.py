"""Logs on /rosout, and the services with which rqt_logger_level sets log levels."""

from __future__ import annotations

import logging
import threading
from typing import Any

from armcell.core import InputError, UnknownNameError
from armcell.ros.bus import Bus

TOPIC, AGGREGATED = "/rosout", "/rosout_agg"
TYPE = "rosgraph_msgs/Log"
LEVELS = {"debug": logging.DEBUG, "info": logging.INFO, "warn": logging.WARNING, "error": logging.ERROR,
          "fatal": logging.CRITICAL}  # fmt: skip
NUMBERS = {"debug": 1, "info": 2, "warn": 4, "error": 8, "fatal": 16}  # rosgraph_msgs/Log


def level_name(level: int) -> str:
    """Return the ROS name of a Python log level, for /rosout and rqt_logger_level."""
    return next((name for name, value in reversed(LEVELS.items()) if level >= value), "debug")


class RosOut(logging.Handler):
    """Publisher that sends the log records of armcell to /rosout, from `start` to `close`.

    Args:
        node: full name of the node that appears as the source of the records.
        aggregate: also publish the log records of all nodes on /rosout_agg, like the rosout node of roscore.
    """

    def __init__(self, bus: Bus, node: str, aggregate: bool = False):
        super().__init__(logging.DEBUG)
        self._bus, self._node = bus, node
        self._root = logging.getLogger("armcell")
        self._inside = threading.local()
        self._publisher = bus.advertise(TOPIC, TYPE, latch=True)
        self._members: list[Any] = [
            self._publisher,
            bus.serve(f"{node}/get_loggers", "roscpp/GetLoggers", self._get),
            bus.serve(f"{node}/set_logger_level", "roscpp/SetLoggerLevel", self._set),
        ]
        if aggregate:
            self._all = bus.advertise(AGGREGATED, TYPE)
            self._members += [self._all, bus.subscribe(TOPIC, TYPE, self._all.publish, 1000)]

    def start(self) -> None:
        self._root.addHandler(self)

    def close(self) -> None:
        self._root.removeHandler(self)
        for member in self._members:
            member.close()
        super().close()

    def emit(self, record: logging.LogRecord) -> None:
        if getattr(self._inside, "busy", False):  # ignore records that publishing itself logs
            return
        self._inside.busy = True
        try:
            level = level_name(record.levelno)
            self.say(level, record.getMessage(), record.filename, record.funcName, record.lineno)
        except Exception:
            self.handleError(record)
        finally:
            self._inside.busy = False

    def say(self, level: str, text: str, file: str = "", function: str = "", line: int = 0) -> None:
        """Publish a log line on /rosout."""
        if self._publisher.closed:
            return
        message = self._bus.schema.new(
            TYPE, header=self._bus.header(), level=NUMBERS[level], name=self._node, msg=text, file=file,
            function=function, line=line,
        )  # fmt: skip
        self._publisher.publish(message)

    # --- services ---
    def _loggers(self) -> dict[str, logging.Logger]:
        manager = logging.Logger.manager.loggerDict
        return {n: logging.getLogger(n) for n in ("armcell", *manager) if n.split(".")[0] == "armcell"}

    def _get(self, request: Any) -> Any:
        new = self._bus.schema.new
        loggers = [
            new("roscpp/Logger", name, level_name(logger.getEffectiveLevel()))
            for name, logger in sorted(self._loggers().items())
        ]
        return new("roscpp/GetLoggersResponse", loggers)

    def _set(self, request: Any) -> Any:
        level = request.level.lower()
        if level not in LEVELS:
            raise UnknownNameError("level", request.level, LEVELS)
        logger = self._loggers().get(request.logger)
        if logger is None:
            raise InputError(f"no logger is called {request.logger[:80]!r}")
        logger.setLevel(LEVELS[level])
        return self._bus.schema.new("roscpp/SetLoggerLevelResponse")
