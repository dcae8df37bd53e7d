"""Frames: `u32 n | n bytes destination | u32 m | m bytes body`, little-endian, both ways.

A destination with two leading underscores is a command whose body is a JSON object; any other is a topic
or service with a serialised message. Eight zero bytes are a keep-alive.
"""

from __future__ import annotations

import json
import struct
from typing import Any, NamedTuple

from armcell.core import ArmcellError

KEEP_ALIVE = b"\0" * 8
MAX_DESTINATION = 1024  # [bytes]
MAX_COMMAND = 1 << 20  # [bytes] of a command's JSON
MAX_BODY = 64 << 20  # [bytes] default cap of a message
_U32 = struct.Struct("<I")


class FrameError(ArmcellError):
    """Bytes after which the stream cannot be followed any more: the connection has to be closed."""


class Frame(NamedTuple):
    """One frame as it came. `terminated`: its destination ended in NUL, as Unity in ROS 2 mode sends it."""

    destination: str
    body: bytes
    terminated: bool = False

    @property
    def is_keep_alive(self) -> bool:
        return not self.destination and not self.body

    @property
    def is_command(self) -> bool:
        return self.destination.startswith("__")


def head(destination: str, length: int, terminate: bool = False) -> bytes:
    """A frame's bytes before its body.

    Args:
        length: of the body [bytes].
        terminate: end the destination in NUL, as Unity in ROS 2 mode does.
    """
    name = destination.encode() + (b"\0" if terminate else b"")
    return _U32.pack(len(name)) + name + _U32.pack(length)


def command(name: str, params: dict[str, Any], terminate: bool = False) -> bytes:
    """A command's whole frame: `command("__subscribe", {"topic": ..., "message_name": ...})`."""
    body = json.dumps(params, separators=(",", ":")).encode() + (b"\0" if terminate else b"")
    return head(name, len(body), terminate) + body


class CommandError(ArmcellError):
    """A command whose JSON is not what it should be."""


def parameters(body: bytes) -> dict[str, Any]:
    """A command's JSON object.

    Raises:
        CommandError: says what is wrong.
    """
    if len(body) > MAX_COMMAND:
        raise CommandError(f"{len(body)} bytes of JSON, at most {MAX_COMMAND} are taken")
    try:
        found = json.loads(body.rstrip(b"\0").decode() or "{}")
    except (ValueError, RecursionError) as error:  # UnicodeDecodeError is a ValueError
        raise CommandError(f"not JSON: {str(error)[:100]}") from None
    if not isinstance(found, dict):
        raise CommandError(f"a JSON object is needed, not a {type(found).__name__}")
    return found


class FrameReader:
    """Cuts a byte stream into frames; any fragmentation will do. Holds no more than was received."""

    def __init__(self, max_body: int = MAX_BODY):
        self._max_body = max_body
        self._buffer = bytearray()

    def feed(self, data: bytes | memoryview) -> list[Frame]:
        """The frames that are whole now.

        Raises:
            FrameError: a length beyond the cap, or a destination that is no text.
        """
        self._buffer += data
        frames = []
        while (frame := self._next()) is not None:
            frames.append(frame)
        return frames

    def _next(self) -> Frame | None:
        buffer = self._buffer
        if len(buffer) < 4:
            return None
        (n,) = _U32.unpack_from(buffer)
        if n > MAX_DESTINATION:
            raise FrameError(f"a name of {n} bytes, at most {MAX_DESTINATION} are taken: not ROS-TCP?")
        if len(buffer) < 8 + n:
            return None
        (m,) = _U32.unpack_from(buffer, 4 + n)
        if m > self._max_body:
            raise FrameError(f"a message of {m} bytes, at most {self._max_body} are taken")
        if len(buffer) < 8 + n + m:
            return None
        raw = bytes(buffer[4 : 4 + n])
        with memoryview(buffer) as view:
            body = bytes(view[8 + n : 8 + n + m])
        del buffer[: 8 + n + m]
        try:
            return Frame(raw.rstrip(b"\0").decode(), body, raw.endswith(b"\0"))
        except UnicodeDecodeError:
            raise FrameError(f"a name that is no UTF-8: {raw[:40]!r}") from None
