"""Universal Robots arms by model: geometry, limits, kind of controller.

Source: Universal Robots, "DH parameters for calculations of kinematics and dynamics", and the user manuals
(velocities). UR's documents give no acceleration limits; 40 rad/s^2 is what `servoj` is let reach here.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

from armcell.control.ur_wire.primary import Kinematics
from armcell.core import UnknownNameError

JOINTS = ("base", "shoulder", "elbow", "wrist 1", "wrist 2", "wrist 3")
_ALPHA = (pi / 2, 0.0, 0.0, pi / 2, -pi / 2, 0.0)


@dataclass(frozen=True)
class UrModel:
    name: str
    e_series: bool
    dh: Kinematics  # nominal
    velocity: tuple[float, ...] = (2.0943951, 2.0943951, pi, pi, pi, pi)  # [rad/s]
    acceleration: float = 40.0  # [rad/s^2]
    max_position: float = 2 * pi  # [rad]

    @property
    def frequency(self) -> float:
        """Of control and RTDE [Hz]."""
        return 500.0 if self.e_series else 125.0

    @property
    def version(self) -> tuple[int, int, int, int]:
        """Of the controller's software, as an emulator reports it."""
        return (5, 11, 1, 108318) if self.e_series else (3, 15, 8, 106339)

    @property
    def dashboard_name(self) -> str:
        """What `get robot model` answers: e-Series robots leave out their e."""
        return self.name.removesuffix("e")


def _dh(a2: float, a3: float, d1: float, d4: float, d5: float, d6: float) -> Kinematics:
    return Kinematics((0.0,) * 6, (0.0, a2, a3, 0.0, 0.0, 0.0), (d1, 0.0, 0.0, d4, d5, d6), _ALPHA)


MODELS = {
    "UR10": UrModel("UR10", False, _dh(-0.612, -0.5723, 0.1273, 0.163941, 0.1157, 0.0922)),
    "UR10e": UrModel("UR10e", True, _dh(-0.6127, -0.57155, 0.1807, 0.17415, 0.11985, 0.11655)),
}


def ur_model(name: str) -> UrModel:
    if name not in MODELS:
        raise UnknownNameError("UR model", name, MODELS)
    return MODELS[name]
