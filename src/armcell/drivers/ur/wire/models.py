"""Universal Robots arms by model: geometry, limits, masses, and controller generation.

Source: Universal Robots, "DH parameters for calculations of kinematics and dynamics" (geometry, masses,
centers of mass), and the user manuals (velocities, torques). UR publishes no acceleration limits; `servoj`
reaches 40 rad/s^2 here.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import pi

from armcell.core import InputError, UnknownNameError
from armcell.drivers.ur.wire.primary import Kinematics

JOINTS = ("base", "shoulder", "elbow", "wrist 1", "wrist 2", "wrist 3")
_ALPHA = (pi / 2, 0.0, 0.0, pi / 2, -pi / 2, 0.0)


@dataclass(frozen=True)
class UrModel:
    name: str
    e_series: bool
    dh: Kinematics  # nominal
    link_masses: tuple[float, ...]  # [kg]
    link_centers: tuple[tuple[float, float, float], ...]  # [m] centers of mass, each in its link's DH frame
    torque: tuple[float, ...]  # [Nm]
    velocity: tuple[float, ...] = (2.0943951, 2.0943951, pi, pi, pi, pi)  # [rad/s]
    acceleration: float = 40.0  # [rad/s^2]
    max_position: float = 2 * pi  # [rad]
    software: tuple[int, int, int] | None = None  # None: the newest version

    @property
    def frequency(self) -> float:
        """Frequency of the arm's control loop and of RTDE [Hz]."""
        return 500.0 if self.e_series else 125.0

    @property
    def version(self) -> tuple[int, int, int, int]:
        """Software version that an emulated controller reports: major, minor, bugfix, build."""
        if self.software is not None:
            return (*self.software, 100000)
        return (5, 26, 0, 130216) if self.e_series else (3, 15, 8, 106339)

    def with_software(self, text: str) -> UrModel:
        """Return the model with an older software version, such as "3.4" or "5.11.1".

        Raises:
            InputError: the version is invalid or not emulated for this controller generation.
        """
        parts = text.split(".")
        if not all(p.isdigit() for p in parts) or not 2 <= len(parts) <= 3:
            raise InputError(f"invalid software version {text!r}", cure="such as 3.4 or 5.11.1")
        major, minor, bugfix = (*map(int, parts), 0)[:3]
        newest = UrModel.version.fget(replace(self, software=None))  # type: ignore[attr-defined]
        oldest = (5, 0) if self.e_series else (3, 2)
        if not oldest <= (major, minor) <= newest[:2]:
            last, first = (".".join(map(str, v[:2])) for v in (newest, oldest))
            raise InputError(f"a {self.name} with software {text} is not emulated", cure=f"{first} to {last}")
        return replace(self, software=(major, minor, bugfix))

    @property
    def cb3_version(self) -> tuple[int, int]:
        """CB3 software version with the same client interfaces: e-Series 5.0 is 3.5, 5.10 is 3.15."""
        major, minor = self.version[:2]
        return (3, minor + 5) if major == 5 else (major, minor)

    @property
    def dashboard_name(self) -> str:
        """Model name that the dashboard's `get robot model` returns, without the e of the e-Series."""
        return self.name.removesuffix("e")


def _dh(a2: float, a3: float, d1: float, d4: float, d5: float, d6: float) -> Kinematics:
    return Kinematics((0.0,) * 6, (0.0, a2, a3, 0.0, 0.0, 0.0), (d1, 0.0, 0.0, d4, d5, d6), _ALPHA)


_CENTERS = (
    (0.021, 0.0, 0.027),
    (0.38, 0.0, 0.158),
    (0.24, 0.0, 0.068),
    (0.0, 0.007, 0.018),
    (0.0, 0.007, 0.018),
    (0.0, 0.0, -0.026),
)
_LARGE, _SMALL = (330.0, 330.0, 150.0), {True: (54.0,) * 3, False: (56.0,) * 3}


def _model(name: str, dh: Kinematics, masses: tuple[float, ...]) -> UrModel:
    e_series = name.endswith("e")
    return UrModel(name, e_series, dh, masses, _CENTERS, (*_LARGE, *_SMALL[e_series]))


MODELS = {
    "UR10": _model(
        "UR10",
        _dh(-0.612, -0.5723, 0.1273, 0.163941, 0.1157, 0.0922),
        (7.1, 12.7, 4.27, 2.0, 2.0, 0.365),
    ),
    "UR10e": _model(
        "UR10e",
        _dh(-0.6127, -0.57155, 0.1807, 0.17415, 0.11985, 0.11655),
        (7.369, 13.051, 3.989, 2.1, 1.98, 0.615),
    ),
}


def ur_model(name: str) -> UrModel:
    if name not in MODELS:
        raise UnknownNameError("UR model", name, MODELS)
    return MODELS[name]
