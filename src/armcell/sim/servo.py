"""How arm joints are driven to their targets: by the engine's servos, or by a torque PID of our own."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from armcell.sim.built import BuiltModel
from armcell.sim.settings import PhysicsSettings

Array = NDArray[np.float64]
Controls = tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]
"""Index of some joints' targets here, of their positions and of their velocities in MuJoCo's controls."""

INTEGRAL_SHARE = 0.2  # of the effort limit that the integral may give: a blocked arm does not wind up


class ArmServo:
    """Targets of the arm joints, written to the engine's controls.

    With "torque" control the controls are torques [Nm or N], worked out by `update` before every step.
    """

    def __init__(self, built: BuiltModel, settings: PhysicsSettings):
        arm = np.flatnonzero(built.pos_ctrl >= 0)  # columns of the model's order
        self._at = {int(c): i for i, c in enumerate(arm)}
        self.columns = tuple(self._at)
        self._qpos, self._dofs = built.qpos[arm], built.dofs[arm]
        self._pos, self._vel = built.pos_ctrl[arm], built.vel_ctrl[arm]
        self.computed = settings.arm_control == "torque"
        self._feeds_velocity = bool(len(arm)) and bool(self._vel[0] >= 0)
        self.target, self.speed, self.integral = (np.zeros(len(arm)) for _ in range(3))
        self._dt = settings.timestep
        model = built.scene.model
        joints = [model.joints[model.joint_names[c]] for c in arm]
        effort = np.array([j.limits.effort for j in joints])
        self._most = INTEGRAL_SHARE * np.where(np.isfinite(effort), effort, np.inf)
        weak = np.minimum(1.0, effort / settings.full_gain_effort)
        slide = np.array([j.type == "prismatic" for j in joints], dtype=bool)
        self._kp = weak * np.where(slide, settings.slide_kp, settings.arm_kp)
        self._kv = weak * np.where(slide, settings.slide_kv, settings.arm_kv)
        self._ki = weak * settings.arm_ki

    def controls(self, columns: list[int]) -> Controls:
        """Where the targets of some joints, by column of the model's order, belong."""
        at = np.array([self._at[c] for c in columns], dtype=int)
        return at, self._pos[at], self._vel[at]

    def command(self, data: mujoco.MjData, controls: Controls, q: Array, v: Array) -> None:
        """Targets of the joints that `controls` was made for."""
        at, position, velocity = controls
        self.target[at], self.speed[at] = q, v
        if not self.computed:
            data.ctrl[position] = q
            if self._feeds_velocity:
                data.ctrl[velocity] = v

    def hold(self, data: mujoco.MjData, q: Array) -> None:
        """All joints stay at positions q (dof,) of the model's order; the integral is forgotten."""
        columns = list(self._at)
        self.integral[:] = 0.0
        self.command(data, self.controls(columns), q[columns], np.zeros(len(columns)))

    def update(self, data: mujoco.MjData) -> None:
        """The torques of the step to come."""
        error = self.target - data.qpos[self._qpos]
        self.integral = np.clip(self.integral + self._ki * error * self._dt, -self._most, self._most)
        damping = self._kv * (self.speed - data.qvel[self._dofs])
        data.ctrl[self._pos] = self._kp * error + damping + self.integral

    def get_state(self) -> tuple[Array, Array, Array]:
        return self.target.copy(), self.speed.copy(), self.integral.copy()

    def set_state(self, state: tuple[Array, Array, Array]) -> None:
        self.target, self.speed, self.integral = (values.copy() for values in state)
