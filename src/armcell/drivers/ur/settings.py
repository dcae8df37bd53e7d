"""Settings of the real arms of a cell: the block `real` of a cell file."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from armcell.core import InputError, UnknownNameError
from armcell.drivers.ur.wire.models import ur_model
from armcell.model import RobotModel

FIRST_PORT = 50001


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, coerce_numbers_to_str=True)


class GripperSettings(_Strict):
    """Connection of a gripper: a URCap's socket, or open/close by the tool's digital output 0."""

    kind: Literal["socket", "tool_io"] = "socket"  # socket: Robotiq's protocol
    port: int = Field(63352, ge=1, le=65535)  # of the socket


class ArmSettings(_Strict):
    """Settings of one real arm."""

    host: str = Field(min_length=1)
    model: str = "UR10"
    port: int = Field(0, ge=0, le=65535)  # port of this computer; 0: 50001, 50011, ...
    own_host: str | None = None  # this computer's address as seen from the robot; None: detected
    serial: str | None = None  # connecting to another robot fails
    calibration: str | None = None  # checksum of the factory calibration, as bringup prints it
    payload: float | None = Field(None, ge=0, le=20)  # [kg]
    payload_cog: tuple[float, float, float] = (0.0, 0.0, 0.0)  # [m]
    tcp: tuple[float, float, float, float, float, float] | None = None  # [m, rotation vector]
    gripper: GripperSettings | None = None


class RealSettings(_Strict):
    """Settings of all real arms of a cell, by planning group, with their supervision limits."""

    arms: dict[str, ArmSettings] = Field(min_length=1)
    backend: Literal["own", "ur_rtde"] = "own"  # motion by armcell's robot program, or by ur_rtde
    calibration: Literal["compare", "apply"] = (
        "compare"  # use of the robots' own geometry: compared only, or applied to the model
    )
    max_state_age: float = Field(0.05, gt=0)  # [s] while an arm moves
    max_silence: float = Field(1.0, gt=0)  # [s] while it rests
    max_tracking_error: float = Field(0.1, gt=0)  # [rad] between target and actual position
    watchdog: float = Field(0.1, ge=0.02, le=1.0)  # [s] without a command before an arm stops itself
    twin: bool = True  # dry-run every motion and compare the arms with the simulation
    stream_lead: float = Field(0.04, ge=0.01, le=0.2)  # [s] from sending a setpoint until its due time
    stop_deceleration: float = Field(15.0, gt=0, le=40)  # [rad/s^2] of the supervisor's stops


def real_settings(values: dict[str, Any], model: RobotModel) -> RealSettings:
    """Validate the block `real` of a cell file.

    Raises:
        InputError: the block is invalid; the message states the cause and the remedy.
    """
    groups = [g.name for g in model.groups.values() if g.tip_link and len(g.joint_names) == 6]
    if not values:
        raise InputError(
            "the cell has no real arms",
            cure="add to the cell file 'real: {arms: {GROUP: {host: ADDRESS, model: UR10}}}'; "
            f"groups with six joints: {', '.join(groups) or 'none'}",
        )
    try:
        settings = RealSettings.model_validate(values)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = "/".join(["real", *(str(p) for p in first["loc"])])
        raise InputError(first["msg"].removeprefix("Value error, "), element=place) from None
    for name, arm in settings.arms.items():
        if name not in groups:
            raise UnknownNameError(
                "arm (a planning group with six joints)", name, groups, element="real/arms"
            )
        ur_model(arm.model)
    arms = {
        name: arm.model_copy(update={"port": arm.port or FIRST_PORT + 10 * i})
        for i, (name, arm) in enumerate(settings.arms.items())
    }
    for what, key in (("address", "host"), ("port", "port")):
        owners: dict[Any, str] = {}
        for name, arm in arms.items():
            other = owners.setdefault(getattr(arm, key), name)
            if other != name:
                raise InputError(
                    f"arms {other!r} and {name!r} have the same {what} {getattr(arm, key)}",
                    element="real/arms", cure=f"every arm needs its own {what}",
                )  # fmt: skip
    return settings.model_copy(update={"arms": arms})
