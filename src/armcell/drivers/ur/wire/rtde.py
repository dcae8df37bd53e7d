"""RTDE frames: uint16 size (big-endian, header included), uint8 type, then the payload.

Source: Universal Robots, "Real-Time Data Exchange (RTDE) Guide", protocol versions 1 and 2. Variables that
the guide omits (`tool_digital_output`, `tcp_offset`, ...) have the names that UR's client libraries use.
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
REGISTERS = 48  # integer registers, and as many floating-point registers, in each direction
MAX_NAMES = 2048  # largest size of a list of names in bytes

_CODES = {
    "BOOL": "?", "UINT8": "B", "UINT32": "I", "UINT64": "Q", "INT32": "i", "DOUBLE": "d",
    "VECTOR3D": "3d", "VECTOR6D": "6d", "VECTOR6INT32": "6i", "VECTOR6UINT32": "6I",
}  # fmt: skip

_OUTPUT_NAMES = {
    "DOUBLE": """
        timestamp actual_execution_time target_execution_time speed_scaling target_speed_fraction
        actual_momentum actual_main_voltage actual_robot_voltage actual_robot_current io_current
        standard_analog_input0 standard_analog_input1 standard_analog_output0 standard_analog_output1
        tool_analog_input0 tool_analog_input1 tool_output_current tool_temperature tcp_force_scalar payload
        euromap67_24V_voltage euromap67_24V_current joint_position_deviation_ratio
        collision_detection_ratio actual_robot_energy_consumed actual_robot_braking_energy_dissipated""",
    "VECTOR3D": """
        actual_tool_accelerometer elbow_position elbow_velocity payload_cog target_gravity""",
    "VECTOR6D": """
        target_q target_qd target_qdd target_current target_moment actual_q actual_qd actual_current
        actual_current_window actual_current_as_torque joint_control_output joint_temperatures
        actual_joint_voltage actual_TCP_pose actual_TCP_speed actual_TCP_force actual_TCP_acceleration
        target_TCP_pose target_TCP_speed target_TCP_acceleration tcp_offset ft_raw_wrench
        wrench_calc_from_currents payload_inertia target_base_acceleration target_base_wrench""",
    "VECTOR6INT32": "joint_mode",
    "INT32": """
        robot_mode safety_mode safety_status tool_output_voltage time_scale_source encoder0_raw
        encoder1_raw""",
    "UINT8": "tool_output_mode tool_digital_output0_mode tool_digital_output1_mode",
    "UINT32": """
        runtime_state robot_status_bits safety_status_bits analog_io_types tool_mode
        tool_analog_input_types euromap67_input_bits euromap67_output_bits script_control_line
        output_bit_registers0_to_31 output_bit_registers32_to_63
        input_bit_registers0_to_31 input_bit_registers32_to_63""",
    "UINT64": """
        actual_digital_input_bits actual_digital_output_bits actual_configurable_digital_input_bits
        actual_configurable_digital_output_bits control_step""",
}


def _registers(direction: str) -> dict[str, str]:
    """Return those registers of the RTDE protocol that have individual names, as a mapping from name to type.

    Boolean registers 0 to 63 have no individual names: two 32-bit words transmit them.
    """
    return {
        **{f"{direction}_bit_register_{i}": "BOOL" for i in range(64, 128)},
        **{f"{direction}_int_register_{i}": "INT32" for i in range(REGISTERS)},
        **{f"{direction}_double_register_{i}": "DOUBLE" for i in range(REGISTERS)},
    }


OUTPUTS: dict[str, str] = {
    **{name: kind for kind, names in _OUTPUT_NAMES.items() for name in names.split()},
    **_registers("output"),
    **_registers("input"),
}
"""Variables that a controller sends, in any published software version: name -> type."""

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
    **_registers("input"),
}
"""Variables that a client can set: name -> type."""


class RtdeError(ArmcellError):
    """Error for received data that violates the RTDE wire protocol, or for an RTDE request that the other
    side refused.
    """


def frame(kind: int, payload: bytes = b"") -> bytes:
    return HEADER.pack(HEADER.size + len(payload), kind) + payload


def frames(buffer: bytearray) -> Iterator[tuple[int, bytes]]:
    """Remove the complete RTDE frames at the start of a buffer with received data, and yield (type, payload).

    Raises:
        RtdeError: a frame has an invalid size.
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
    """Recipe of the RTDE protocol: the names of variables, and the binary layout of their values."""

    def __init__(self, names: Sequence[str], types: Sequence[str]):
        self.names, self.types = tuple(names), tuple(types)
        self._struct = struct.Struct(">" + "".join(_CODES[t] for t in types))
        self._widths = [int(_CODES[t][:-1] or 1) for t in types]

    @property
    def size(self) -> int:
        """Return the size in bytes of the packed values of an RTDE recipe."""
        return self._struct.size

    def pack(self, values: Iterable[Any]) -> bytes:
        """Pack the values of an RTDE recipe into bytes, in the order of the recipe.
        Vectors are given as sequences.
        """
        flat: list[Any] = []
        for value, width in zip(values, self._widths, strict=True):
            if width == 1:
                flat.append(value)
            else:
                flat.extend(value)
        return self._struct.pack(*flat)

    def unpack(self, payload: bytes) -> dict[str, Any]:
        """Unpack the values of an RTDE recipe from received bytes into a dict by name. Vectors become tuples.

        Raises:
            RtdeError: the payload has the wrong length.
        """
        if len(payload) != self._struct.size:
            raise RtdeError(f"{len(payload)} bytes of data, the recipe has {self._struct.size}")
        flat, values, at = self._struct.unpack(payload), {}, 0
        for name, width in zip(self.names, self._widths, strict=True):
            values[name] = flat[at] if width == 1 else flat[at : at + width]
            at += width
        return values


def split_names(text: bytes) -> list[str]:
    """Split the comma-separated list of variable names in a message of the RTDE wire protocol.

    A trailing comma, as ur_rtde sends it, is ignored.
    """
    return [name for name in text.decode("ascii", "replace").split(",") if name]


def message_text(payload: bytes) -> str:
    """Decode the text in a text message of the RTDE wire protocol, prefixed with its source.

    Layout: uint8 length, text, uint8 length, source, uint8 level.

    Raises:
        RtdeError: a length exceeds the payload.
    """
    parts, at = [], 0
    for _ in range(2):
        if at >= len(payload) or at + 1 + payload[at] > len(payload):
            raise RtdeError("a text message with a wrong length")
        parts.append(payload[at + 1 : at + 1 + payload[at]].decode("utf-8", "replace"))
        at += 1 + payload[at]
    text, source = parts
    return f"{source}: {text}" if source else text
