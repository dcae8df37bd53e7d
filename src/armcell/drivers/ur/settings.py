"""Settings of Universal Robots arms in the block `real` of a cell file."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from armcell.drivers.real import ArmSettings
from armcell.drivers.real.settings import StrictSettings

FIRST_PORT = 50001


class GripperSettings(StrictSettings):
    """Settings of the gripper on a UR arm.
    The gripper uses either the socket of a URCap or digital output 0 of the tool.
    """

    kind: Literal["socket", "tool_io"] = "socket"  # socket: Robotiq's protocol
    port: int = Field(63352, ge=1, le=65535)  # of the socket


class UrArmSettings(ArmSettings):
    """Settings of one UR arm."""

    model: str = "UR10"
    port: int = Field(0, ge=0, le=65535)  # port of this computer; 0: 50001, 50011, ...
    own_host: str | None = None  # this computer's address as seen from the robot; None: detected
    payload: float | None = Field(None, ge=0, le=20)  # [kg]
    tcp: tuple[float, float, float, float, float, float] | None = None  # [m, rotation vector]
    gripper: GripperSettings | None = None
