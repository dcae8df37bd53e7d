"""Messages between an arm's driver and its worker process, over a stream socket."""

from __future__ import annotations

import json
import socket
import struct
from typing import Any

_HEAD = struct.Struct("<IB")  # size of the content, its kind
ORDER, ROWS, STATE, EVENT = range(4)
PROGRESS = struct.Struct("<dId")  # receive time of the state [s], number of the motion, its clock [s]


def pack(kind: int, content: bytes) -> bytes:
    """Encode a message as a frame for the stream socket that connects
    the Franka driver and its worker process.
    """
    return _HEAD.pack(len(content), kind) + content


def pack_json(kind: int, value: dict[str, Any]) -> bytes:
    return pack(kind, json.dumps(value).encode())


def take_message(received: bytearray) -> tuple[int, bytes] | None:
    """Remove the first complete message between the Franka driver and its worker from a buffer. Return the
    kind and content of the message, or None if no message is complete.
    """
    if len(received) < _HEAD.size:
        return None
    size, kind = _HEAD.unpack_from(received)
    if len(received) < _HEAD.size + size:
        return None
    content = bytes(received[_HEAD.size : _HEAD.size + size])
    del received[: _HEAD.size + size]
    return kind, content


def read_into(sock: socket.socket, received: bytearray) -> bool:
    """Read the bytes of messages between the Franka driver and its worker from a socket into a buffer. Return
    False if the socket is closed.
    """
    try:
        data = sock.recv(1 << 18)
    except BlockingIOError:
        return True
    except OSError:
        return False
    received += data
    return bool(data)
