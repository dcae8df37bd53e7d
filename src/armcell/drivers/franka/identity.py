"""Checks of a Franka robot's identity and readiness; the robot does not move."""

from __future__ import annotations

import re
import socket
from dataclasses import dataclass
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from armcell.core import InputError
from armcell.drivers.franka.client import FciClient, FciError
from armcell.drivers.franka.settings import HAND_MASS, MAX_LOAD, FrankaArmSettings, limits_of
from armcell.drivers.franka.wire.commands import Command, WireError
from armcell.drivers.franka.wire.state import RobotMode, RobotState, read_state
from armcell.drivers.real import check_serial_and_calibration

Array = NDArray[np.float64]

UR_PORTS = (29999, 30002)
ACTIVATE = "activate FCI in Desk (Franka's web page at this address), and check the address"
HINTS = {
    RobotMode.OTHER: ("its brakes are locked", "unlock the brakes in Desk"),
    RobotMode.USER_STOPPED: ("the user stop is pressed", "release the user stop"),
    RobotMode.GUIDING: ("it is guided by hand", "release the enabling button"),
    RobotMode.REFLEX: ("a reflex or error stopped it", "see why, free the arm, and clear the error in Desk"),
    RobotMode.AUTOMATIC_ERROR_RECOVERY: ("it recovers from an error", "wait a second"),
    RobotMode.MOVE: ("another program moves it", "end the other program"),
}
"""Cause and remedy by robot mode in which the arm cannot be driven."""


@dataclass(frozen=True, eq=False)
class FrankaIdentity:
    """Identity and state of a Franka robot. The robot's interface reports no serial number.

    Attributes:
        model: name of the robot in its own description: fr3, panda. Protocol 5 has no description; its robots
            are Pandas.
        description: URDF text that the robot sends, or empty.
        version: version of the protocol.
    """

    host: str
    model: str
    description: str
    version: int
    state: RobotState

    @property
    def serial(self) -> str:
        return ""

    @property
    def calibration(self) -> str:
        """Return the checksum of the description that a Franka robot sends to identify itself. The text is
        empty if there is no description.
        """
        if not self.description:
            return ""
        return f"{crc32(self.description.encode()):08x}"

    def __str__(self) -> str:
        return (
            f"{self.model} at {self.host}, protocol {self.version}, {RobotMode(self.state.mode).name.lower()}"
        )


def identify(host: str) -> FrankaIdentity:
    """Identify a Franka robot by reading its description and state over a temporary connection.

    Raises:
        InputError: no Franka robot answers, or it rejects the connection; the message states the remedy.
    """
    try:
        client = FciClient(host)
    except FciError as error:
        raise InputError(str(error), hint=_hint(host, error.kind)) from None
    try:
        state = read_state(client.first_state())
        description = ""
        if Command.GET_ROBOT_MODEL in client.protocol.commands:
            description = client.ask(Command.GET_ROBOT_MODEL)[1:].decode("utf-8", "replace")
    except (FciError, WireError, ValueError) as error:
        raise InputError(f"{host}: {error}", hint=_hint(host, "protocol")) from None
    finally:
        client.close()
    named = re.search(r'<robot[^>]*\sname="([^"]*)"', description)
    model = named[1] if named else "unknown" if description else "panda"
    return FrankaIdentity(host, model, description, client.protocol.version, state)


def _hint(host: str, kind: str) -> str:
    if kind in ("refused", "unreachable", "closed") and _is_ur(host):
        return "a Universal Robots controller answers at this address: use 'kind: ur', or another address"
    return {
        "refused": ACTIVATE,
        "unreachable": "check the cable, the address, and that no firewall blocks UDP",
        "closed": "FCI is not active in Desk, or another client is connected: end it",
        "version": "use system 5.9 or later on an FR3, system 4.2 on a Panda",
    }.get(kind, "check that a Franka robot has this address")


def _is_ur(host: str) -> bool:
    for port in UR_PORTS:
        try:
            socket.create_connection((host, port), 0.3).close()
        except OSError:
            return False
    return True


def check_identity(name: str, arm: FrankaArmSettings, found: FrankaIdentity) -> None:
    """Check the identity of a Franka robot: it must be the robot that the cell file names.

    Raises:
        InputError: it is another model or has another description.
    """
    if arm.serial is not None:
        raise InputError(
            f"arm {name!r}: a Franka robot reports no serial number", element=f"real/arms/{name}/serial",
            hint="identify it by 'calibration', the checksum of its description",
        )  # fmt: skip
    if found.model != arm.model:
        raise InputError(
            f"arm {name!r}: the robot at {arm.host} is a {found.model}, the cell file says {arm.model}",
            hint=f"set 'model: {found.model}', or correct the address",
        )
    check_serial_and_calibration(name, arm, found)


def check_load(name: str, arm: FrankaArmSettings) -> None:
    """Check, when a Franka robot is identified, that it can carry its payload in addition to its hand.

    Raises:
        InputError: the arm cannot carry it.
    """
    carried = (arm.payload or 0.0) + (HAND_MASS if arm.gripper is not None else 0.0)
    if carried > MAX_LOAD:
        raise InputError(
            f"payload and hand weigh {carried:.2f} kg, the arm carries {MAX_LOAD:g} kg",
            element=f"real/arms/{name}/payload", hint="choose a lighter object or tool",
        )  # fmt: skip


def check_ready(name: str, found: FrankaIdentity) -> None:
    """Check that an identified Franka robot is ready for motion commands.

    Raises:
        InputError: it cannot; the message states the remedy.
    """
    mode = RobotMode(found.state.mode)
    if mode is not RobotMode.IDLE:
        cause, hint = HINTS[mode]
        errors = ", ".join(found.state.errors)
        raise InputError(
            f"arm {name!r} at {found.host}: {cause}{f' ({errors})' if errors else ''}", hint=hint
        )
    if found.model in ("fr3", "panda"):
        check_position(name, found.model, found.state["q"])


def check_position(name: str, model: str, q: Array) -> None:
    """Check that the joint positions (7,) [rad] of an identified Franka arm are within the joint limits.

    Raises:
        InputError: a joint is outside its limits.
    """
    limits = limits_of(model)
    outside = np.flatnonzero((q < limits.lower) | (q > limits.upper))
    if len(outside):
        i = int(outside[0])
        raise InputError(
            f"arm {name!r}: joint {i + 1} is at {q[i]:.4f} rad, outside its limits "
            f"{limits.lower[i]:.4f} to {limits.upper[i]:.4f}",
            hint="guide the arm back by hand (enabling button), or move the joint in Desk",
        )
