"""UDP messages of the Franka Control Interface: robot state, motion command, names of errors and reflexes.

Versions 5 and 10. The robot sends a state every millisecond. The state's numbers are float64 in version 5
and float32 in version 10, the command's float64; matrices are column-major. Errors are in the order of the
state message's flags. Source: Franka's public headers `libfranka-common` (Apache-2.0); see `commands`.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.drivers.franka.wire.commands import WireError

ERRORS = (
    "joint_position_limits_violation",
    "cartesian_position_limits_violation",
    "self_collision_avoidance_violation",
    "joint_velocity_violation",
    "cartesian_velocity_violation",
    "force_control_safety_violation",
    "joint_reflex",
    "cartesian_reflex",
    "max_goal_pose_deviation_violation",
    "max_path_pose_deviation_violation",
    "cartesian_velocity_profile_safety_violation",
    "joint_position_motion_generator_start_pose_invalid",
    "joint_motion_generator_position_limits_violation",
    "joint_motion_generator_velocity_limits_violation",
    "joint_motion_generator_velocity_discontinuity",
    "joint_motion_generator_acceleration_discontinuity",
    "cartesian_position_motion_generator_start_pose_invalid",
    "cartesian_motion_generator_elbow_limit_violation",
    "cartesian_motion_generator_velocity_limits_violation",
    "cartesian_motion_generator_velocity_discontinuity",
    "cartesian_motion_generator_acceleration_discontinuity",
    "cartesian_motion_generator_elbow_sign_inconsistent",
    "cartesian_motion_generator_start_elbow_invalid",
    "force_controller_desired_force_tolerance_violation",
    "start_elbow_sign_inconsistent",
    "communication_constraints_violation",
    "power_limit_violation",
    "cartesian_motion_generator_joint_position_limits_violation",
    "cartesian_motion_generator_joint_velocity_limits_violation",
    "cartesian_motion_generator_joint_velocity_discontinuity",
    "cartesian_motion_generator_joint_acceleration_discontinuity",
    "cartesian_position_motion_generator_invalid_frame_flag",
    "controller_torque_discontinuity",
    "joint_p2p_insufficient_torque_for_planning",
    "tau_J_range_violation",
    "instability_detected",
    "joint_move_in_wrong_direction",
    "cartesian_spline_motion_generator_violation",
    "joint_via_motion_generator_planning_joint_limit_violation",
    "base_acceleration_initialization_timeout",
    "base_acceleration_invalid_reading",
)
INDEX = {error: i for i, error in enumerate(ERRORS)}


_FIELDS = (
    ("O_T_EE", 16), ("O_T_EE_d", 16), ("F_T_EE", 16), ("EE_T_K", 16), ("F_T_NE", 16), ("NE_T_EE", 16),
    ("m_ee", 1), ("I_ee", 9), ("F_x_Cee", 3), ("m_load", 1), ("I_load", 9), ("F_x_Cload", 3),
    ("elbow", 2), ("elbow_d", 2), ("tau_J", 7), ("tau_J_d", 7), ("dtau_J", 7), ("q", 7), ("q_d", 7),
    ("dq", 7), ("dq_d", 7), ("ddq_d", 7), ("joint_contact", 7), ("cartesian_contact", 6),
    ("joint_collision", 7), ("cartesian_collision", 6), ("tau_ext_hat_filtered", 7), ("O_F_ext_hat_K", 6),
    ("K_F_ext_hat_K", 6), ("O_dP_EE_d", 6), ("O_ddP_O", 3), ("elbow_c", 2), ("delbow_c", 2),
    ("ddelbow_c", 2), ("O_T_EE_c", 16), ("O_dP_EE_c", 6), ("O_ddP_EE_c", 6), ("theta", 7), ("dtheta", 7),
    ("accelerometer_top", 18), ("accelerometer_bottom", 18),
)  # fmt: skip
"""Names and counts of the state's floats, in order; the message identifier precedes them."""

COUNT = sum(n for _, n in _FIELDS)
_starts = np.cumsum([0, *(n for _, n in _FIELDS)])
FIELDS = {name: slice(int(a), int(a) + n) for (name, n), a in zip(_FIELDS, _starts, strict=False)}
"""Position of each state field in the number array."""
_MODES = struct.Struct("<BB")  # motion generator mode, controller mode
COMMANDS = {10: struct.Struct("<Q7d7d16d6d2dBB7dB"), 5: struct.Struct("<Q7d7d16d6d2dBB7d")}
"""Identifier of the state it answers; q_c, dq_c, O_T_EE_c, O_dP_EE_c, elbow_c, valid elbow, motion finished,
tau_J_d; in version 10 torque finished."""


class StateLayout:
    """Layout of the robot state message in one version of Franka's protocol.

    Attributes:
        count: numbers in the message; version 5 lacks the accelerometers at the end.
        modes: start of the two modes, which follow the numbers.
        rest: robot mode and success rate, at the end.
    """

    def __init__(self, version: int, number: str, count: int):
        self.version, self.count, self.number = version, count, np.dtype(f"<{number}")
        self.modes = 8 + self.number.itemsize * count
        self.rest = struct.Struct(f"<B{self.number.char}")
        self.size = self.modes + _MODES.size + 2 * len(ERRORS) + self.rest.size


STATES = {10: StateLayout(10, "f4", COUNT), 5: StateLayout(5, "f8", FIELDS["accelerometer_top"].start)}
MAX_STATE = max(layout.size for layout in STATES.values())
_BY_SIZE = {layout.size: layout for layout in STATES.values()}


class GeneratorMode(IntEnum):
    IDLE = 0
    JOINT_POSITION = 1
    JOINT_VELOCITY = 2
    CARTESIAN_POSITION = 3
    CARTESIAN_VELOCITY = 4
    NONE = 5


class ControllerMode(IntEnum):
    JOINT_IMPEDANCE = 0
    CARTESIAN_IMPEDANCE = 1
    EXTERNAL = 2
    OTHER = 3


class RobotMode(IntEnum):
    OTHER = 0  # brakes locked, or starting
    IDLE = 1
    MOVE = 2
    GUIDING = 3
    REFLEX = 4
    USER_STOPPED = 5
    AUTOMATIC_ERROR_RECOVERY = 6


_ROBOT_MODES, _GENERATORS, _CONTROLLERS = set(RobotMode), set(GeneratorMode), set(ControllerMode)


class StateMessage:
    """Robot state message of Franka, which is written in place. `bytes(state)` returns the message.

    Attributes:
        numbers: all numbers of the version; `FIELDS` names their positions.
    """

    def __init__(self, version: int = 10) -> None:
        self._layout = layout = STATES[version]
        self._buffer = bytearray(layout.size)
        self.numbers = np.frombuffer(self._buffer, layout.number, layout.count, 8)
        flags, n = layout.modes + _MODES.size, len(ERRORS)
        self.errors: NDArray[np.uint8] = np.frombuffer(self._buffer, np.uint8, n, flags)
        self.reflex_reason: NDArray[np.uint8] = np.frombuffer(self._buffer, np.uint8, n, flags + n)

    def __setitem__(self, field: str, values: ArrayLike) -> None:
        self.numbers[FIELDS[field]] = values

    def write_scalars(
        self, identifier: int, generator: int, controller: int, mode: int, success: float
    ) -> None:
        """Write the scalar fields of Franka's robot state message, that is,
        all fields that are not arrays.
        """
        layout = self._layout
        struct.pack_into("<Q", self._buffer, 0, identifier)
        _MODES.pack_into(self._buffer, layout.modes, generator, controller)
        layout.rest.pack_into(self._buffer, layout.size - layout.rest.size, mode, success)

    def __bytes__(self) -> bytes:
        return bytes(self._buffer)


@dataclass(frozen=True)
class RobotState:
    """State of a Franka robot, as received by UDP.

    Attributes:
        time: message identifier, which counts milliseconds.
        numbers: all numbers of the version.
        errors, last_errors: names of the active errors, and of the errors that ended the last motion.
    """

    time: int
    numbers: NDArray[np.floating]
    generator: int
    controller: int
    mode: int
    success_rate: float
    errors: tuple[str, ...]
    last_errors: tuple[str, ...]

    def __getitem__(self, field: str) -> NDArray[np.float64]:
        return self.numbers[FIELDS[field]].astype(np.float64)


def read_state(data: bytes) -> RobotState:
    """Decode the state message of a Franka robot. Its size determines the protocol version.

    Raises:
        WireError: the message has another size, numbers that are not finite, or unknown modes or flags.
    """
    layout = _BY_SIZE.get(len(data))
    if layout is None:
        sizes = ", ".join(f"version {version} {one.size}" for version, one in STATES.items())
        raise WireError(f"a robot state of {len(data)} bytes; Franka's protocol has {sizes}")
    generator, controller = _MODES.unpack_from(data, layout.modes)
    mode, success = layout.rest.unpack_from(data, layout.size - layout.rest.size)
    numbers = np.frombuffer(data, layout.number, layout.count, 8)
    if not np.isfinite(numbers).all():
        raise WireError("a robot state has numbers that are not finite")
    flags = data[layout.modes + _MODES.size : layout.size - layout.rest.size]
    if max(flags) > 1 or not 0.0 <= success <= 1.0:
        raise WireError("a robot state has flags or a success rate out of range")
    if mode not in _ROBOT_MODES or generator not in _GENERATORS or controller not in _CONTROLLERS:
        raise WireError(f"a robot state has unknown modes: {mode}, {generator}, {controller}")
    n = len(ERRORS)
    return RobotState(
        struct.unpack_from("<Q", data)[0], numbers, generator, controller, mode, success,
        tuple(e for e, on in zip(ERRORS, flags[:n], strict=True) if on),
        tuple(e for e, on in zip(ERRORS, flags[n:], strict=True) if on),
    )  # fmt: skip


@dataclass(frozen=True)
class RobotCommand:
    """Motion command that is sent to a Franka robot in answer to one of its UDP state messages.

    Only the fields of the motion's modes count.
    """

    time: int  # identifier of the state
    q: tuple[float, ...] = (0.0,) * 7
    dq: tuple[float, ...] = (0.0,) * 7
    O_T_EE: tuple[float, ...] = (0.0,) * 16
    O_dP_EE: tuple[float, ...] = (0.0,) * 6
    elbow: tuple[float, ...] = (0.0,) * 2
    valid_elbow: bool = False
    motion_finished: bool = False
    torque: tuple[float, ...] = (0.0,) * 7
    torque_finished: bool = False

    def pack(self, version: int = 10) -> bytes:
        """Encode a motion command to a Franka robot. Version 5 of the protocol lacks the last field, which
        marks the torque command as finished.
        """
        values = (
            self.time, *self.q, *self.dq, *self.O_T_EE, *self.O_dP_EE, *self.elbow, self.valid_elbow,
            self.motion_finished, *self.torque, self.torque_finished,
        )  # fmt: skip
        return COMMANDS[version].pack(*(values if version > 5 else values[:-1]))


def read_command(data: bytes, version: int = 10) -> RobotCommand:
    """Decode a UDP motion command, with which a client answers a Franka robot's state message.

    Raises:
        WireError: the message has another size, or numbers that are not finite.
    """
    layout = COMMANDS[version]
    if len(data) != layout.size:
        raise WireError(f"a command of {len(data)} bytes; protocol {version} has {layout.size}")
    v = layout.unpack(data)
    if not all(map(math.isfinite, v[1:48])):
        raise WireError("a command has numbers that are not finite")
    finished = bool(v[48]) if version > 5 else bool(v[40])
    return RobotCommand(
        v[0], v[1:8], v[8:15], v[15:31], v[31:37], v[37:39], bool(v[39]), bool(v[40]), v[41:48], finished
    )
