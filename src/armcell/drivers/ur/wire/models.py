"""Universal Robots arms by model: geometry, limits, masses, and controller generation.

Source: Universal Robots, "DH parameters for calculations of kinematics and dynamics" (geometry, masses,
centers of mass), and the user manuals (velocities, torques). All values agree with the package
ur_description 2.4.5 (`config/*/physical_parameters.yaml`, `default_kinematics.yaml`, `joint_limits.yaml`).
UR7e and UR12e have the geometry of UR5e and UR10e. UR publishes no acceleration limits; `servoj` reaches
40 rad/s^2 here.
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
    e_series: bool  # also the later UR20 and UR30, with the same software and rates
    dh: Kinematics  # nominal
    link_masses: tuple[float, ...]  # [kg]
    link_centers: tuple[tuple[float, float, float], ...]  # [m] centers of mass, each in its link's DH frame
    torque: tuple[float, ...]  # [Nm]
    velocity: tuple[float, ...]  # [rad/s]
    acceleration: float = 40.0  # [rad/s^2]
    max_position: float = 2 * pi  # [rad]
    software: tuple[int, int, int] | None = None  # None: the newest version

    @property
    def frequency(self) -> float:
        """Return the frequency [Hz] of the control loop and RTDE of a UR model."""
        return 500.0 if self.e_series else 125.0

    @property
    def version(self) -> tuple[int, int, int, int]:
        """Return the controller software version of a UR model as four numbers.

        The numbers are major, minor, bugfix and build.
        """
        if self.software is not None:
            return (*self.software, 100000)
        return (5, 26, 0, 130216) if self.e_series else (3, 15, 8, 106339)

    def with_software(self, text: str) -> UrModel:
        """Return a copy of a UR arm's model whose controller runs an older software version, such as "3.4" or
        "5.11.1".

        Raises:
            InputError: the version is invalid or not emulated for this controller generation.
        """
        parts = text.split(".")
        if not all(p.isdigit() for p in parts) or not 2 <= len(parts) <= 3:
            raise InputError(f"invalid software version {text!r}", hint="such as 3.4 or 5.11.1")
        major, minor, bugfix = (*map(int, parts), 0)[:3]
        newest = UrModel.version.fget(replace(self, software=None))  # type: ignore[attr-defined]
        oldest = (5, 0) if self.e_series else (3, 2)
        if not oldest <= (major, minor) <= newest[:2]:
            last, first = (".".join(map(str, v[:2])) for v in (newest, oldest))
            raise InputError(f"a {self.name} with software {text} is not emulated", hint=f"{first} to {last}")
        return replace(self, software=(major, minor, bugfix))

    @property
    def cb3_version(self) -> tuple[int, int]:
        """Return the CB3 software version that has the same client interfaces as the software of a UR model.

        e-Series 5.0 corresponds to CB3 3.5, 5.10 to 3.15.
        """
        major, minor = self.version[:2]
        return (3, minor + 5) if major == 5 else (major, minor)

    @property
    def dashboard_name(self) -> str:
        """Return the model name of a UR robot as the dashboard command `get robot model` reports it, without
        the trailing e of e-Series names: UR5 for a UR5e.
        """
        return self.name.removesuffix("e")


def _dh(a2: float, a3: float, d1: float, d4: float, d5: float, d6: float) -> Kinematics:
    return Kinematics((0.0,) * 6, (0.0, a2, a3, 0.0, 0.0, 0.0), (d1, 0.0, 0.0, d4, d5, d6), _ALPHA)


_UR3 = (
    (0.0, -0.02, 0.0), (0.13, 0.0, 0.1157), (0.05, 0.0, 0.0238),
    (0.0, 0.0, 0.01), (0.0, 0.0, 0.01), (0.0, 0.0, -0.02),
)  # fmt: skip
_UR5 = (
    (0.0, -0.02561, 0.00193), (0.2125, 0.0, 0.11336), (0.15, 0.0, 0.0265),
    (0.0, -0.0018, 0.01634), (0.0, 0.0018, 0.01634), (0.0, 0.0, -0.001159),
)  # fmt: skip
_UR10 = (
    (0.021, 0.0, 0.027), (0.38, 0.0, 0.158), (0.24, 0.0, 0.068),
    (0.0, 0.007, 0.018), (0.0, 0.007, 0.018), (0.0, 0.0, -0.026),
)  # fmt: skip
_UR16 = (
    (0.0, -0.016, 0.03), (0.302, 0.0, 0.16), (0.194, 0.0, 0.065),
    (0.0, -0.009, 0.011), (0.0, 0.018, 0.012), (0.0, 0.0, -0.044),
)  # fmt: skip
_UR20 = (
    (0.0, -0.061, 0.0062), (0.5226, 0.0, 0.2098), (0.3234, 0.0, 0.0604),
    (0.0, -0.0026, 0.0393), (0.0, 0.0024, 0.0379), (0.0, 0.0, -0.0293),
)  # fmt: skip
_UR30 = (
    (-0.0001, -0.06, 0.0069), (0.3894, 0.0, 0.2103), (0.2257, 0.0, 0.0629),
    (0.0, -0.0048, 0.0353), (0.0, 0.0046, 0.0341), (0.0, 0.0, -0.0293),
)  # fmt: skip
_SLOW, _FAST = 2 * pi / 3, 2 * pi  # [rad/s]
_SPEEDS = {
    "small": (pi, pi, pi, _FAST, _FAST, _FAST),
    "medium": (pi,) * 6,
    "large": (_SLOW, _SLOW, pi, pi, pi, pi),
    "heavy": (_SLOW, _SLOW, 5 * pi / 6, 7 * pi / 6, 7 * pi / 6, 7 * pi / 6),
}


def _model(
    name: str, dh: Kinematics, masses: tuple[float, ...], centers: tuple, size: str, torque: tuple[float, ...]
) -> UrModel:
    """Return the model of one UR arm. `torque` [Nm] contains the values for the shoulder joints,
    the elbow and the wrists.
    """
    high, middle, low = torque
    torques = (high, high, middle, low, low, low)
    return UrModel(name, name not in ("UR3", "UR5", "UR10"), dh, masses, centers, torques, _SPEEDS[size])


MODELS = {
    model.name: model
    for model in (
        _model(
            "UR3",
            _dh(-0.24365, -0.21325, 0.1519, 0.11235, 0.08535, 0.0819),
            (2.0, 3.42, 1.26, 0.8, 0.8, 0.35),
            _UR3, "small", (56.0, 28.0, 12.0),
        ),
        _model(
            "UR5",
            _dh(-0.425, -0.39225, 0.089159, 0.10915, 0.09465, 0.0823),
            (3.7, 8.393, 2.33, 1.219, 1.219, 0.1879),
            _UR5, "medium", (150.0, 150.0, 28.0),
        ),
        _model(
            "UR10",
            _dh(-0.612, -0.5723, 0.1273, 0.163941, 0.1157, 0.0922),
            (7.1, 12.7, 4.27, 2.0, 2.0, 0.365),
            _UR10, "large", (330.0, 150.0, 56.0),
        ),
        _model(
            "UR3e",
            _dh(-0.24355, -0.2132, 0.15185, 0.13105, 0.08535, 0.0921),
            (1.98, 3.4445, 1.437, 0.871, 0.805, 0.261),
            _UR3, "small", (54.0, 28.0, 9.0),
        ),
        _model(
            "UR5e",
            _dh(-0.425, -0.3922, 0.1625, 0.1333, 0.0997, 0.0996),
            (3.761, 8.058, 2.846, 1.37, 1.3, 0.365),
            _UR5, "medium", (150.0, 150.0, 28.0),
        ),
        _model(
            "UR10e",
            _dh(-0.6127, -0.57155, 0.1807, 0.17415, 0.11985, 0.11655),
            (7.369, 13.051, 3.989, 2.1, 1.98, 0.615),
            _UR10, "large", (330.0, 150.0, 54.0),
        ),
        _model(
            "UR16e",
            _dh(-0.4784, -0.36, 0.1807, 0.17415, 0.11985, 0.11655),
            (7.369, 10.45, 4.321, 2.18, 2.033, 0.907),
            _UR16, "large", (330.0, 150.0, 54.0),
        ),
        _model(
            "UR20",
            _dh(-0.862, -0.7287, 0.2363, 0.201, 0.1593, 0.1543),
            (16.343, 29.632, 7.879, 3.054, 3.126, 0.926),
            _UR20, "heavy", (738.0, 433.0, 107.0),
        ),
        _model(
            "UR30",
            _dh(-0.637, -0.5037, 0.2363, 0.201, 0.1593, 0.1543),
            (16.343, 28.542, 7.156, 3.054, 3.126, 0.926),
            _UR30, "heavy", (738.0, 433.0, 107.0),
        ),
    )
}  # fmt: skip


def ur_model(name: str) -> UrModel:
    if name not in MODELS:
        raise UnknownNameError("UR model", name, MODELS)
    return MODELS[name]
