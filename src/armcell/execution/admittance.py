"""Admittance control: moves the setpoint so that the contact force stays near its target.

Outside a dead band, v = (f - f_target) / damping, limited in speed and total offset (Hogan, "Impedance
control", 1985, in its admittance form for position-controlled robots). A first-order filter suppresses the
sensor's noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.core.checks import require

Array = NDArray[np.float64]


@dataclass(frozen=True)
class AdmittanceSettings:
    """Parameters of an admittance controller for one or more force directions, in SI units."""

    damping: float = 20_000.0  # [N s/m] a larger value makes the setpoint yield more slowly
    dead_band: float = 2.0  # [N] force errors below this value cause no motion
    max_speed: float = 0.01  # [m/s]
    max_offset: float = 4e-4  # [m] largest offset from the planned setpoint
    filter_time: float = 0.02  # [s] time constant of the first-order force filter

    def __post_init__(self) -> None:
        for name in ("damping", "max_speed", "max_offset"):
            require(getattr(self, name) > 0, f"{name} is {getattr(self, name):g}, it must be positive")
        for name in ("dead_band", "filter_time"):
            require(getattr(self, name) >= 0, f"{name} is {getattr(self, name):g}, it must not be negative")


class Admittance:
    """Admittance controller, which shifts a setpoint (n,) [m] so that the force error (n,) [N] becomes
    smaller.

    Attributes:
        offset: current offset from the planned setpoint (n,) [m].
        force: filtered force measurement (n,) [N].
    """

    def __init__(self, settings: AdmittanceSettings, size: int = 3):
        self.settings = settings
        self.offset, self.force = np.zeros(size), np.zeros(size)
        self._first = True

    def update(self, force: ArrayLike, dt: float, wanted: ArrayLike = 0.0) -> Array:
        """Advance an admittance controller by one control period under a measured force, and return the new
        setpoint offset (n,) [m].

        Args:
            force: measured force (n,) [N]. A force above the target moves the setpoint in the positive
                direction.
            dt: control period [s].
            wanted: target force, a scalar or (n,) [N].
        """
        s, f = self.settings, np.asarray(force, dtype=float)
        share = 1.0 if self._first or s.filter_time == 0 else dt / (s.filter_time + dt)
        self._first = False
        self.force = self.force + share * (f - self.force)
        error = self.force - np.asarray(wanted, dtype=float)
        size = float(np.linalg.norm(error))
        if size > s.dead_band:
            velocity = error * ((size - s.dead_band) / size / s.damping)
            speed = float(np.linalg.norm(velocity))
            self.offset = self.offset + velocity * (dt * min(1.0, s.max_speed / max(speed, 1e-12)))
        far = float(np.linalg.norm(self.offset))
        if far > s.max_offset:
            self.offset = self.offset * (s.max_offset / far)
        return self.offset
