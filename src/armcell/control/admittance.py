"""Admittance: a measured force moves the set point a little, so that it stays near the force wanted.

v = (f - f_wanted) / damping beyond a dead band, within a speed and a distance (Hogan, "Impedance control",
1985, turned round for robots that take positions). A first-order filter takes off the sensor's noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.core.checks import require

Array = NDArray[np.float64]


@dataclass(frozen=True)
class AdmittanceSettings:
    """Of one direction or several; SI units."""

    damping: float = 20_000.0  # [N s/m] the larger, the slower the set point gives way
    dead_band: float = 2.0  # [N] force errors below which nothing moves
    max_speed: float = 0.01  # [m/s]
    max_offset: float = 4e-4  # [m] of the set point from where it was planned
    filter_time: float = 0.02  # [s] of the force's first-order filter

    def __post_init__(self) -> None:
        for name in ("damping", "max_speed", "max_offset"):
            require(getattr(self, name) > 0, f"{name} is {getattr(self, name):g}, it must be positive")
        for name in ("dead_band", "filter_time"):
            require(getattr(self, name) >= 0, f"{name} is {getattr(self, name):g}, it must not be negative")


class Admittance:
    """The offset of a set point (n,) [m] that follows force errors (n,) [N].

    Attributes:
        offset: where the set point is from where it was planned. force: as filtered.
    """

    def __init__(self, settings: AdmittanceSettings, size: int = 3):
        self.settings = settings
        self.offset, self.force = np.zeros(size), np.zeros(size)
        self._first = True

    def update(self, force: ArrayLike, dt: float, wanted: ArrayLike = 0.0) -> Array:
        """The offset after `dt` [s] under a measured force; positive force errors move it forwards."""
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
