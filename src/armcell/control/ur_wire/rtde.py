"""RTDE frames: uint16 size (big-endian, header included), uint8 type, then the payload.

Source: Universal Robots, "Real-Time Data Exchange (RTDE) Guide", protocol version 2.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from armcell.core import ArmcellError

PORT = 30004
HEADER = struct.Struct(">HB")
VERSION, CONTROLLER_VERSION, MESSAGE = ord("V"), ord("v"), ord("M")
SETUP_OUTPUTS, SETUP_INPUTS = ord("O"), ord("I")
START, PAUSE, DATA = ord("S"), ord("P"), ord("U")
MAX_NAMES = 2048  # bytes of a list of names

_CODES = {
    "BOOL": "?", "UINT8": "B", "UINT32": "I", "UINT64": "Q", "INT32": "i", "DOUBLE": "d",
    "VECTOR3D": "3d", "VECTOR6D": "6d", "VECTOR6INT32": "6i", "VECTOR6UINT32": "6I",
}  # fmt: skip

_V6 = (
    "target_q target_qd target_qdd target_current target_moment actual_q actual_qd actual_current "
    "joint_control_output actual_TCP_pose actual_TCP_speed actual_TCP_force target_TCP_pose "
    "target_TCP_speed joint_temperatures actual_joint_voltage tcp_offset actual_current_as_torque "
    "ft_raw_wrench"
)
_DOUBLES = (
    "timestamp actual_execution_time speed_scaling target_speed_fraction actual_momentum "
    "actual_main_voltage actual_robot_voltage actual_robot_current standard_analog_input0 "
    "standard_analog_input1 standard_analog_output0 standard_analog_output1 tool_analog_input0 "
    "tool_analog_input1 tool_output_current tool_temperature tcp_force_scalar payload io_current "
    "joint_position_deviation_ratio collision_detection_ratio"
)

_VECTORS = "actual_tool_accelerometer payload_cog elbow_position elbow_velocity"
_INTS = "robot_mode safety_mode safety_status tool_output_voltage time_scale_source"
_UINTS = (
    "runtime_state robot_status_bits safety_status_bits analog_io_types tool_analog_input_types "
    "output_bit_registers0_to_31 output_bit_registers32_to_63 "
    "input_bit_registers0_to_31 input_bit_registers32_to_63"
)

OUTPUTS: dict[str, str] = {
    **dict.fromkeys(_V6.split(), "VECTOR6D"),
    **dict.fromkeys(_DOUBLES.split(), "DOUBLE"),
    **dict.fromkeys(_VECTORS.split(), "VECTOR3D"),
    "payload_inertia": "VECTOR6D",
    "joint_mode": "VECTOR6INT32",
    **dict.fromkeys(_INTS.split(), "INT32"),
    **dict.fromkeys(_UINTS.split(), "UINT32"),
    "actual_digital_input_bits": "UINT64",
    "actual_digital_output_bits": "UINT64",
    "tool_mode": "UINT8",
    "tool_output_mode": "UINT8",
    **{f"{way}_int_register_{i}": "INT32" for way in ("input", "output") for i in range(48)},
    **{f"{way}_double_register_{i}": "DOUBLE" for way in ("input", "output") for i in range(48)},
    **{f"{way}_bit_register_{i}": "BOOL" for way in ("input", "output") for i in range(64, 128)},
}
"""What a controller can tell: name -> type."""

INPUTS: dict[str, str] = {
    "speed_slider_mask": "UINT32",
    "speed_slider_fraction": "DOUBLE",
    "standard_digital_output_mask": "UINT8",
    "standard_digital_output": "UINT8",
    "configurable_digital_output_mask": "UINT8",
    "configurable_digital_output": "UINT8",
    "tool_digital_output_mask": "UINT8",
    "tool_digital_output": "UINT8",
    "standard_analog_output_mask": "UINT8",
    "standard_analog_output_type": "UINT8",
    "standard_analog_output_0": "DOUBLE",
    "standard_analog_output_1": "DOUBLE",
    "input_bit_registers0_to_31": "UINT32",
    "input_bit_registers32_to_63": "UINT32",
    "external_force_torque": "VECTOR6D",
    **{f"input_int_register_{i}": "INT32" for i in range(48)},
    **{f"input_double_register_{i}": "DOUBLE" for i in range(48)},
    **{f"input_bit_register_{i}": "BOOL" for i in range(64, 128)},
}
"""What a client can set: name -> type."""


class RtdeError(ArmcellError):
    """The bytes are not RTDE, or the other side refused."""


def frame(kind: int, payload: bytes = b"") -> bytes:
    return HEADER.pack(HEADER.size + len(payload), kind) + payload


def frames(buffer: bytearray) -> Iterator[tuple[int, bytes]]:
    """The complete frames at the buffer's beginning, which are taken off it.

    Raises:
        RtdeError: a size that no frame can have.
    """
    while len(buffer) >= HEADER.size:
        size, kind = HEADER.unpack_from(buffer)
        if size < HEADER.size:
            raise RtdeError(f"a frame of {size} bytes is not RTDE")
        if len(buffer) < size:
            return
        payload = bytes(buffer[HEADER.size : size])
        del buffer[:size]
        yield kind, payload


class Recipe:
    """Names of variables and how their values are laid out after the recipe's id."""

    def __init__(self, names: Sequence[str], types: Sequence[str]):
        self.names, self.types = tuple(names), tuple(types)
        self._struct = struct.Struct(">" + "".join(_CODES[t] for t in types))
        self._widths = [int(_CODES[t][:-1] or 1) for t in types]

    @property
    def size(self) -> int:
        """Bytes of the values."""
        return self._struct.size

    def pack(self, values: Iterable[Any]) -> bytes:
        """Values in the recipe's order; vectors as sequences."""
        flat: list[Any] = []
        for value, width in zip(values, self._widths, strict=True):
            if width == 1:
                flat.append(value)
            else:
                flat.extend(value)
        return self._struct.pack(*flat)

    def unpack(self, payload: bytes) -> dict[str, Any]:
        """Values by name; vectors as tuples.

        Raises:
            RtdeError: wrong length.
        """
        if len(payload) != self._struct.size:
            raise RtdeError(f"{len(payload)} bytes of data, the recipe has {self._struct.size}")
        flat, values, at = self._struct.unpack(payload), {}, 0
        for name, width in zip(self.names, self._widths, strict=True):
            values[name] = flat[at] if width == 1 else flat[at : at + width]
            at += width
        return values


def split_names(text: bytes) -> list[str]:
    """Names of a list; a comma at its end (ur_rtde sends one) counts for nothing."""
    return [name for name in text.decode("ascii", "replace").split(",") if name]
