"""Steps in compiled code for worlds that need no Python at every step."""

from __future__ import annotations

import ctypes
from functools import cache

import mujoco
import numpy as np
from numpy.typing import NDArray

from armcell.sim.apart import Apart
from armcell.sim.built import BuiltModel
from armcell.sim.contacts import ContactMonitor
from armcell.sim.grip import Fingers
from armcell.sim.servo import Controls
from armcell.sim.stepping import LIBRARY, take_steps

Array = NDArray[np.float64]

# Else the engine reads the clock 32 times a step, for its timers. (Its `set_mjcb_time(None)` sets its own.)
ctypes.c_void_p.in_dll(ctypes.CDLL(str(LIBRARY)), "mjcb_time").value = None
_NONE, _NO_ROWS, _NO_COLUMNS = np.zeros(0), np.zeros((0, 0)), np.zeros(0, dtype=np.int64)


class CompiledSteps:
    """Steps of one `MjData`, with its grippers driven and its contacts looked at after every one."""

    def __init__(self, built: BuiltModel, data: mujoco.MjData, fingers: Fingers, count: NDArray[np.int32]):
        self._data, self._apart = data, Apart(built)
        self._engine = built.mj._address, data._address
        self.forget = self._apart.forget
        self._fingers, self._count = (fingers.law, fingers.joints, fingers.weights), count
        self._qpos, self._ctrl, self._places = data.qpos, data.ctrl, data.geom_xpos

    @property
    def possible(self) -> bool:
        """Not where the engine's memory gets scarce: without Python around it, an error ends the process."""
        return self._data.maxuse_arena * 2 < self._data.narena

    def take(self, n: int, monitor: ContactMonitor) -> None:
        """Take n steps."""
        self._run(n, monitor, n, _NO_ROWS, _NO_COLUMNS, _NO_COLUMNS, np.inf, _NONE)

    def follow(
        self, targets: Array, steps: int, tolerance: float, controls: Controls,
        columns: NDArray[np.int64], monitor: ContactMonitor,
    ) -> tuple[int, Array]:  # fmt: skip
        """New targets (k, 2j) every `steps` steps, until a joint is off by more than a tolerance.

        Args:
            targets: positions and velocities side by side.
            controls: of the joints; columns (j,) in qpos.
        Returns:
            How many of the targets were used; how far the joints were off at most (j,).
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
        """Returns how many steps were taken."""
        taken, off = 0, False
        model, data = self._engine
        while taken < n and not off:
            taken, touches, off = take_steps(
                model, data, taken, n, self._count, monitor.pairs, monitor.readable, monitor.unwanted_geoms,
                self._fingers, self._apart.arrays, self._qpos, self._ctrl, self._places,
                period, targets, where, columns, limit, worst,
            )  # fmt: skip
            if touches:
                monitor.update(self._data)
        return taken


def compiled_steps(built: BuiltModel, data: mujoco.MjData, fingers: Fingers) -> CompiledSteps | None:
    """None where MuJoCo's number of contacts is not found, as it might be with another version."""
    return CompiledSteps(built, data, fingers, _count(data)) if _count_is_found() else None


def _count(data: mujoco.MjData) -> NDArray[np.int32]:
    """MuJoCo's number of contacts (1,), to be read in place: what comes after the timers in mjData."""
    timers = data.timer.duration
    address = timers.__array_interface__["data"][0] + timers.shape[0] * timers.strides[0]
    return np.ctypeslib.as_array((ctypes.c_int32 * 1).from_address(address))


@cache
def _count_is_found() -> bool:
    """Tried with three boxes on a floor, in the air, and on the floor again."""
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
