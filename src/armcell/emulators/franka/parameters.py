"""Parameters of the emulated Franka arm that clients set, with the robot's defaults."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

T_F_NE = np.array(  # nominal end effector of a Franka Hand: turned by -45 degrees, 103.4 mm ahead
    [
        [np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0],
        [-np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0],
        [0.0, 0.0, 1.0, 0.1034],
        [0.0, 0.0, 0.0, 1.0],
    ]
)


@dataclass
class Thresholds:
    """Thresholds in the parameters of a Franka robot for contact (lower) and collision (upper):
    torques (7,) [Nm] and wrenches (6,).

    Wrenches are in [N, Nm]. The defaults are those of Franka's ROS packages.
    """

    torque: dict[str, Array] = field(default_factory=lambda: _both((25, 25, 22, 20, 19, 17, 14), 10.0))
    force: dict[str, Array] = field(default_factory=lambda: _both((30, 30, 30, 25, 25, 25), 10.0))

    def set(self, values: Array) -> bool:
        """Set all contact thresholds in the parameters of a Franka robot from the numbers (52,) of
        SetCollisionBehavior. Return False and change nothing if one is negative.
        """
        if np.any(values < 0.0):
            return False
        names = ("lower_acceleration", "upper_acceleration", "lower", "upper")
        self.torque = dict(zip(names, values[:28].reshape(4, 7), strict=True))
        self.force = dict(zip(names, values[28:].reshape(4, 6), strict=True))
        return True


def _both(lower: Sequence[float], more: float) -> dict[str, Array]:
    low, high = np.array(lower, dtype=float), np.array(lower, dtype=float) + more
    return {"lower": low, "upper": high, "lower_acceleration": low, "upper_acceleration": high}


@dataclass
class Load:
    """Parameters of the load that a Franka robot carries: mass [kg], center of mass (3,) [m] in the flange
    frame, and inertia (9,) [kg m^2].
    """

    mass: float = 0.0
    center: Array = field(default_factory=lambda: np.zeros(3))
    inertia: Array = field(default_factory=lambda: np.zeros(9))

    @property
    def is_valid(self) -> bool:
        """Return whether a Franka robot accepts the parameters of a load, apart from the limit of the
        mass.
        """
        tensor = self.inertia.reshape(3, 3)
        if not (self.mass >= 0.0 and np.allclose(tensor, tensor.T)) or np.linalg.norm(self.center) > 0.5:
            return False
        return not np.linalg.eigvalsh(tensor)[0] < -1e-9


@njit(cache=True)
def compare(torque, force, lower_torque, lower_force, upper_torque, upper_force, contacts):
    """Compare the external torques (7,) [Nm] and forces (6,) [N, Nm] on a Franka robot with the thresholds in
    its parameters.

    Args:
        lower_torque, ...: thresholds for contact (lower) and collision (upper).
        contacts: (2, 13) 1 for each joint, then each axis, above its lower and its upper threshold, else 0;
            changed in place.
    """
    for j in range(7):
        contacts[0, j], contacts[1, j] = abs(torque[j]) > lower_torque[j], abs(torque[j]) > upper_torque[j]
    for i in range(6):
        contacts[0, 7 + i] = abs(force[i]) > lower_force[i]
        contacts[1, 7 + i] = abs(force[i]) > upper_force[i]
