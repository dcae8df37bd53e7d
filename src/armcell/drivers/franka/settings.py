"""Settings of Franka arms in the block `real`, and limits of their joint, Cartesian and elbow motions.

Source: Franka Robotics, "Robot and interface specifications" (FCI documentation), and the constants of the
public headers of libfranka 0.21 (FR3) and 0.9 (Panda).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from armcell.core import UnknownNameError
from armcell.drivers.real import ArmSettings
from armcell.drivers.real.settings import StrictSettings

Array = NDArray[np.float64]

ELBOW_FLIP = -0.467002423653011  # [rad] position of joint 4 at which the elbow flips

MAX_LOAD = 3.0  # [kg] payload of FR3 and Panda, including a hand

HAND_MASS = 0.73  # [kg] Franka Hand

HAND_CENTER = (-0.01, 0.0, 0.03)  # [m] center of mass of the hand in the flange frame

HAND_INERTIA = (0.001, 0.0025, 0.0017)  # [kg m^2] diagonal

HAND_WIDTH = 0.08  # [m]


def _rows(*values: float) -> Array:
    return np.array(values)


@dataclass(frozen=True)
class FrankaLimits:
    """Motion limits in the settings of a Franka arm. Joint arrays have shape (7,), and Cartesian limits are
    (translation, rotation).

    Attributes:
        velocity_offset, deceleration: parameters of the FR3's velocity limits near a position limit:
            min(velocity, max(0, -offset + sqrt(2 deceleration (upper - q)))); empty for a Panda.
    """

    model: str
    lower: Array  # [rad]
    upper: Array  # [rad]
    velocity: Array  # [rad/s]
    acceleration: Array  # [rad/s^2]
    jerk: Array  # [rad/s^3]
    cartesian_velocity: tuple[float, float]  # [m/s, rad/s]
    cartesian_acceleration: tuple[float, float]
    cartesian_jerk: tuple[float, float]
    elbow_velocity: float
    elbow_acceleration: float
    elbow_jerk: float
    torque: Array = field(default_factory=lambda: _rows(87, 87, 87, 87, 12, 12, 12))  # [Nm]
    torque_rate: float = 1000.0  # [Nm/s]
    velocity_offset: Array = field(default_factory=lambda: np.zeros(0))  # [rad/s]
    deceleration: Array = field(default_factory=lambda: np.zeros(0))  # [rad/s^2]
    velocity_lower: Array = field(default_factory=lambda: np.zeros(0))  # [rad] where the speed limit is 0
    velocity_upper: Array = field(default_factory=lambda: np.zeros(0))  # [rad]

    def velocity_range(self, q: ArrayLike) -> tuple[Array, Array]:
        """Return the lowest and highest joint velocities (7,) [rad/s] that the motion limits in a Franka
        arm's settings allow at positions q (7,) [rad].
        """
        if not len(self.deceleration):
            return -self.velocity, self.velocity
        q = np.asarray(q, dtype=float)
        up = np.sqrt(np.maximum(2.0 * self.deceleration * (self.velocity_upper - q), 0.0))
        down = np.sqrt(np.maximum(2.0 * self.deceleration * (q - self.velocity_lower), 0.0))
        return (
            -np.minimum(self.velocity, np.maximum(down - self.velocity_offset, 0.0)),
            np.minimum(self.velocity, np.maximum(up - self.velocity_offset, 0.0)),
        )


FR3 = FrankaLimits(
    model="fr3",
    lower=_rows(-2.7437, -1.7837, -2.9007, -3.0421, -2.8065, 0.5445, -3.0159),
    upper=_rows(2.7437, 1.7837, 2.9007, -0.1518, 2.8065, 4.5169, 3.0159),
    velocity=_rows(2.62, 2.62, 2.62, 2.62, 5.26, 4.18, 5.26),
    acceleration=np.full(7, 10.0),
    jerk=np.full(7, 5000.0),
    cartesian_velocity=(3.0, 2.5),
    cartesian_acceleration=(9.0, 17.0),
    cartesian_jerk=(4500.0, 8500.0),
    elbow_velocity=1.5,
    elbow_acceleration=10.0,
    elbow_jerk=5000.0,
    velocity_offset=_rows(0.30, 0.20, 0.20, 0.30, 0.35, 0.35, 0.35),
    deceleration=_rows(6.0, 2.585, 3.50, 4.0, 17.0, 5.5, 17.0),
    velocity_lower=_rows(-2.75010, -1.79180, -2.90650, -3.0481, -2.81010, 0.54092, -3.01960),
    velocity_upper=_rows(2.75010, 1.79180, 2.90650, -0.1458, 2.81010, 4.52050, 3.01960),
)

PANDA = FrankaLimits(
    model="panda",
    lower=_rows(-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973),
    upper=_rows(2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973),
    velocity=_rows(2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61),
    acceleration=_rows(15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0),
    jerk=_rows(7500.0, 3750.0, 5000.0, 6250.0, 7500.0, 10000.0, 10000.0),
    cartesian_velocity=(1.7, 2.5),
    cartesian_acceleration=(13.0, 25.0),
    cartesian_jerk=(6500.0, 12500.0),
    elbow_velocity=2.175,
    elbow_acceleration=10.0,
    elbow_jerk=5000.0,
)

LIMITS = {each.model: each for each in (FR3, PANDA)}


def limits_of(model: str) -> FrankaLimits:
    """Return the motion limits in the settings of a Franka arm, given the name of its model.

    Raises:
        UnknownNameError: the model is not an arm of Franka's that armcell knows.
    """
    if model not in LIMITS:
        raise UnknownNameError("Franka model", model, LIMITS)
    return LIMITS[model]


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
