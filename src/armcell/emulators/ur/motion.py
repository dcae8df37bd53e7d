"""Motions of the emulated UR arm, which compute the joint target of the next control step.

`step(arm, dt)` returns target positions and velocities (6,) [rad, rad/s]; dt [s] is the control period scaled
by speed slider and pause. `done` is True when the motion has reached its end.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.core import SE3, SO3, ArmcellError
from armcell.drivers.ur.wire.kinematics import ArmDynamics, forward, inverse, jacobian
from armcell.drivers.ur.wire.models import UrModel
from armcell.drivers.ur.wire.primary import Kinematics

Array = NDArray[np.float64]


class MotionFault(ArmcellError):
    """Error for a motion that the emulated UR arm cannot execute. It causes a protective stop."""


class Setpoint:
    """Setpoint for motions of an emulated UR arm: joint positions and speeds,
    together with the arm's limits and TCP.
    """

    def __init__(self, model: UrModel, dh: Kinematics, q: ArrayLike):
        self.model, self.dh = model, dh
        self.q, self.v = np.array(q, dtype=float), np.zeros(6)
        self.tcp: list[float] = [0.0] * 6
        self.compliant = False  # forces, not the program, move the tool along some axes
        self.v_max = np.array(model.velocity)

    def resting_at(self, q: ArrayLike) -> Setpoint:
        """Return a new setpoint for the motion of an emulated UR arm, at rest at the joint positions q (6,)
        [rad].

        The TCP and the speed limits stay the same.
        """
        other = Setpoint(self.model, self.dh, q)
        other.tcp, other.v_max = self.tcp, self.v_max
        return other

    def accelerated_toward(self, v_wanted: Array, a: float, dt: float) -> tuple[Array, Array]:
        """Accelerate an emulated UR arm toward the desired joint velocities for one step, within the limits
        of acceleration and velocity. Return the next setpoint of the motion.

        Args:
            v_wanted: joint velocities (6,) [rad/s].
            a: acceleration limit [rad/s^2].
            dt: duration of the step [s].
        Returns:
            Positions (6,) [rad] and velocities (6,) [rad/s].
        """
        v = self.v + np.clip(np.clip(v_wanted, -self.v_max, self.v_max) - self.v, -a * dt, a * dt)
        return self.q + v * dt, v


class StopJ:
    """URScript motion stopj, which slows down all joints in proportion.
    The fastest joint decelerates at `a` [rad/s^2].
    """

    def __init__(self, a: float):
        self.a, self.done = max(float(a), 0.1), False

    def step(self, s: Setpoint, dt: float) -> tuple[Array, Array]:
        fastest = float(np.abs(s.v).max())
        left = max(fastest - self.a * dt, 0.0)
        v = s.v * (left / fastest) if fastest > 0 else np.zeros(6)
        self.done = left == 0.0
        return s.q + 0.5 * (s.v + v) * dt, v


class StopL(StopJ):
    """URScript motion stopl, which slows down all joints in
    proportion so that the tool decelerates at `a` [m/s^2].
    """

    def __init__(self, a: float, s: Setpoint):
        tool = float(np.linalg.norm((jacobian(s.dh, s.q) @ s.v)[:3]))
        seconds = max(tool / max(float(a), 0.05), 1e-3)
        super().__init__(max(float(np.abs(s.v).max()) / seconds, 1.0))


class _Along:
    """Motion of an emulated UR arm along a path with a trapezoidal speed profile. If the arm is already
    moving, it first comes to rest.

    Attributes:
        near: True once the tool is within the blend radius of the goal; the next motion may take over.
    """

    near = False

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
        """Advance the emulated UR motion along its path by `dt` [s], and return the reached path fraction
        (0..1).

        If the arm is still moving when the motion begins, the arm brakes first. Until it is at rest, the
        result is the joint target of the braking step instead: positions and velocities (6,).
        """
        if self._stop is not None:
            if np.abs(s.v).max() > 1e-6 and not s.compliant:
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
        """Set the arm's present setpoint as the start of the path of an emulated UR motion.
        The arm is at rest when this method is called.
        """


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

    def goal_positions(self, s: Setpoint) -> Array:
        """Return the joint positions (6,) [rad] at the goal of a movej motion."""
        return self.goal

    def step(self, s: Setpoint, dt: float) -> tuple[Array, Array]:
        reached = self.advance(s, dt)
        if isinstance(reached, tuple):
            return reached
        q = self._start + reached * (self.goal - self._start)
        return q, (q - s.q) / dt if dt > 0 and not self.done else np.zeros(6)


class MoveL(_Along):
    """URScript motion movel, in which the tool of the emulated arm moves along a straight line."""

    name = "straight line"

    def __init__(self, s: Setpoint, goal: Array, a: float, v: float, seconds: float = 0.0):
        self._goal = SE3.from_matrix(goal)
        self._from = SE3.from_matrix(forward(s.dh, s.q, s.tcp))
        self._last = s.q
        super().__init__(self.measure(), v, a, seconds)

    def measure(self) -> float:
        """Return the length [m] of a movel motion. A rotation of 1 rad counts as 0.3 m."""
        distance, angle = self._from.distance_to(self._goal)
        return max(distance, 0.3 * angle)

    def begin(self, s: Setpoint) -> None:
        self._from = SE3.from_matrix(forward(s.dh, s.q, s.tcp))
        self._last = s.q

    def goal_positions(self, s: Setpoint) -> Array:
        """Return the joint positions (6,) [rad] at the goal of a movel motion. Of all solutions, the one
        nearest to the last joint positions is chosen.
        """
        q = inverse(s.dh, self._goal.matrix, self._last, s.tcp, iterations=100)
        if q is None:
            raise MotionFault(f"the {self.name} leaves the arm's reach")
        return q

    def pose(self, reached: float) -> SE3:
        """Return T_base_tcp at a fraction (0..1) of the straight path of a movel motion."""
        return self._from.interpolate(self._goal, reached)

    def step(self, s: Setpoint, dt: float) -> tuple[Array, Array]:
        reached = self.advance(s, dt)
        if isinstance(reached, tuple):
            return reached
        q = inverse(s.dh, self.pose(reached).matrix, self._last, s.tcp, iterations=8)
        if q is None:
            raise MotionFault(f"the {self.name} leaves the arm's reach")
        # Relative to the path's last point, because a compliant arm deviates from the path.
        if dt > 0 and np.any(np.abs(q - self._last) > s.v_max * dt * 1.05 + 1e-6):
            raise MotionFault(f"the {self.name} needs more than the joints' speed (near a singularity)")
        v = (q - self._last) / dt if dt > 0 and not self.done else np.zeros(6)
        self._last = q
        return q, v


class MoveC(MoveL):
    """URScript motion movec, in which the tool moves along a circular arc through a via point.

    The orientation is interpolated between start and goal, or stays fixed relative to the arc.
    """

    name = "arc"

    def __init__(
        self, s: Setpoint, via: Array, goal: Array, a: float, v: float, fixed: bool = False
    ):  # fmt: skip
        self._via, self._fixed = np.asarray(via[:3, 3]), fixed
        super().__init__(s, goal, a, v)

    def measure(self) -> float:
        """Compute the arc of a movec motion, and return its length [m].

        Raises:
            MotionFault: start, via point and end are collinear.
        """
        start, end = self._from.translation, self._goal.translation
        u, w = self._via - start, end - start
        normal = np.cross(u, w)
        size = float(normal @ normal)
        if size < 1e-14:
            raise MotionFault("start, via point and end of the arc are on a line")
        center = start + (np.cross(normal, u) * (w @ w) + np.cross(w, normal) * (u @ u)) / (2.0 * size)
        self._center, self._axis = center, normal / np.sqrt(size)
        self._angle = _turn(start - center, end - center, self._axis)
        radius = float(np.linalg.norm(start - center))
        return max(radius * self._angle, 0.3 * self._from.distance_to(self._goal)[1])

    def begin(self, s: Setpoint) -> None:
        super().begin(s)
        self.measure()

    def pose(self, reached: float) -> SE3:
        turned = SO3.exp(self._axis * (self._angle * reached))
        place = self._center + turned.matrix @ (self._from.translation - self._center)
        rotation = turned @ self._from.rotation if self._fixed else super().pose(reached).rotation
        return SE3(rotation, place)


def _turn(a: Array, b: Array, axis: Array) -> float:
    """Return the angle (0..2 pi) [rad] from vector a to vector b about an axis,
    for the arc of a movec motion.
    """
    angle = float(np.arctan2(np.cross(a, b) @ axis, a @ b))
    return angle if angle > 0 else angle + 2.0 * np.pi


class BlendedMotion:
    """Blend (superposition) of two motions of an emulated UR arm.
    The second motion begins before the first one ends.

    The offset of the first motion from its goal decays as that motion ends, so speeds stay continuous and
    the tool passes the goal within about the blend radius.

    Args:
        s: setpoint of the arm.
        first: running motion.
        follow: makes the next motion for an arm at rest at the first one's goal.
    """

    def __init__(self, s: Setpoint, first: Path, follow: Callable[[Setpoint], MoveJ | MoveL]):
        self._first, self._corner = first, first.goal_positions(s)
        self._behind, self._ahead = s.resting_at(s.q), s.resting_at(self._corner)
        self._behind.v = s.v
        self._next = follow(self._ahead)
        self.near, self.done = False, False

    def goal_positions(self, s: Setpoint) -> Array:
        """Return the joint positions (6,) [rad] at the end of two blended UR motions, which is the goal of
        the second one.
        """
        return self._next.goal_positions(s)

    def step(self, s: Setpoint, dt: float) -> tuple[Array, Array]:
        for motion, place in ((self._first, self._behind), (self._next, self._ahead)):
            if not motion.done:
                place.q, place.v = motion.step(place, dt)
        self.done = self._first.done and self._next.done
        q = self._ahead.q + self._behind.q - self._corner
        return q, self._ahead.v + self._behind.v


class TrackL:
    """Motion in which the tool of an emulated UR arm moves to a pose at
    constant speed and does not slow down near it (movep, servoc).

    Attributes:
        near: True within the blend radius of the pose, where the next motion may take over.
    """

    def __init__(self, s: Setpoint, goal: Array, a: float, v: float, blend: float = 0.0):
        if not (v > 0 and a > 0):
            raise MotionFault("speed and acceleration must be positive")
        self._goal, self._v, self._a, self._blend = goal, v, a, blend
        self.done, self.near = False, False

    def settle(self) -> None:
        """Let the tool stop at the pose that movep or servoc tracks, because no further motion follows."""
        self._blend = 0.0

    def step(self, s: Setpoint, dt: float) -> tuple[Array, Array]:
        if dt <= 0:
            return s.q, np.zeros(6)
        T = forward(s.dh, s.q, s.tcp)
        rotation = SE3.from_matrix(self._goal).rotation @ SE3.from_matrix(T).rotation.inverse()
        error = np.concatenate((self._goal[:3, 3] - T[:3, 3], rotation.log()))
        left = max(float(np.linalg.norm(error[:3])), 0.3 * float(np.linalg.norm(error[3:])))
        self.near = left <= max(self._blend, 1e-4)
        J = jacobian(s.dh, s.q, T[:3, 3])
        now = J @ s.v
        braking = self._blend == 0.0
        speed = min(self._v, 0.8 * np.sqrt(2.0 * self._a * left), left / dt) if braking else self._v
        wanted = error / max(left, 1e-9) * speed
        change = wanted - now
        size = float(np.linalg.norm(change[:3])) + 0.3 * float(np.linalg.norm(change[3:]))
        twist = now + change * min(1.0, self._a * dt / max(size, 1e-12))
        self.done = left < 2e-5 and float(np.linalg.norm(now)) < 2.0 * self._a * dt
        joints = np.asarray(np.linalg.solve(J.T @ J + 1e-8 * np.eye(6), J.T @ twist), dtype=float)
        return s.accelerated_toward(joints, s.model.acceleration, dt)


class TorqueMotion:
    """Motion of an emulated UR arm in which a program sets the joint torques. The controller adds the torques
    that compensate gravity.

    The arm's dynamics determine the acceleration.
    """

    done = False

    def __init__(
        self, s: Setpoint, torque: ArrayLike, dynamics: ArmDynamics, external: Array, damping: float
    ):
        self._torque = np.clip(np.asarray(torque, dtype=float), -np.array(s.model.torque), s.model.torque)
        if self._torque.shape != (6,) or not np.isfinite(self._torque).all():
            raise MotionFault("direct_torque needs six finite numbers")
        self._dynamics, self._external, self._damping = dynamics, external, damping

    def step(self, s: Setpoint, dt: float) -> tuple[Array, Array]:
        torque = self._torque + self._external - self._damping * s.v
        torque -= self._dynamics.velocity_torques(s.q, s.v)
        v = s.v + np.linalg.solve(self._dynamics.mass_matrix(s.q), torque) * dt
        if np.any(np.abs(v) > 1.2 * s.v_max):
            raise MotionFault("the torques make a joint faster than it may be")
        return s.q + v * dt, v


class ServoJ:
    """URScript motion servoj, which tracks a joint target smoothed over lookahead * 300 / gain seconds.

    The arm's limits apply.
    """

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
        return s.accelerated_toward(np.sign(error) * fastest, a, dt)


class SpeedJ:
    """URScript motion speedj at constant joint velocities [rad/s],
    reached with the acceleration `a` [rad/s^2].
    """

    done = False

    def __init__(self, s: Setpoint, v: ArrayLike, a: float):
        self.v, self.a = np.asarray(v, dtype=float), min(max(float(a), 0.01), s.model.acceleration)
        if self.v.shape != (6,) or not np.isfinite(self.v).all():
            raise MotionFault("speedj needs six finite numbers")

    def step(self, s: Setpoint, dt: float) -> tuple[Array, Array]:
        return s.accelerated_toward(self.v, self.a, dt)


class SpeedL(SpeedJ):
    """URScript motion speedl at a constant tool velocity [m/s, rad/s, base frame], reached with the
    acceleration `a` [m/s^2].
    """

    def step(self, s: Setpoint, dt: float) -> tuple[Array, Array]:
        J = jacobian(s.dh, s.q, forward(s.dh, s.q, s.tcp)[:3, 3])
        now = J @ s.v
        v = now + np.clip(self.v - now, -self.a * dt, self.a * dt)
        joints = np.asarray(np.linalg.solve(J.T @ J + 1e-6 * np.eye(6), J.T @ v), dtype=float)
        return s.accelerated_toward(joints, s.model.acceleration, dt)


Path = MoveJ | MoveL | BlendedMotion
"""Motions that end at a goal, from which the next one may take over."""

Motion = StopJ | Path | TrackL | ServoJ | SpeedJ | TorqueMotion
KEPT = (ServoJ, SpeedJ, TorqueMotion)
"""Motions that end when the program stops renewing them."""
