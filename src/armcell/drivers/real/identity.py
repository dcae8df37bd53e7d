"""Identity of real robots (serial number, calibration) and quality of their network."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from armcell.core import InputError
from armcell.drivers.real.settings import ArmSettings


class RobotIdentity(Protocol):
    """Identity of a real robot as reported by its controller. `str()` describes it for the operator."""

    @property
    def serial(self) -> str: ...

    @property
    def calibration(self) -> str: ...  # checksum; equal only for the same robot and calibration


@dataclass(frozen=True)
class NetworkReport:
    """Network quality of the connection to a real robot, measured once when the robot's identity is checked.
    Times are in [s].
    """

    round_trip: float  # median
    worst_round_trip: float
    period: float  # median interval between states
    worst_gap: float  # longest interval between two states
    frequency: float  # requested [Hz]

    def __str__(self) -> str:
        return (
            f"round trip {self.round_trip * 1000:.1f} ms (worst {self.worst_round_trip * 1000:.1f}), "
            f"state every {self.period * 1000:.1f} ms (worst gap {self.worst_gap * 1000:.1f})"
        )


def check_serial_and_calibration(name: str, arm: ArmSettings, found: RobotIdentity) -> None:
    """Check the identity of a real robot: its serial number and
    calibration must match those in the cell file, if given.

    Raises:
        InputError: the robot is not the one in the cell file.
    """
    for what, want, have in (
        ("serial number", arm.serial, found.serial),
        ("calibration", arm.calibration, found.calibration),
    ):
        if want is not None and want != have:
            raise InputError(
                f"arm {name!r}: the robot at {arm.host} has {what} {have}, the cell file says {want}",
                hint="the address leads to another robot: check cables and addresses (are the arms swapped?)",
            )


def check_not_swapped(wanted: Mapping[str, ArmSettings], found: Mapping[str, RobotIdentity]) -> None:
    """Check the identities of real arms: no arm may answer with the serial number or calibration of another.

    Raises:
        InputError: the arms' addresses are swapped.
    """
    for arm, identity in found.items():
        for other, settings in wanted.items():
            if other != arm and (
                (settings.serial is not None and settings.serial == identity.serial)
                or (settings.calibration is not None and settings.calibration == identity.calibration)
            ):
                raise InputError(
                    f"the arms are swapped: {wanted[arm].host}, the address of {arm!r}, is answered by "
                    f"{other!r} (serial {identity.serial})",
                    hint=f"exchange the addresses of {arm!r} and {other!r} in the cell file, or the cables",
                )
