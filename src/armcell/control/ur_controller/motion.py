"""Motions of the emulated arm: each gives the joints' next target, a control step at a time.

`step(arm, dt)` returns target positions and velocities (6,) [rad, rad/s]; dt [s] is what the speed slider
and a pause have left of the control period. `done` says that the motion has reached its end.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.control.ur_wire.kinematics import forward, inverse, jacobian
from armcell.control.ur_wire.models import UrModel
from armcell.control.ur_wire.primary import Kinematics
from armcell.core import SE3, ArmcellError

Array = NDArray[np.float64]


class MotionFault(ArmcellError):
    """The arm cannot do what was asked; a controller answers with a protective stop."""


class Setpoint:
    """Where the arm is told to be, and what bounds it."""

    def __init__(self, model: UrModel, dh: Kinematics, q: ArrayLike):
        self.model, self.dh = model, dh
        self.q, self.v = np.array(q, dtype=float), np.zeros(6)
        self.tcp: list[float] = [0.0] * 6
        self.v_max = np.array(model.velocity)

    def towards(self, v_wanted: Array, a: float, dt: float) -> tuple[Array, Array]:
        """One step at a velocity as near to the wanted one as acceleration and speed limits let it be."""
        v = self.v + np.clip(np.clip(v_wanted, -self.v_max, self.v_max) - self.v, -a * dt, a * dt)
        return self.q + v * dt, v


class StopJ:
    """Brake all joints in proportion, the fastest at `a` [rad/s^2]."""

    def __init__(self, a: float):
        self.a, self.done = max(float(a), 0.1), False

    def step(self, s: Setpoint, dt: float) -> tuple[Array, Array]:
        fastest = float(np.abs(s.v).max())
        left = max(fastest - self.a * dt, 0.0)
        v = s.v * (left / fastest) if fastest > 0 else np.zeros(6)
        self.done = left == 0.0
        return s.q + 0.5 * (s.v + v) * dt, v


class StopL(StopJ):
    """Brake so that the tool slows by `a` [m/s^2]; by joints, which take as long."""

    def __init__(self, a: float, s: Setpoint):
        tool = float(np.linalg.norm((jacobian(s.dh, s.q) @ s.v)[:3]))
        seconds = max(tool / max(float(a), 0.05), 1e-3)
        super().__init__(max(float(np.abs(s.v).max()) / seconds, 1.0))


class _Along:
    """Along a path of given length with a trapezoid of speed; a moving arm first comes to rest."""

    def __init__(self, length: float, v: float, a: float, seconds: float):
        if not (v > 0 and a > 0):
            raise MotionFault("speed and acceleration must be positive")
        self.length, self.done, self._t = length, length < 1e-9, 0.0
        v = min(v, np.sqrt(length * a)) if length > 0 else v
        self._rise = v / a
        self.duration = length / v + v / a if length > 0 else 0.0
        if seconds > 0 and length > 0:
            self._rise, self.duration = self._rise / self.duration * seconds, seconds
        self._stop: StopJ | None = StopJ(8.0)

    def advance(self, s: Setpoint, dt: float) -> tuple[Array, Array] | float:
        """The arm's braking step, or the fraction (0..1) of the path."""
        if self._stop is not None:
            if np.abs(s.v).max() > 1e-6:
                return self._stop.step(s, dt)
            self._stop = None
            self.begin(s)
        self._t = min(self._t + dt, self.duration)
        if self.duration == 0.0 or self._t >= self.duration - 1e-12:
            self.done = True
            return 1.0
        rise, t, total = self._rise, self._t, self.duration
        peak = 1.0 / (total - rise)
        if t < rise:
            return 0.5 * peak * t * t / rise
        if t < total - rise:
            return peak * (t - 0.5 * rise)
        return 1.0 - 0.5 * peak * (total - t) ** 2 / rise

    def begin(self, s: Setpoint) -> None:
        """The arm rests: the path starts here."""


class MoveJ(_Along):
    def __init__(self, s: Setpoint, goal: ArrayLike, a: float, v: float, seconds: float = 0.0):
        self.goal = np.asarray(goal, dtype=float)
        if self.goal.shape != (6,) or not np.isfinite(self.goal).all():
            raise MotionFault("a target of joints needs six finite numbers")
        if np.abs(self.goal).max() > s.model.max_position + 1e-6:
            raise MotionFault("the target is out of the joints' range")
        self._start = s.q.copy()
        super().__init__(float(np.abs(self.goal - s.q).max()), min(v, float(s.v_max.min())), a, seconds)

    def begin(self, s: Setpoint) -> None:
        self._start = s.q.copy()

    def step(self, s: Setpoint, dt: float) -> tuple[Array, Array]:
        reached = self.advance(s, dt)
        if isinstance(reached, tuple):
            return reached
        q = self._start + reached * (self.goal - self._start)
        return q, (q - s.q) / dt if dt > 0 and not self.done else np.zeros(6)


class MoveL(_Along):
    def __init__(self, s: Setpoint, goal: Array, a: float, v: float, seconds: float = 0.0):
        self._goal = SE3.from_matrix(goal)
        self._from = SE3.from_matrix(forward(s.dh, s.q, s.tcp))
        distance, angle = self._from.distance_to(self._goal)
        super().__init__(max(distance, 0.3 * angle), v, a, seconds)

    def begin(self, s: Setpoint) -> None:
        self._from = SE3.from_matrix(forward(s.dh, s.q, s.tcp))

    def step(self, s: Setpoint, dt: float) -> tuple[Array, Array]:
        reached = self.advance(s, dt)
        if isinstance(reached, tuple):
            return reached
        q = inverse(s.dh, self._from.interpolate(self._goal, reached).matrix, s.q, s.tcp, iterations=8)
        if q is None:
            raise MotionFault("the straight line leaves what the arm can reach")
        if dt > 0 and np.any(np.abs(q - s.q) > s.v_max * dt * 1.05 + 1e-6):
            raise MotionFault("the straight line needs more than the joints' speed (near a singularity)")
        return q, (q - s.q) / dt if dt > 0 and not self.done else np.zeros(6)


class ServoJ:
    """Follow a moving target: a smoothing of about lookahead * 300 / gain seconds, within the limits."""

    done = False

    def __init__(self, s: Setpoint, q: ArrayLike, lookahead: float, gain: float):
        self.goal = np.asarray(q, dtype=float)
        if self.goal.shape != (6,) or not np.isfinite(self.goal).all():
            raise MotionFault("servoj needs six finite numbers")
        lookahead, gain = float(np.clip(lookahead, 0.03, 0.2)), float(np.clip(gain, 100, 2000))
        self._smooth = max(lookahead * 300.0 / gain, 1.0 / s.model.frequency)

    def step(self, s: Setpoint, dt: float) -> tuple[Array, Array]:
        if dt <= 0:
            return s.q, np.zeros(6)
        error, a = self.goal - s.q, s.model.acceleration
        fastest = np.minimum(np.abs(error) / max(self._smooth, dt), np.sqrt(1.6 * a * np.abs(error)))
        return s.towards(np.sign(error) * fastest, a, dt)


class SpeedJ:
    """Joint velocities [rad/s], reached at `a` [rad/s^2]."""

    done = False

    def __init__(self, s: Setpoint, v: ArrayLike, a: float):
        self.v, self.a = np.asarray(v, dtype=float), min(max(float(a), 0.01), s.model.acceleration)
        if self.v.shape != (6,) or not np.isfinite(self.v).all():
            raise MotionFault("speedj needs six finite numbers")

    def step(self, s: Setpoint, dt: float) -> tuple[Array, Array]:
        return s.towards(self.v, self.a, dt)


class SpeedL(SpeedJ):
    """A velocity of the tool [m/s, rad/s, base frame], reached at `a` [m/s^2]."""

    def step(self, s: Setpoint, dt: float) -> tuple[Array, Array]:
        J = jacobian(s.dh, s.q, forward(s.dh, s.q, s.tcp)[:3, 3])
        now = J @ s.v
        v = now + np.clip(self.v - now, -self.a * dt, self.a * dt)
        joints = np.asarray(np.linalg.solve(J.T @ J + 1e-6 * np.eye(6), J.T @ v), dtype=float)
        return s.towards(joints, s.model.acceleration, dt)


Motion = StopJ | MoveJ | MoveL | ServoJ | SpeedJ
