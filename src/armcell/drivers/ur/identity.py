"""Identity checks of a UR robot: model, serial number, calibration and readiness.

The checks do not move the robot.
"""

from __future__ import annotations

import hashlib
import socket
import struct
import time
from dataclasses import dataclass

from armcell.core import InputError
from armcell.drivers.real import check_serial_and_calibration
from armcell.drivers.ur.dashboard import DashboardClient
from armcell.drivers.ur.settings import UrArmSettings
from armcell.drivers.ur.wire import primary
from armcell.drivers.ur.wire.models import MODELS, UrModel, ur_model

PRIMARY_PORT = 30001
NEAR = 0.02  # [m] largest difference of a calibrated geometry from its model; models differ by more


@dataclass(frozen=True)
class UrIdentity:
    """Identity and state of a UR robot, as its controllers report them."""

    host: str
    model: UrModel
    version: tuple[int, ...]
    serial: str
    geometry: primary.Kinematics
    remote: bool | None  # None: CB3 controllers have no remote control mode
    robot_mode: str
    safety: str

    def __str__(self) -> str:
        version = ".".join(map(str, self.version))
        return f"{self.model.name}, serial {self.serial}, calibration {self.calibration}, software {version}"

    @property
    def calibration(self) -> str:
        """Return a checksum of a UR robot's geometry, which identifies the robot and its calibration."""
        g = self.geometry
        data = struct.pack("<24d", *g.theta, *g.a, *g.d, *g.alpha)
        return hashlib.sha256(data).hexdigest()[:12]


def identify(host: str) -> UrIdentity:
    """Query the identity and state of a UR robot over its dashboard and primary interface.

    Raises:
        InputError: no robot answers, or its model is not supported.
    """
    with DashboardClient(host) as dashboard:
        version = dashboard.version()
        serial = dashboard.ask("get serial number")
        remote = dashboard.in_remote_control()
        mode, safety = dashboard.word("robotmode"), dashboard.word("safetymode")
    geometry = read_geometry(host)
    model, distance = min(
        ((m, geometry.difference(m.dh)[0]) for m in MODELS.values()), key=lambda pair: pair[1]
    )
    if distance > NEAR:
        raise InputError(
            f"the robot at {host} has the geometry of none of {', '.join(MODELS)} "
            f"(the nearest, {model.name}, is {distance * 1000:.0f} mm off)",
            hint="armcell drives these models only",
        )
    return UrIdentity(host, model, version, serial, geometry, remote, mode, safety)


def read_geometry(host: str, timeout: float = 3.0) -> primary.Kinematics:
    """Read a UR robot's Denavit-Hartenberg parameters from its primary interface. They identify the robot.

    Raises:
        InputError: the robot does not send its geometry.
    """
    buffer, end = bytearray(), time.monotonic() + timeout
    try:
        with socket.create_connection((host, PRIMARY_PORT), timeout) as link:
            while time.monotonic() < end:
                data = link.recv(65536)
                if not data:
                    break
                buffer += data
                for kind, body in primary.messages(buffer):
                    if kind == primary.ROBOT_STATE:
                        found = primary.packages(body).get(primary.KINEMATICS)
                        if found is not None:
                            return primary.Kinematics.unpack(found)
    except (OSError, ValueError, struct.error) as error:
        raise InputError(
            f"{host}:{PRIMARY_PORT} does not tell its geometry: {error}",
            hint="enable the primary client interface on the pendant (Settings, Security, Services)",
        ) from None
    raise InputError(f"{host}:{PRIMARY_PORT} did not tell its geometry within {timeout:g} s")


def check_identity(arm: str, wanted: UrArmSettings, found: UrIdentity) -> None:
    """Check the identity of a UR robot: its model,
    serial number and calibration must be those in the cell file.

    Raises:
        InputError: the robot is not the one in the cell file.
    """
    if found.model.name != ur_model(wanted.model).name:
        raise InputError(
            f"arm {arm!r}: the robot at {wanted.host} is a {found.model.name}, "
            f"the cell file says {wanted.model}",
            hint="correct 'model' (and the robot model of the cell), or the address",
        )
    check_serial_and_calibration(arm, wanted, found)


def check_ready(arm: str, found: UrIdentity) -> None:
    """Check, after a UR robot was identified, that it is in remote control, running and not stopped.

    Raises:
        InputError: the robot cannot be driven now; the message states the remedy.
    """
    if found.safety not in ("NORMAL", "REDUCED"):
        hint = {
            "PROTECTIVE_STOP": "look why, free the arm, then unlock it on the pendant or with "
            f"'armcell ur-dashboard {found.host} \"unlock protective stop\"'",
            "SAFEGUARD_STOP": "close the fence, reset the safeguard",
            "ROBOT_EMERGENCY_STOP": "release the emergency stop button, then power on",
            "SYSTEM_EMERGENCY_STOP": "release the emergency stop button, then power on",
        }.get(found.safety, "see the pendant")
        text = found.safety.lower().replace("_", " ")
        raise InputError(f"arm {arm!r}: the robot at {found.host} stands in {text}", hint=hint)
    if found.remote is False:
        raise InputError(
            f"arm {arm!r}: the robot at {found.host} is in local control",
            hint="on the pendant, top right: choose Remote Control (enable it first: Settings, System)",
        )
    if found.robot_mode != "RUNNING":
        raise InputError(
            f"arm {arm!r}: the robot at {found.host} is not running (mode {found.robot_mode})",
            hint="switch it on and release the brakes: on the pendant, or by 'armcell bringup'",
        )
