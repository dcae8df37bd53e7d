"""Settings models of real arms for the block `real` of a cell file.

`block.real_settings` validates the block.
"""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

DEFAULT_KIND = "ur"
OWN = "own"  # backend: armcell itself moves the arm


class StrictSettings(BaseModel):
    """Strict base class for the settings of real arms: unknown keys are errors,
    values cannot change and must be finite.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, coerce_numbers_to_str=True)


class ArmSettings(StrictSettings):
    """Settings of one real arm that are common to all robot kinds. Each robot kind adds its own settings."""

    kind: str = DEFAULT_KIND  # robot kind; default: the kind of the block `real`
    backend: str = OWN  # what moves the arm: armcell or a vendor's library; default: that of the block `real`
    host: str = Field(min_length=1)
    serial: str | None = None  # connecting to another robot fails
    calibration: str | None = None  # checksum of the factory calibration, as bringup prints it
    payload: float | None = Field(None, ge=0)  # [kg]
    payload_cog: tuple[float, float, float] = (0.0, 0.0, 0.0)  # [m]


class RealSettings(StrictSettings):
    """Settings of a cell's real arms, by planning group,
    and the limits that the safety supervisor enforces.
    """

    kind: str = DEFAULT_KIND  # robot kind of the arms that do not name their own
    arms: dict[str, ArmSettings] = Field(min_length=1)
    backend: str = OWN  # backend of the arms that do not name their own
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
