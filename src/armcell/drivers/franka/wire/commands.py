"""TCP commands of the Franka Control Interface (port 1337), protocol versions 5 and 10.

A Panda with system 4.2 speaks version 5, an FR3 with system 5.9 or later version 10. All messages are packed
little-endian. Source: Franka's public headers `libfranka-common` (Apache-2.0; version 5: as in libfranka
0.9.2) and the interface documentation; the layouts were checked with the clients `panda-python` (version 5),
`pylibfranka` and `franky-control` (version 10).
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum, IntEnum

PORT = 1337
MAX_MESSAGE = 1 << 20  # bytes; a robot model is the largest message

HEADER = struct.Struct("<III")
"""Command, identifier of the request, and size of the whole message in bytes."""


class Command(Enum):
    """Command to a Franka robot in any version of the protocol.
    `Protocol.code` returns the number that encodes it.
    """

    CONNECT = "connect"
    MOVE = "move"
    STOP_MOVE = "stop move"
    GET_CARTESIAN_LIMIT = "get Cartesian limit"
    SET_COLLISION_BEHAVIOR = "set collision behavior"
    SET_JOINT_IMPEDANCE = "set joint impedance"
    SET_CARTESIAN_IMPEDANCE = "set Cartesian impedance"
    SET_GUIDING_MODE = "set guiding mode"
    SET_EE_TO_K = "set EE to K"
    SET_NE_TO_EE = "set NE to EE"
    SET_LOAD = "set load"
    SET_FILTERS = "set filters"
    AUTOMATIC_ERROR_RECOVERY = "automatic error recovery"
    GET_ROBOT_MODEL = "get robot model"
    LOAD_MODEL_LIBRARY = "load model library"


REQUESTS: dict[Command, struct.Struct] = {
    Command.CONNECT: struct.Struct("<HH"),  # protocol version, UDP port of the client
    Command.MOVE: struct.Struct("<II6dB7d"),  # see MoveRequest; version 5 ends after the deviations
    Command.STOP_MOVE: struct.Struct("<"),
    Command.GET_CARTESIAN_LIMIT: struct.Struct("<i"),  # number of the virtual wall
    # torque thresholds (7) lower and upper during acceleration, lower and upper nominal; force
    # thresholds (6) in the same order
    Command.SET_COLLISION_BEHAVIOR: struct.Struct("<52d"),
    Command.SET_JOINT_IMPEDANCE: struct.Struct("<7d"),  # [Nm/rad]
    Command.SET_CARTESIAN_IMPEDANCE: struct.Struct("<6d"),  # [N/m], [Nm/rad]
    Command.SET_GUIDING_MODE: struct.Struct("<7?"),  # x, y, z, R, P, Y, elbow
    Command.SET_EE_TO_K: struct.Struct("<16d"),  # column-major
    Command.SET_NE_TO_EE: struct.Struct("<16d"),  # column-major
    Command.SET_LOAD: struct.Struct("<13d"),  # mass [kg], center in the flange (3) [m], inertia (9)
    Command.SET_FILTERS: struct.Struct("<5d"),  # cut-off frequencies [Hz] of the client's signals
    Command.AUTOMATIC_ERROR_RECOVERY: struct.Struct("<"),
    Command.GET_ROBOT_MODEL: struct.Struct("<"),
    Command.LOAD_MODEL_LIBRARY: struct.Struct("<BB"),  # processor, operating system
}
"""Payload of each request in version 10 or, for commands that it no longer has, in version 5."""

CARTESIAN_LIMIT = struct.Struct("<3d16d?")  # size [m], frame (column-major), whether the wall is active
CONNECTED = struct.Struct("<BH")  # status, protocol version of the robot
STATUS = struct.Struct("<B")


class ConnectStatus(IntEnum):
    SUCCESS = 0
    INCOMPATIBLE_VERSION = 1


class SetterStatus(IntEnum):
    """Status in the answer to a TCP command that sets a parameter of a Franka robot."""

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
    """Type of the controller that tracks a Franka motion (joint impedance, Cartesian impedance or external),
    as encoded in the Move command.
    """

    JOINT_IMPEDANCE = 0
    CARTESIAN_IMPEDANCE = 1
    EXTERNAL = 2


class MoveGenerator(IntEnum):
    """Motion generator in Franka's Move command. The robot state message encodes each generator as this
    number plus 1.
    """

    JOINT_POSITION = 0
    JOINT_VELOCITY = 1
    CARTESIAN_POSITION = 2
    CARTESIAN_VELOCITY = 3
    NONE = 4


_SAFETY = ("PREEMPTED_BY_SAFETY", "REJECTED_BY_SAFETY", "SAFETY_FUNCTION")  # not in version 5
_STATUSES: Mapping[Command, type[IntEnum]] = {
    Command.CONNECT: ConnectStatus,
    Command.MOVE: MoveStatus,
    Command.STOP_MOVE: StopStatus,
    Command.AUTOMATIC_ERROR_RECOVERY: RecoveryStatus,
}


@dataclass(frozen=True)
class Protocol:
    """Codes and layouts in one version of Franka's command protocol.

    Attributes:
        commands: all commands of the version, in the order of their codes.
        requests: payload of each request, without the header.
        without: statuses of version 10 that this version does not have.
    """

    version: int
    commands: tuple[Command, ...]
    requests: Mapping[Command, struct.Struct]
    without: tuple[str, ...] = ()

    def code(self, command: Command) -> int:
        return self.commands.index(command)

    def command(self, code: int) -> Command | None:
        return self.commands[code] if code < len(self.commands) else None

    def status_code(self, status: IntEnum) -> int:
        """Return the number that encodes a status of a Franka command."""
        return self._statuses(type(status)).index(status)

    def status(self, command: Command, code: int) -> IntEnum:
        """Decode the status contained in the answer to a Franka command.

        Raises:
            WireError: the version has no such status.
        """
        known = self._statuses(_STATUSES.get(command, SetterStatus))
        if code >= len(known):
            raise WireError(f"status {code} in the answer to the command {command.value!r}")
        return known[code]

    def _statuses(self, kind: type[IntEnum]) -> list[IntEnum]:
        return [status for status in kind if status.name not in self.without]


def _protocols() -> dict[int, Protocol]:
    old = {Command.GET_CARTESIAN_LIMIT, Command.SET_FILTERS, Command.LOAD_MODEL_LIBRARY}
    of_10 = tuple(c for c in Command if c not in old)
    of_5 = tuple(c for c in Command if c is not Command.GET_ROBOT_MODEL)
    return {
        10: Protocol(10, of_10, REQUESTS),
        5: Protocol(5, of_5, {**REQUESTS, Command.MOVE: struct.Struct("<II6d")}, _SAFETY),
    }


PROTOCOLS = _protocols()
"""Supported versions of the protocol, newest first."""
NEWEST = PROTOCOLS[10]


@dataclass(frozen=True)
class MoveRequest:
    """Request for Franka's Move command, which starts a motion.

    Attributes:
        path_deviation, goal_deviation: largest translation [m], rotation [rad] and elbow angle [rad].
        interpolate: the robot itself interpolates a slow stream of joint positions; not in version 5.
        max_velocity: largest joint speeds (7,) [rad/s] of such an interpolation.
    """

    controller: MoveController
    generator: MoveGenerator
    path_deviation: tuple[float, float, float] = (10.0, 3.12, 6.28)
    goal_deviation: tuple[float, float, float] = (10.0, 3.12, 6.28)
    interpolate: bool = False
    max_velocity: tuple[float, ...] = (0.0,) * 7

    def pack(self, protocol: Protocol = NEWEST) -> bytes:
        """Encode Franka's Move command.
        The interpolation fields are omitted if the protocol version does not support interpolation.
        """
        values = (
            self.controller, self.generator, *self.path_deviation, *self.goal_deviation,
            self.interpolate, *self.max_velocity,
        )  # fmt: skip
        return protocol.requests[Command.MOVE].pack(*(values if protocol.version > 5 else values[:8]))

    @classmethod
    def unpack(cls, payload: bytes, protocol: Protocol = NEWEST) -> MoveRequest:
        """Decode Franka's Move command.

        Raises:
            ValueError: a mode is not known.
        """
        controller, generator, *rest = protocol.requests[Command.MOVE].unpack(payload)
        motion = MoveController(controller), MoveGenerator(generator), tuple(rest[0:3]), tuple(rest[3:6])
        return cls(*motion, bool(rest[6]), tuple(rest[7:14])) if len(rest) > 6 else cls(*motion)


def message(command: int, identifier: int, payload: bytes = b"") -> bytes:
    """Encode a TCP command of the Franka Control Interface, or an answer to it, including the header."""
    return HEADER.pack(command, identifier, HEADER.size + len(payload)) + payload


class WireError(ValueError):
    """Error for a TCP command or answer that violates Franka's protocol."""


def take_message(received: bytearray) -> tuple[int, int, bytes] | None:
    """Remove the first complete Franka command or answer from a buffer of TCP data, and return it.

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
