"""ROS-TCP frames: `u32 n | n bytes destination | u32 m | m bytes body`, little-endian.

Both sides send the same format. A destination with two leading underscores is a command, and its body is a
JSON object. Any other destination is a topic or service, and its body a serialized message. Eight zero bytes
are a keep-alive.
"""

from __future__ import annotations

import json
import struct
from typing import Any, NamedTuple

from armcell.core import ArmcellError

KEEP_ALIVE = b"\0" * 8
MAX_DESTINATION = 1024  # [bytes]
MAX_COMMAND = 1 << 20  # [bytes] maximum of a command's JSON
MAX_BODY = 64 << 20  # [bytes] default maximum of a message
_U32 = struct.Struct("<I")


class FrameError(ArmcellError):
    """Error for a ROS-TCP stream with invalid frames.

    The connection must be closed, because the boundaries of later frames are unknown.
    """


class Frame(NamedTuple):
    """A received ROS-TCP frame.

    `terminated` is True if the destination ended in NUL, as sent by Unity in ROS 2 mode.
    """

    destination: str
    body: bytes
    terminated: bool = False

    @property
    def is_keep_alive(self) -> bool:
        return not self.destination and not self.body

    @property
    def is_command(self) -> bool:
        return self.destination.startswith("__")


def frame_header(destination: str, length: int, terminate: bool = False) -> bytes:
    """Return the header bytes of a ROS-TCP frame, which precede its body.

    Args:
        length: length of the body [bytes].
        terminate: end the destination in NUL, like Unity in ROS 2 mode.
    """
    name = destination.encode() + (b"\0" if terminate else b"")
    return _U32.pack(len(name)) + name + _U32.pack(length)


def command(name: str, params: dict[str, Any], terminate: bool = False) -> bytes:
    """Return the complete frame for a ROS-TCP command.

    Example: `command("__subscribe", {"topic": ..., "message_name": ...})`.
    """
    body = json.dumps(params, separators=(",", ":")).encode() + (b"\0" if terminate else b"")
    return frame_header(name, len(body), terminate) + body


class CommandError(ArmcellError):
    """Error for invalid JSON in a ROS-TCP command frame."""


def parameters(body: bytes) -> dict[str, Any]:
    """Parse the JSON object in a ROS-TCP command frame.

    Raises:
        CommandError: the body is too long, or is not a JSON object.
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
    """Parser that splits a stream of bytes into ROS-TCP frames, however the bytes are fragmented.

    Its buffer never exceeds the bytes received, so a length field alone cannot make it allocate memory.
    """

    def __init__(self, max_body: int = MAX_BODY):
        self._max_body = max_body
        self._buffer = bytearray()

    def feed(self, data: bytes | memoryview) -> list[Frame]:
        """Add received bytes to the parser and return the ROS-TCP frames that are now complete.

        Raises:
            FrameError: a length exceeds its maximum, or a destination is not UTF-8 text.
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
