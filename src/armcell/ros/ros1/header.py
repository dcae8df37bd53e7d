"""TCPROS connection headers: encoding, parsing and reading from a socket.

Format: `u32 length`, then fields `u32 length | key=value`, all little-endian. Source: wiki.ros.org/ROS/TCPROS
and wiki.ros.org/ROS/Connection%20Header.
"""

from __future__ import annotations

import socket
import struct
from collections.abc import Mapping

from armcell.ros.codec import WireError

LENGTH = struct.Struct("<I")
MAX_HEADER = 1 << 20  # [bytes] headers contain the full text of a message definition
MAX_FIELDS = 64

Fields = dict[str, str]


def encode_header(fields: Mapping[str, str]) -> bytes:
    """Encode the connection header of TCPROS as bytes. The result includes the length prefix."""
    lines = [f"{key}={value}".encode() for key, value in sorted(fields.items())]
    body = b"".join(LENGTH.pack(len(line)) + line for line in lines)
    return LENGTH.pack(len(body)) + body


def decode_header(body: bytes) -> Fields:
    """Parse a TCPROS connection header, given without its length prefix, and return its fields.

    Raises:
        WireError: the bytes are not a valid header.
    """
    fields: Fields = {}
    at = count = 0
    while at < len(body):
        count += 1
        if at + 4 > len(body) or count > MAX_FIELDS:
            raise WireError("a connection header ends in the middle of a field, or has too many")
        (size,) = LENGTH.unpack_from(body, at)
        at += 4
        if size == 0 or at + size > len(body):
            raise WireError("a field of a connection header is longer than the header")
        try:
            key, equals, value = body[at : at + size].decode().partition("=")
        except UnicodeDecodeError:
            raise WireError("a connection header is no text") from None
        if not equals:
            raise WireError(f"a field of a connection header has no '=': {key[:60]!r}")
        fields[key.strip()] = value
        at += size
    return fields


def receive(sock: socket.socket) -> Fields:
    """Read a TCPROS connection header from a socket. The timeout of the socket applies to each read.

    Raises:
        WireError: the received bytes are not a valid header.
        OSError: the connection broke, or the timeout ran out.
    """
    (size,) = LENGTH.unpack(read_exactly(sock, 4))
    if size > MAX_HEADER:
        raise WireError(f"a connection header of {size} bytes")
    return decode_header(read_exactly(sock, size))


def read_exactly(sock: socket.socket, count: int) -> bytes:
    """Read exactly `count` bytes from a socket, for the header or the body of a TCPROS message.

    Raises:
        ConnectionError: the peer closed the connection before `count` bytes arrived.
    """
    parts = []
    while count > 0:
        part = sock.recv(min(count, 1 << 20))
        if not part:
            raise ConnectionError("the other side closed the connection")
        parts.append(part)
        count -= len(part)
    return b"".join(parts)
