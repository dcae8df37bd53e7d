"""Protocol of the Franka Hand (TCP port 1338 and its UDP state), version 3.

All messages are packed little-endian. Source: Franka's public headers `libfranka-common` (Apache-2.0).
"""

from __future__ import annotations

import struct
from enum import IntEnum

from armcell.drivers.franka.wire.commands import MAX_MESSAGE, WireError

PORT = 1338
VERSION = 3

HEADER = struct.Struct("<HII")  # command, identifier, size of the whole message
STATE = struct.Struct("<Idd?H")  # identifier, width [m], largest width [m], grasped, temperature [C]
CONNECTED = struct.Struct("<HH")  # status, version
STATUS = struct.Struct("<H")


class Command(IntEnum):
    CONNECT = 0
    HOMING = 1
    GRASP = 2
    MOVE = 3
    STOP = 4


class Status(IntEnum):
    SUCCESS = 0
    FAIL = 1  # the command was not possible
    UNSUCCESSFUL = 2  # the command ended without its goal: no object in the grasp
    ABORTED = 3  # another command or a stop


REQUESTS: dict[Command, struct.Struct] = {
    Command.CONNECT: struct.Struct("<HH"),  # version, UDP port of the client
    Command.HOMING: struct.Struct("<"),
    Command.GRASP: struct.Struct("<5d"),  # width, inner and outer tolerance [m], speed [m/s], force [N]
    Command.MOVE: struct.Struct("<2d"),  # width [m], speed [m/s]
    Command.STOP: struct.Struct("<"),
}


def message(command: int, identifier: int, payload: bytes = b"") -> bytes:
    """Encode a request to a gripper, or its answer,
    in the protocol of the Franka Hand, including the header.
    """
    return HEADER.pack(command, identifier, HEADER.size + len(payload)) + payload


def take_message(received: bytearray) -> tuple[int, int, bytes] | None:
    """Remove the first complete message of the Franka Hand (gripper) from a buffer, and return it."""
    if len(received) < HEADER.size:
        return None
    command, identifier, size = HEADER.unpack_from(received)
    if not HEADER.size <= size <= MAX_MESSAGE:
        raise WireError(f"a gripper message of {size} bytes is not possible")
    if len(received) < size:
        return None
    payload = bytes(received[HEADER.size : size])
    del received[:size]
    return command, identifier, payload
