"""Velocity profiles along a path: a trapezoid whose corners are rounded by a moving average."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

SAMPLE_TIME = 0.008  # [s] largest time between trajectory points
CLOSE = 5e-4  # [s] switching times with a smaller difference get one point


@dataclass(frozen=True)
class Trapezoid:
    """Trapezoidal velocity profile of a Pilz motion from rest to rest, like MoveIt's ATrap.

    Attributes:
        speed: of the middle phase.
        up, flat, down: durations of the phases [s].
    """

    speed: float
    up: float
    flat: float
    down: float

    @staticmethod
    def fastest(distance: float, velocity: float, acceleration: float, deceleration: float) -> Trapezoid:
        """Create the fastest trapezoidal velocity profile over a distance > 0; a short distance has no phase
        of constant speed.
        """
        half = 0.5 / acceleration + 0.5 / deceleration
        speed = min(velocity, float(np.sqrt(distance / half)))
        flat = max(distance / speed - speed * half, 0.0)
        return Trapezoid(speed, speed / acceleration, flat, speed / deceleration)

    @property
    def duration(self) -> float:
        return self.up + self.flat + self.down

    @property
    def distance(self) -> float:
        return self.speed * (self.up / 2 + self.flat + self.down / 2)

    def at(self, t: ArrayLike) -> tuple[Array, Array, Array]:
        """Return the time integral of the position, the position itself, and the speed of a trapezoidal
        velocity profile at times (m,).

        The profile is at rest before its start and after its end.
        """
        t = np.asarray(t, dtype=float)
        v, a, d = self.speed, self.speed / self.up, self.speed / self.down
        t1 = np.clip(t, 0.0, self.up)
        t2 = np.clip(t - self.up, 0.0, self.flat)
        t3 = np.clip(t - self.up - self.flat, 0.0, self.down)
        first, second = v * self.up / 2, v * (self.up / 2 + self.flat)  # positions at the ends of the phases
        integral = (
            a * t1**3 / 6
            + t2 * (first + v * t2 / 2)
            + t3 * (second + t3 * (v / 2 - d * t3 / 6))
            + self.distance * np.maximum(t - self.duration, 0.0)
        )
        place = a * t1**2 / 2 + v * t2 + t3 * (v - d * t3 / 2)
        return integral, place, a * t1 - d * t3


@dataclass(frozen=True)
class Profile:
    """Velocity profile of a Pilz motion: a trapezoid whose corners are rounded by a moving average over a
    time window.

    The averaged profile is never faster, has no higher acceleration, and is longer by `window` [s], because
    an average of values within a limit stays within it. Its acceleration is piecewise linear.
    """

    trapezoid: Trapezoid
    window: float

    @property
    def duration(self) -> float:
        return self.trapezoid.duration + self.window

    def at(self, t: ArrayLike) -> tuple[Array, Array, Array]:
        """Evaluate the position, speed and acceleration of a trapezoidal velocity profile smoothed by a
        moving average, at times (m,).
        """
        t = np.asarray(t, dtype=float)
        now, then = self.trapezoid.at(t), self.trapezoid.at(t - self.window)
        place, speed, acceleration = ((a - b) / self.window for a, b in zip(now, then, strict=True))
        return place, speed, acceleration

    def times(self) -> Array:
        """Return the times [s] at which to sample a trapezoidal velocity profile that is smoothed by a moving
        average.

        Points are at the corners of the acceleration and, between them, at most `SAMPLE_TIME` apart.
        """
        z = self.trapezoid
        ends = np.array([0.0, z.up, z.up + z.flat, z.duration])
        corners = np.unique(np.concatenate([ends, ends + self.window]))
        corners = corners[np.append(np.diff(corners) > CLOSE, True)]
        corners[0] = 0.0
        parts = [
            np.linspace(a, b, int(np.ceil((b - a) / SAMPLE_TIME)), endpoint=False)
            for a, b in pairwise(corners)
        ]
        return np.concatenate([*parts, corners[-1:]])
