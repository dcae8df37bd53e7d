"""TCP commands of the Franka Control Interface (port 1337), protocol version 10.

All messages are packed little-endian. Source: Franka's public headers `libfranka-common` (Apache-2.0) and
the interface documentation; the layouts were checked with the clients `pylibfranka` and `franky-control`.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntEnum

PORT = 1337
VERSION = 10
MAX_MESSAGE = 1 << 20  # bytes; a robot model is the largest message

HEADER = struct.Struct("<III")
"""Command, identifier of the request, and size of the whole message in bytes."""


class Command(IntEnum):
    CONNECT = 0
    MOVE = 1
    STOP_MOVE = 2
    SET_COLLISION_BEHAVIOR = 3
    SET_JOINT_IMPEDANCE = 4
    SET_CARTESIAN_IMPEDANCE = 5
    SET_GUIDING_MODE = 6
    SET_EE_TO_K = 7
    SET_NE_TO_EE = 8
    SET_LOAD = 9
    AUTOMATIC_ERROR_RECOVERY = 10
    GET_ROBOT_MODEL = 11


REQUESTS: dict[Command, struct.Struct] = {
    Command.CONNECT: struct.Struct("<HH"),  # protocol version, UDP port of the client
    Command.MOVE: struct.Struct("<II6dB7d"),  # see MoveRequest
    Command.STOP_MOVE: struct.Struct("<"),
    # torque thresholds (7) lower and upper during acceleration, lower and upper nominal; force
    # thresholds (6) in the same order
    Command.SET_COLLISION_BEHAVIOR: struct.Struct("<52d"),
    Command.SET_JOINT_IMPEDANCE: struct.Struct("<7d"),  # [Nm/rad]
    Command.SET_CARTESIAN_IMPEDANCE: struct.Struct("<6d"),  # [N/m], [Nm/rad]
    Command.SET_GUIDING_MODE: struct.Struct("<7?"),  # x, y, z, R, P, Y, elbow
    Command.SET_EE_TO_K: struct.Struct("<16d"),  # column-major
    Command.SET_NE_TO_EE: struct.Struct("<16d"),  # column-major
    Command.SET_LOAD: struct.Struct("<13d"),  # mass [kg], center in the flange (3) [m], inertia (9)
    Command.AUTOMATIC_ERROR_RECOVERY: struct.Struct("<"),
    Command.GET_ROBOT_MODEL: struct.Struct("<"),
}
"""Payload of each request, without the header."""

CONNECTED = struct.Struct("<BH")  # status, protocol version of the robot
STATUS = struct.Struct("<B")


class ConnectStatus(IntEnum):
    SUCCESS = 0
    INCOMPATIBLE_VERSION = 1


class SetterStatus(IntEnum):
    """Status in the answer to a TCP command that sets a Franka robot's parameter."""

    SUCCESS = 0
    NOT_POSSIBLE = 1
    INVALID_ARGUMENT = 2
    SAFETY_FUNCTION = 3


class MoveStatus(IntEnum):
    SUCCESS = 0
    STARTED = 1
    PREEMPTED = 2
    PREEMPTED_BY_SAFETY = 3
    REJECTED_BY_SAFETY = 4
    NOT_POSSIBLE = 5
    START_AT_SINGULAR_POSE = 6
    INVALID_ARGUMENT = 7
    REFLEX_ABORTED = 8
    EMERGENCY_ABORTED = 9
    INPUT_ERROR_ABORTED = 10
    ABORTED = 11


class StopStatus(IntEnum):
    SUCCESS = 0
    NOT_POSSIBLE = 1
    SAFETY_FUNCTION = 2
    EMERGENCY_ABORTED = 3
    REFLEX_ABORTED = 4
    ABORTED = 5


class RecoveryStatus(IntEnum):
    SUCCESS = 0
    NOT_POSSIBLE = 1
    SAFETY_FUNCTION = 2
    MANUAL_RECOVERY_REQUIRED = 3
    REFLEX_ABORTED = 4
    EMERGENCY_ABORTED = 5
    ABORTED = 6


class MoveController(IntEnum):
    """Controller of a Franka motion, as encoded in the Move command."""

    JOINT_IMPEDANCE = 0
    CARTESIAN_IMPEDANCE = 1
    EXTERNAL = 2


class MoveGenerator(IntEnum):
    """Motion generator in Franka's Move command; the state message counts from 1."""

    JOINT_POSITION = 0
    JOINT_VELOCITY = 1
    CARTESIAN_POSITION = 2
    CARTESIAN_VELOCITY = 3
    NONE = 4


@dataclass(frozen=True)
class MoveRequest:
    """Request of Franka's Move command, which starts a motion.

    Attributes:
        path_deviation, goal_deviation: largest translation [m], rotation [rad] and elbow angle [rad].
        interpolate: the robot itself interpolates a slow stream of joint positions.
        max_velocity: largest joint speeds (7,) [rad/s] of such an interpolation.
    """

    controller: MoveController
    generator: MoveGenerator
    path_deviation: tuple[float, float, float] = (10.0, 3.12, 6.28)
    goal_deviation: tuple[float, float, float] = (10.0, 3.12, 6.28)
    interpolate: bool = False
    max_velocity: tuple[float, ...] = (0.0,) * 7

    def pack(self) -> bytes:
        return REQUESTS[Command.MOVE].pack(
            self.controller, self.generator, *self.path_deviation, *self.goal_deviation,
            self.interpolate, *self.max_velocity,
        )  # fmt: skip

    @classmethod
    def unpack(cls, payload: bytes) -> MoveRequest:
        """Decode a Move request.

        Raises:
            ValueError: a mode is not known.
        """
        controller, generator, *rest = REQUESTS[Command.MOVE].unpack(payload)
        return cls(
            MoveController(controller), MoveGenerator(generator), tuple(rest[0:3]), tuple(rest[3:6]),
            bool(rest[6]), tuple(rest[7:14]),
        )  # fmt: skip


def message(command: int, identifier: int, payload: bytes = b"") -> bytes:
    """Encode a TCP command of the Franka Control Interface, or its answer, with its header."""
    return HEADER.pack(command, identifier, HEADER.size + len(payload)) + payload


class WireError(ValueError):
    """Error for a TCP command or answer that does not follow Franka's protocol."""


def take_message(received: bytearray) -> tuple[int, int, bytes] | None:
    """Remove and return the first complete Franka command or answer of a TCP buffer.

    Returns:
        Command, identifier and payload; None if the buffer has no complete message.
    Raises:
        WireError: the header's size is impossible.
    """
    if len(received) < HEADER.size:
        return None
    command, identifier, size = HEADER.unpack_from(received)
    if not HEADER.size <= size <= MAX_MESSAGE:
        raise WireError(f"a message of {size} bytes is not possible")
    if len(received) < size:
        return None
    payload = bytes(received[HEADER.size : size])
    del received[:size]
    return command, identifier, payload
