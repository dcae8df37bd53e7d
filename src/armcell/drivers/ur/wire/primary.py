"""Messages of UR's primary interface (ports 30001, 30002): frames and robot state packages.

Source: Universal Robots, "Client Interface" documents: int32 size, uint8 type, then for type 20 (robot
message) uint64 timestamp, uint8 source, uint8 sub-type; for type 16 (robot state) packages of int32
size, uint8 type.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

ROBOT_STATE, ROBOT_MESSAGE = 16, 20
MODE_DATA, JOINT_DATA, TOOL_DATA, MASTERBOARD, CARTESIAN, KINEMATICS, CONFIGURATION = range(7)
FORCE_MODE, ADDITIONAL, CALIBRATION, SAFETY, TOOL_COMMUNICATION, TOOL_MODE = range(7, 13)
MAX_SIZE = 65536


@dataclass(frozen=True)
class Kinematics:
    """Kinematics of one UR robot in primary messages: the calibrated Denavit-Hartenberg parameters."""

    theta: tuple[float, ...]  # (6,) [rad]
    a: tuple[float, ...]  # (6,) [m]
    d: tuple[float, ...]  # (6,) [m]
    alpha: tuple[float, ...]  # (6,) [rad]
    checksums: tuple[int, ...] = (0, 0, 0, 0, 0, 0)
    calibrated: bool = True

    def pack(self) -> bytes:
        body = struct.pack(">6I", *self.checksums)
        body += struct.pack(">24d", *self.theta, *self.a, *self.d, *self.alpha)
        return package(KINEMATICS, body + struct.pack(">I", 0 if self.calibrated else 1))

    @staticmethod
    def unpack(body: bytes) -> Kinematics:
        values = struct.unpack_from(">24d", body, 24)
        return Kinematics(
            values[0:6], values[6:12], values[12:18], values[18:24],
            struct.unpack_from(">6I", body), struct.unpack_from(">I", body, 216)[0] == 0,
        )  # fmt: skip

    def difference(self, other: Kinematics) -> tuple[float, float]:
        """Return the largest differences between two UR robots' Denavit-Hartenberg parameters, as reported on
        the primary interface: in length [m] and in angle [rad].
        """
        lengths = np.abs(np.subtract((self.a, self.d), (other.a, other.d)))
        angles = np.abs(np.subtract((self.theta, self.alpha), (other.theta, other.alpha)))
        return float(lengths.max()), float(angles.max())


def package(kind: int, body: bytes) -> bytes:
    """Encode a message of UR's primary interface, or a package inside such a message.

    Layout: int32 size, uint8 type, body.
    """
    return struct.pack(">iB", 5 + len(body), kind) + body


def robot_state(packages: list[bytes]) -> bytes:
    """Encode a robot state message of UR's primary interface from complete packages."""
    return package(ROBOT_STATE, b"".join(packages))


def mode_package(
    timestamp_us: int, powered: bool, emergency: bool, protective: bool, running: bool, paused: bool,
    robot_mode: int, speed_fraction: float, speed_scaling: float, cb3_version: tuple[int, int] = (3, 15),
) -> bytes:  # fmt: skip
    """Encode the package with robot modes and speeds for the robot state message of UR's primary interface.

    Software before 3.5 sends no reserved byte at the end.
    """
    flags = (True, True, powered, emergency, protective, running, paused)
    body = struct.pack(">Q7?BB", timestamp_us, *flags, robot_mode, 1)
    body += struct.pack(">ddd", speed_fraction, speed_scaling, 1.0)
    return package(MODE_DATA, body + (b"\0" if cb3_version >= (3, 5) else b""))


ROBOT_TYPES = {"UR5": 1, "UR10": 2, "UR3": 3, "UR16": 4, "UR20": 7, "UR30": 8}


def configuration_package(q_limits, v_max, a_max, kinematics: Kinematics, robot_type: int) -> bytes:
    """Encode the configuration package of UR's primary interface,
    which contains joint limits, geometry and robot type.
    """
    body = b"".join(struct.pack(">dd", low, high) for low, high in q_limits)
    body += b"".join(struct.pack(">dd", v, a) for v, a in zip(v_max, a_max, strict=True))
    body += struct.pack(">5d", 1.05, 1.4, 0.25, 1.2, 0.1)
    body += struct.pack(">24d", *kinematics.a, *kinematics.d, *kinematics.alpha, *kinematics.theta)
    return package(CONFIGURATION, body + struct.pack(">4i", 0, 0, robot_type, 0))


def joint_package(rows: Iterable[tuple[float, float, float, float, float, float, int]]) -> bytes:
    """Encode the package with joint data for the robot state message of UR's primary interface.

    Args:
        rows: per joint the actual and target position [rad], speed [rad/s], current [A], voltage [V],
            temperature [deg C], and mode.
    """
    body = b"".join(
        struct.pack(">dddffffB", q, target, v, current, voltage, heat, 0.0, mode)
        for q, target, v, current, voltage, heat, mode in rows
    )
    return package(JOINT_DATA, body)


def tool_package(inputs: tuple[float, float], output_voltage: int, temperature: float, mode: int) -> bytes:
    """Encode the package with tool data for the robot state message of UR's primary interface.

    Args:
        inputs: analog inputs [V].
        output_voltage: [V]
        temperature: [deg C]
        mode: tool mode.
    """
    body = struct.pack(">bbddfBffB", 1, 1, *inputs, 48.0, output_voltage, 0.0, temperature, mode)
    return package(TOOL_DATA, body)


def masterboard_package(
    inputs: int, outputs: int, output_domains: tuple[int, int], analog_outputs: tuple[float, float],
    safety_mode: int, reduced: bool,
) -> bytes:  # fmt: skip
    """Encode the package with masterboard data, but without Euromap 67,
    for the robot state message of UR's primary interface.

    Args:
        inputs, outputs: digital pins as bits.
        output_domains: 0 for current, 1 for voltage, per analog output.
        analog_outputs: [V or mA]
    """
    body = struct.pack(">iibbdd", inputs, outputs, 1, 1, 0.0, 0.0)
    body += struct.pack(">bbdd", *output_domains, *analog_outputs)
    body += struct.pack(">ffffBBB", 25.0, 48.0, 0.0, 0.0, safety_mode, reduced, 0)
    return package(MASTERBOARD, body + struct.pack(">IBBB", 0, 0, 0, 0))


def cartesian_package(tcp_pose: Sequence[float], tcp_offset: Sequence[float]) -> bytes:
    """Encode the package with Cartesian data (TCP pose and offset) for
    the robot state message of UR's primary interface.

    The pose is in the base frame, the offset in the flange frame. Both are UR poses: x, y, z [m] and rotation
    vector [rad].
    """
    return package(CARTESIAN, struct.pack(">12d", *tcp_pose, *tcp_offset))


def force_mode_package(wrench: Sequence[float], dexterity: float) -> bytes:
    return package(FORCE_MODE, struct.pack(">7d", *wrench, dexterity))


def additional_package(teaching: bool) -> bytes:
    """Encode the package with additional data (teach button and
    freedrive) for UR's primary robot state message.
    """
    return package(ADDITIONAL, struct.pack(">B??B", teaching, True, False, 0))


def internal_packages() -> list[bytes]:
    """Return the packages of UR's primary interface that are for UR's internal use.
    Clients skip these packages.
    """
    return [package(CALIBRATION, bytes(48)), package(SAFETY, bytes(38))]


def tool_extras(output_mode: int) -> list[bytes]:
    """Encode the packages with the tool data of an e-Series arm (serial communication and output modes) for
    the robot state message of UR's primary interface.
    """
    communication = struct.pack(">?iiiff", False, 115200, 0, 1, 1.5, 3.5)
    return [
        package(TOOL_COMMUNICATION, communication),
        package(TOOL_MODE, struct.pack(">BBB", output_mode, 0, 0)),
    ]


def messages(buffer: bytearray) -> list[tuple[int, bytes]]:
    """Remove the complete messages at the start of a buffer with data
    of UR's primary interface, and return them.

    Returns:
        The messages as (type, body).
    Raises:
        ValueError: the data is not from UR's primary interface.
    """
    found = []
    while len(buffer) >= 5:
        size, kind = struct.unpack_from(">iB", buffer)
        if not 5 <= size <= MAX_SIZE:
            raise ValueError(f"a message of {size} bytes is not UR's primary interface")
        if len(buffer) < size:
            break
        found.append((kind, bytes(buffer[5:size])))
        del buffer[:size]
    return found


def packages(body: bytes) -> dict[int, bytes]:
    """Split the body of a robot state message of UR's primary
    interface into its packages, by package type.
    """
    found: dict[int, Any] = {}
    at = 0
    while at + 5 <= len(body):
        size, kind = struct.unpack_from(">iB", body, at)
        if size < 5:
            break
        found[kind] = body[at + 5 : at + size]
        at += size
    return found
