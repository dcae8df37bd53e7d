"""Messages of the primary interface (ports 30001 and 30002) that tell who answers.

Source: Universal Robots, "Client Interface" documents: int32 size, uint8 type, then for type 20 (robot
message) uint64 timestamp, uint8 source, uint8 sub-type; for type 16 (robot state) packages of int32
size, uint8 type.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any

import numpy as np

ROBOT_STATE, ROBOT_MESSAGE = 16, 20
VERSION_MESSAGE = 3
MODE_DATA, KINEMATICS, CONFIGURATION = 0, 5, 6
MAX_SIZE = 65536


@dataclass(frozen=True)
class Kinematics:
    """A robot's own geometry: Denavit-Hartenberg parameters after factory calibration."""

    theta: tuple[float, ...]  # (6,) [rad]
    a: tuple[float, ...]  # (6,) [m]
    d: tuple[float, ...]  # (6,) [m]
    alpha: tuple[float, ...]  # (6,) [rad]
    checksums: tuple[int, ...] = (0, 0, 0, 0, 0, 0)
    calibrated: bool = True

    def pack(self) -> bytes:
        body = struct.pack(">6I", *self.checksums)
        body += struct.pack(">24d", *self.theta, *self.a, *self.d, *self.alpha)
        return _package(KINEMATICS, body + struct.pack(">I", 0 if self.calibrated else 1))

    @staticmethod
    def unpack(body: bytes) -> Kinematics:
        values = struct.unpack_from(">24d", body, 24)
        return Kinematics(
            values[0:6], values[6:12], values[12:18], values[18:24],
            struct.unpack_from(">6I", body), struct.unpack_from(">I", body, 216)[0] == 0,
        )  # fmt: skip

    def difference(self, other: Kinematics) -> tuple[float, float]:
        """The largest difference of a length [m] and of an angle [rad]."""
        lengths = np.abs(np.subtract((self.a, self.d), (other.a, other.d)))
        angles = np.abs(np.subtract((self.theta, self.alpha), (other.theta, other.alpha)))
        return float(lengths.max()), float(angles.max())


def _package(kind: int, body: bytes) -> bytes:
    return struct.pack(">iB", 5 + len(body), kind) + body


def robot_state(packages: list[bytes]) -> bytes:
    """A robot state message of whole packages."""
    return _package(ROBOT_STATE, b"".join(packages))


def version_message(timestamp_us: int, name: str, version: tuple[int, int, int], build: int) -> bytes:
    body = struct.pack(">QbB", timestamp_us, -1, VERSION_MESSAGE)
    body += struct.pack(">B", len(name)) + name.encode()
    body += struct.pack(">BBii", version[0], version[1], version[2], build) + b"22-11-2026, 00:00:00"
    return _package(ROBOT_MESSAGE, body)


def mode_package(
    timestamp_us: int, powered: bool, emergency: bool, protective: bool, running: bool, paused: bool,
    robot_mode: int, speed_fraction: float, speed_scaling: float,
) -> bytes:  # fmt: skip
    flags = (True, True, powered, emergency, protective, running, paused)
    body = struct.pack(">Q7?BB", timestamp_us, *flags, robot_mode, 1)
    return _package(MODE_DATA, body + struct.pack(">dddB", speed_fraction, speed_scaling, 1.0, 0))


ROBOT_TYPES = {"UR5": 1, "UR10": 2, "UR3": 3, "UR16": 4}


def configuration_package(q_limits, v_max, a_max, kinematics: Kinematics, robot_type: int) -> bytes:
    """Limits, defaults, geometry and type of the robot (configuration data)."""
    body = b"".join(struct.pack(">dd", low, high) for low, high in q_limits)
    body += b"".join(struct.pack(">dd", v, a) for v, a in zip(v_max, a_max, strict=True))
    body += struct.pack(">5d", 1.05, 1.4, 0.25, 1.2, 0.1)
    body += struct.pack(">24d", *kinematics.a, *kinematics.d, *kinematics.alpha, *kinematics.theta)
    return _package(CONFIGURATION, body + struct.pack(">4i", 0, 0, robot_type, 0))


def messages(buffer: bytearray) -> list[tuple[int, bytes]]:
    """Complete messages (type, body) at the buffer's beginning, taken off it.

    Raises:
        ValueError: not the primary interface.
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
    """Packages of a robot state by type."""
    found: dict[int, Any] = {}
    at = 0
    while at + 5 <= len(body):
        size, kind = struct.unpack_from(">iB", body, at)
        if size < 5:
            break
        found[kind] = body[at + 5 : at + size]
        at += size
    return found
