"""Robot messages of UR's primary interface (message type 20).

Source: Universal Robots, "Client Interface" documents: uint64 timestamp [us], int8 source, uint8 sub-type,
then the sub-type's own fields; a text without a length prefix extends to the end of the message.
"""

from __future__ import annotations

import struct

from armcell.drivers.ur.wire.primary import ROBOT_MESSAGE, package

TEXT, POPUP, VERSION, SAFETY_MODE, ERROR_CODE, KEY, RUNTIME_EXCEPTION = 0, 2, 3, 5, 6, 7, 10
WARNING = 2  # report level of an error code
CONTROLLER, ROBOT = -3, -1  # source: the program's runtime (0xfd), the controller itself (0xff)
BUILD_DATE = "22-11-2026, 00:00:00"


def _message(timestamp_us: int, source: int, kind: int, body: bytes) -> bytes:
    return package(ROBOT_MESSAGE, struct.pack(">QbB", timestamp_us, source, kind) + body)


def _text(value: str, limit: int = 1000) -> bytes:
    """Encode the text of a UR robot message as ASCII, and truncate it to a length that clients accept."""
    return value.encode("ascii", "replace")[:limit]


def _short(value: str) -> bytes:
    data = _text(value, 255)
    return struct.pack(">B", len(data)) + data


def version(timestamp_us: int, name: str, numbers: tuple[int, int, int], build: int) -> bytes:
    body = _short(name) + struct.pack(">BBii", numbers[0], numbers[1], numbers[2], build) + _text(BUILD_DATE)
    return _message(timestamp_us, ROBOT, VERSION, body)


def text(timestamp_us: int, value: str) -> bytes:
    return _message(timestamp_us, CONTROLLER, TEXT, _text(value))


def popup(timestamp_us: int, title: str, value: str, warning: bool, error: bool, request: int) -> bytes:
    """Encode a UR robot message for a popup that neither asks for input nor blocks the robot program."""
    head = struct.pack(">IB???", request, 0, warning, error, False)
    return _message(timestamp_us, CONTROLLER, POPUP, head + _short(title) + _text(value))


def key(timestamp_us: int, title: str, value: str) -> bytes:
    """Encode a key message of a UR robot, such as PROGRAM_XXX_STARTED, with the name of the program."""
    return _message(timestamp_us, CONTROLLER, KEY, struct.pack(">ii", 0, 0) + _short(title) + _text(value))


def safety_mode(timestamp_us: int, mode: int) -> bytes:
    body = struct.pack(">iiBII", 0, 0, mode, 0, 0)
    return _message(timestamp_us, CONTROLLER, SAFETY_MODE, body)


def runtime_exception(timestamp_us: int, line: int, column: int, value: str) -> bytes:
    """Encode the UR robot message for a runtime error in a program. Lines and columns count from 1."""
    body = struct.pack(">ii", line, column) + _text(value)
    return _message(timestamp_us, CONTROLLER, RUNTIME_EXCEPTION, body)


def error_code(timestamp_us: int, code: int, argument: int, level: int, value: str) -> bytes:
    """Encode the UR robot message for an error in UR's list of errors,
    such as C210 (connection is read-only).
    """
    body = struct.pack(">iiiII", code, argument, level, 0, 0) + _text(value)
    return _message(timestamp_us, CONTROLLER, ERROR_CODE, body)
