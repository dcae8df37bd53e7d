"""Settings of Franka arms in the block `real` of a cell file."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from armcell.drivers.franka.motion_limits import MAX_LOAD
from armcell.drivers.real import ArmSettings
from armcell.drivers.real.settings import StrictSettings


class HandSettings(StrictSettings):
    """Settings of the Franka Hand."""

    kind: Literal["hand"] = "hand"
    homing: bool = False  # home the hand when connecting: the fingers open and close
    speed: float = Field(0.1, gt=0, le=0.2)  # [m/s] of the width


class FrankaArmSettings(ArmSettings):
    """Settings of one Franka arm."""

    model: Literal["fr3", "panda"] = "fr3"
    payload: float | None = Field(None, ge=0, le=MAX_LOAD)  # [kg] beyond the hand
    payload_radius: float = Field(0.05, gt=0, le=0.5)  # [m] of the sphere with the payload's inertia
    joint_stiffness: tuple[float, float, float, float, float, float, float] | None = None  # [Nm/rad]
    collision_torque: float = Field(40.0, gt=0, le=100)  # [Nm] external torque of a joint that stops the arm
    collision_force: float = Field(60.0, gt=0, le=200)  # [N, Nm] external wrench that stops the arm
    gripper: HandSettings | None = None
