"""Compliant modes of the emulated UR arm: force mode and freedrive.

Along the compliant axes of a task frame, the external force moves the tool; along the other axes, the program
does.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from armcell.drivers.ur.wire.kinematics import forward, jacobian, matrix_of
from armcell.emulators.ur.motion import Setpoint

Array = NDArray[np.float64]

FORCE_MOBILITY = np.array([1e-3] * 3 + [2e-2] * 3)  # [m/s/N, rad/s/Nm] in force mode, gain scaling 1
HAND_MOBILITY = np.array([1e-2] * 3 + [1e-1] * 3)  # in freedrive
FREEDRIVE_LIMITS = np.array([0.5] * 3 + [1.5] * 3)  # [m/s, rad/s]
RISE = 0.05  # [s] time constant of the speed's response to the force


@dataclass
class Compliance:
    """Compliance mode of an emulated UR arm: the task frame, the compliant axes and their parameters.

    Attributes:
        T_base_task: (4, 4); None: the tool's frame.
        axes: (6,) True for each compliant axis.
        wrench: (6,) [N, Nm] target wrench of the tool on its surroundings, task frame.
        limits: (6,) speed limits of the compliant axes [m/s, rad/s].
        mobility: (6,) speed per force [m/s/N, rad/s/Nm].
        freedrive: True in freedrive, False in force mode.
    """

    T_base_task: Array | None
    axes: Array
    wrench: Array = field(default_factory=lambda: np.zeros(6))
    limits: Array = field(default_factory=lambda: FREEDRIVE_LIMITS)
    mobility: Array = field(default_factory=lambda: HAND_MOBILITY)
    freedrive: bool = True
    _speed: Array = field(default_factory=lambda: np.zeros(6))

    def keep_speed(self, before: Compliance) -> None:
        """Keep the arm's current compliant speed when the parameters of force mode change, so that the
        motion does not jump.
        """
        self._speed = before._speed

    def apply(self, s: Setpoint, q: Array, felt: Array, dt: float) -> tuple[Array, Array]:
        """Return the joint targets (6,) and speeds (6,) of the emulated UR arm for one step with compliance.

        The program targets q without compliance.

        Args:
            q: the program's joint target at the end of the step (6,) [rad].
            felt: external force and torque on the tool (6,), base frame, about the TCP.
            dt: duration of the step [s].
        """
        T = forward(s.dh, s.q, s.tcp)
        frame = T if self.T_base_task is None else self.T_base_task
        R = np.kron(np.eye(2), frame[:3, :3])  # task to base, forces over torques
        J = jacobian(s.dh, s.q, T[:3, 3])
        program = R.T @ (J @ (q - s.q)) / dt
        wanted = np.clip(self.mobility * (self.wrench + R.T @ felt), -self.limits, self.limits)
        self._speed += (np.where(self.axes, wanted, 0.0) - self._speed) * min(dt / RISE, 1.0)
        twist = R @ np.where(self.axes, self._speed, program)
        joints = np.asarray(np.linalg.solve(J.T @ J + 1e-6 * np.eye(6), J.T @ twist), dtype=float)
        v: Array = np.clip(joints, -s.v_max, s.v_max)
        return s.q + v * dt, v


def freedrive(axes: Array, T_base_task: Array | None) -> Compliance:
    return Compliance(T_base_task, axes)


def force_mode(
    s: Setpoint, task_frame: list[float], axes: Array, wrench: Array, kind: int, limits: Array, gain: float
) -> Compliance:
    """Return the `Compliance` that implements URScript's `force_mode`. The mode's type (1, 2 or 3) determines
    how the task frame is rotated.

    Type 1 rotates the task frame so that its y axis points from the frame's origin to the TCP. Type 2 keeps
    the frame. Type 3 rotates it so that its x axis follows the tool's motion in the frame's x-y plane.
    Source: URScript manual, `force_mode`.
    """
    frame = matrix_of(task_frame)
    T = forward(s.dh, s.q, s.tcp)
    if kind == 1:
        frame = _turned(frame, T[:3, 3] - frame[:3, 3], 1)
    elif kind == 3:
        velocity = (jacobian(s.dh, s.q, T[:3, 3]) @ s.v)[:3]
        frame = _turned(frame, velocity - (velocity @ frame[:3, 2]) * frame[:3, 2], 0)
    mobility = FORCE_MOBILITY * gain
    return Compliance(frame, axes, wrench, np.abs(limits), mobility, freedrive=False)


def _turned(frame: Array, direction: Array, axis: int) -> Array:
    """Rotate the frame of a UR arm's compliance by the smallest angle after which one of its axes points in a
    given direction.

    A zero direction leaves the frame unchanged.
    """
    length = float(np.linalg.norm(direction))
    if length < 1e-6:
        return frame
    old, new = frame[:3, axis], direction / length
    cross, cosine = np.cross(old, new), float(old @ new)
    if cosine < -1.0 + 1e-9:
        return frame  # opposite: the sign of an axis does not matter for compliance
    K = np.array([[0, -cross[2], cross[1]], [cross[2], 0, -cross[0]], [-cross[1], cross[0], 0]])
    turned = frame.copy()
    turned[:3, :3] = (np.eye(3) + K + K @ K / (1.0 + cosine)) @ frame[:3, :3]
    return turned
