"""Compiled physics stepping for worlds that need no Python code at every step."""

from __future__ import annotations

import ctypes
from functools import cache

import mujoco
import numpy as np
from numpy.typing import NDArray

from armcell.sim.array_pointers import addresses_of
from armcell.sim.contacts import ContactMonitor
from armcell.sim.friction import HeldObjectCorrection
from armcell.sim.gripper_servos import Fingers
from armcell.sim.mujoco_model import BuiltModel
from armcell.sim.pair_culling import PairCulling
from armcell.sim.servo import ArmServo, Controls
from armcell.sim.step_kernel import FIXED, LIBRARY, take_steps
from armcell.sim.suction import Suction

Array = NDArray[np.float64]

# Without this, MuJoCo reads the clock 32 times per step for its timers: `set_mjcb_time(None)` installs
# MuJoCo's default clock, so only this pointer can disable the timers.
ctypes.c_void_p.in_dll(ctypes.CDLL(str(LIBRARY)), "mjcb_time").value = None
_NONE, _NO_ROWS, _NO_COLUMNS = np.zeros(0), np.zeros((0, 0)), np.zeros(0, dtype=np.int64)


class CompiledStepper:
    """Stepper that advances the physics of one `MjData` in compiled code, including gripper control and
    contact checks.
    """

    def __init__(
        self,
        built: BuiltModel,
        data: mujoco.MjData,
        fingers: Fingers,
        holding: HeldObjectCorrection,
        suction: Suction,
        servo: ArmServo,
        count: NDArray[np.int32],
    ):
        self._data, self._apart = data, PairCulling(built)
        self._engine = built.mj._address, data._address
        self.forget = self._apart.forget
        self._arrays = (
            count, data.qpos, data.ctrl, data.geom_xpos, fingers.law, fingers.joints, fingers.weights,
            *self._apart.arrays, *holding.arrays, *suction.arrays, data.qvel, servo.law, servo.at,
        )  # fmt: skip
        self._fixed = addresses_of(self._arrays, FIXED)

    @property
    def possible(self) -> bool:
        """Return whether MuJoCo has enough memory left for the compiled stepper (`CompiledStepper`).

        In compiled code a MuJoCo error ends the process, so compiled steps are unavailable once the peak use
        of the arena has reached half its size.
        """
        return self._data.maxuse_arena * 2 < self._data.narena

    def take(self, n: int, monitor: ContactMonitor) -> None:
        """Take n physics steps with the compiled stepper and record unwanted contacts in a contact
        monitor.
        """
        self._run(n, monitor, n, _NO_ROWS, _NO_COLUMNS, _NO_COLUMNS, np.inf, _NONE)

    def follow(
        self, targets: Array, steps: int, tolerance: float, controls: Controls,
        columns: NDArray[np.int64], monitor: ContactMonitor,
    ) -> tuple[int, Array]:  # fmt: skip
        """Track joint targets with the compiled stepper until the targets
        end or a joint deviates by more than the tolerance.

        Args:
            targets: (k, 2j) positions, then velocities, of j joints; one row for every `steps` physics steps.
            tolerance: largest tracking error [rad or m].
            controls: control indices of the joints.
            columns: (j,) indices of the joints in qpos.
        Returns:
            The number of targets used, and the largest tracking error of each joint (j,) [rad or m].
        """
        _, at, speeds = controls
        where = np.concatenate((at, speeds)) if speeds.item(0) >= 0 else at
        worst = np.zeros(len(columns))
        n = steps * len(targets)
        taken = self._run(n, monitor, steps, targets, where, columns, tolerance, worst)
        return (taken - 1) // steps + 1, worst

    def _run(
        self, n: int, monitor: ContactMonitor, period: int, targets: Array, where: NDArray[np.int64],
        columns: NDArray[np.int64], limit: float, worst: Array,
    ) -> int:  # fmt: skip
        """Take up to n steps with the compiled stepper. Stop if a joint deviates too far.
        Return the number of steps taken.
        """
        taken, off = 0, False
        model, data = self._engine
        while taken < n and not off:
            taken, touches, off = take_steps(  # pyright: ignore[reportGeneralTypeIssues]
                model, data, taken, n, self._fixed, monitor.pairs, monitor.readable, monitor.unwanted_geoms,
                period, targets, where, columns, limit, worst,
            )  # fmt: skip
            if touches:
                monitor.update(self._data)
        return taken


def compiled_steps(
    built: BuiltModel, data: mujoco.MjData, fingers: Fingers, holding: HeldObjectCorrection,
    suction: Suction, servo: ArmServo,
) -> CompiledStepper | None:  # fmt: skip
    """Return a stepper that advances the physics in compiled code, or None if MuJoCo's memory layout is
    unknown.

    The stepper reads MuJoCo's number of contacts at a fixed offset in mjData; `_count_is_found` checks this
    offset.
    """
    if not _count_is_found():
        return None
    return CompiledStepper(built, data, fingers, holding, suction, servo, _count(data))


def _count(data: mujoco.MjData) -> NDArray[np.int32]:
    """Return MuJoCo's current number of contacts as an array (1,) that shares memory with mjData. The
    compiled stepper passes this array to its kernel.

    MuJoCo stores this number in mjData, directly after the timers.
    """
    timers = data.timer.duration
    address = timers.__array_interface__["data"][0] + timers.shape[0] * timers.strides[0]
    return np.ctypeslib.as_array((ctypes.c_int32 * 1).from_address(address))


@cache
def _count_is_found() -> bool:
    """Test on a small model whether `_count` finds the number of contacts in mjData's memory with the
    installed MuJoCo. The compiled stepper requires this.

    The test places three boxes on a floor, in the air, and on the floor again.
    """
    box = '<body><freejoint/><geom type="box" size=".1 .1 .1"/></body>'
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><worldbody><geom type="plane" size="9 9 1"/>{box * 3}</worldbody></mujoco>'
    )
    data = mujoco.MjData(model)
    count, seen = _count(data), []
    for height in (0.099, 9.0, 0.099):
        data.qpos[0::7], data.qpos[2::7] = range(3), height
        mujoco.mj_forward(model, data)
        seen.append((count.item(), data.ncon))
    return seen == [(12, 12), (0, 0), (12, 12)]
