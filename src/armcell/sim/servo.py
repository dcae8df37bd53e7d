"""Position control of the arm joints by MuJoCo's servos or torque PID, and joint targets of each tick."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable

import mujoco
import numpy as np
from numba import njit
from numpy.typing import NDArray

from armcell.core import InputError
from armcell.sim.mujoco_model import BuiltModel
from armcell.sim.settings import PhysicsSettings, effective_gains

F64 = NDArray[np.float64]

AHEAD = 2.0  # [s] length of a batch

TARGET, SPEED, INTEGRAL, TORQUE, KP, KI, KV, LOW, HIGH, FEEDFORWARD, WINDS_UP, DT = range(12)
"""Rows of `ArmServo.law`."""
Controls = tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]
"""Indices (n,) of joints in `ArmServo.target` and of their inputs in MuJoCo's ctrl.

The inputs are the position inputs, then the velocity inputs.
"""


@njit(cache=True)
def drive_joints(law, at, qpos, qvel, ctrl):
    """Write the torques of the arm servo for the next physics step to MuJoCo's controls.

    Args:
        law, at: `ArmServo.law` and `ArmServo.at`; the integral terms are changed in place.
        qpos, qvel, ctrl: MuJoCo's positions, velocities and controls.
    """
    for j in range(at.shape[1]):
        error = law[TARGET, j] - qpos[at[0, j]]
        total = law[INTEGRAL, j] + law[KI, j] * error * law[DT, j]
        clamped = min(max(total, law[LOW, j]), law[HIGH, j])
        law[INTEGRAL, j] = total if law[WINDS_UP, j] else clamped
        damping = law[KV, j] * (law[SPEED, j] - qvel[at[1, j]])
        effort = law[KP, j] * error + damping + clamped + law[FEEDFORWARD, j] * law[SPEED, j]
        ctrl[at[2, j]] = effort if np.isnan(law[TORQUE, j]) else law[TORQUE, j]


class JointTargets:
    """Joint targets that the arm servo tracks at every tick of a simulated motion, sampled ahead of time in
    batches.

    Attributes:
        steps: physics steps per tick.
    """

    def __init__(self, wanted: Callable[[F64], tuple[F64, F64]], timestep: float, steps: int):
        """Store the function that yields the joint targets of a motion.

        Args:
            wanted: function from times (k,) [s], at which ticks begin, to finite positions and velocities (k,
                n).
            timestep: physics time step [s].
            steps: physics steps per tick.
        """
        self._wanted, self._dt, self.steps = wanted, timestep, steps
        self._times: list[float] = []
        self._rows = np.zeros((0, 0))

    def between(self, now: float, until: float) -> F64:
        """Return the joint targets (k, 2n) of the arm servo for all ticks that start in the interval [`now`,
        `until`) [s].

        Each row holds the positions, then the velocities. The result has at least one row.
        """
        times = self._times
        first = bisect_left(times, now)
        if first == len(times) or times[first] != now or times[-1] < until:
            self._look_ahead(now, max(until, now + AHEAD))
            times, first = self._times, 0
        end = max(bisect_left(times, until, first), first + 1)
        return self._rows[first:end]

    def _look_ahead(self, now: float, end: float) -> None:
        count = int((end - now) / (self._dt * self.steps)) + 2
        steps = np.full(count * self.steps, self._dt)
        steps[0] = now
        times = np.cumsum(steps)[:: self.steps]  # adds step by step like MuJoCo, so the rounding is the same
        self._times = times.tolist()
        self._rows = np.concatenate(self._wanted(times), axis=1)


class ArmServo:
    """Servo for the arm joints: a controller that tracks their targets by writing MuJoCo's controls.

    With arm control "torque", the controls are torques [Nm or N], which `update` computes before every step.

    Attributes:
        law: (12, n) state and gains of the computed joints for `drive_joints`; n is 0 without such joints.
        at: (3, n) their indices in MuJoCo's qpos, qvel and ctrl.
    """

    def __init__(self, built: BuiltModel, settings: PhysicsSettings):
        arm = np.flatnonzero(built.pos_ctrl >= 0)  # columns in the model's joint order
        self._at = {int(c): i for i, c in enumerate(arm)}
        self.columns = tuple(self._at)
        self._pos, self._vel = built.pos_ctrl[arm], built.vel_ctrl[arm]
        self.computed = settings.arm_control == "torque"
        self._feeds_velocity = bool(len(arm)) and bool(self._vel[0] >= 0)
        model = built.scene.model
        joints = [model.joints[model.joint_names[c]] for c in arm]
        law = np.zeros((12, len(arm)))
        for column, joint in zip(law.T, joints, strict=True):
            gains = effective_gains(joint, settings)
            column[KP : HIGH + 1], column[WINDS_UP] = gains[:5], gains.winds_up
            column[FEEDFORWARD] = gains.feedforward
        law[TORQUE], law[DT] = np.nan, settings.timestep  # direct efforts; nan: the PID law controls
        self.target, self.speed, self.integral, self._torque = self._state = law[: TORQUE + 1]
        driven = slice(None) if self.computed else slice(0)
        self.law = law if self.computed else np.zeros((12, 0))
        self.at = np.ascontiguousarray(
            np.stack([built.qpos[arm], built.dofs[arm], self._pos]).astype(np.int64)[:, driven]
        )

    def controls(self, columns: list[int]) -> Controls:
        """Convert the indices of arm joints in model order (`columns`) to their indices in `ArmServo.target`
        and in MuJoCo's position and velocity controls.
        """
        at = np.array([self._at[c] for c in columns], dtype=int)
        return at, self._pos[at], self._vel[at]

    def command(self, data: mujoco.MjData, controls: Controls, q: F64, v: F64) -> None:
        """Set target positions and velocities of the arm servo for the joints at the indices `controls`.

        Args:
            q: (n,) positions [rad or m].
            v: (n,) velocities [rad/s or m/s].
        """
        at, position, velocity = controls
        self.target[at], self.speed[at] = q, v
        self._torque[at] = np.nan
        if not self.computed:
            data.ctrl[position] = q
            if self._feeds_velocity:
                data.ctrl[velocity] = v

    def apply(self, controls: Controls, torque: F64) -> None:
        """Apply efforts (n,) [Nm or N] to arm joints until the next target is set.
        Meanwhile the servo's PID control is off.

        Raises:
            InputError: the arm control is not "torque".
        """
        if not self.computed:
            raise InputError(
                "the physics' arm control does not accept torques", hint='set arm_control: "torque"'
            )
        self._torque[controls[0]] = torque

    def hold(self, data: mujoco.MjData, q: F64) -> None:
        """Make the arm servo hold all joints at positions q (dof,), and reset the integral terms of its PID
        control.
        """
        columns = list(self._at)
        self.integral[:] = 0.0
        self.command(data, self.controls(columns), q[columns], np.zeros(len(columns)))

    def update(self, data: mujoco.MjData) -> None:
        """Compute the torques of the arm servo for the next step and write them to MuJoCo's controls."""
        drive_joints(self.law, self.at, data.qpos, data.qvel, data.ctrl)

    def get_state(self) -> F64:
        return self._state.copy()

    def set_state(self, state: F64) -> None:
        self._state[:] = state
