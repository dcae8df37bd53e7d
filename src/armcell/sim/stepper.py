"""Physics steps of a simulated world, with the parts that act before and after each step."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np
from numpy.typing import NDArray

from armcell.core import ArmcellError
from armcell.sim.compiled_stepper import compiled_steps
from armcell.sim.contacts import ContactMonitor
from armcell.sim.friction import HeldObjectCorrection, SlidingFriction
from armcell.sim.gripper_servos import Fingers
from armcell.sim.mujoco_model import BuiltModel
from armcell.sim.servo import ArmServo, Controls
from armcell.sim.settings import PhysicsSettings
from armcell.sim.suction import Suction
from armcell.sim.welds import Welder

Array = NDArray[np.float64]

_DIVERGED = tuple(
    int(getattr(mujoco.mjtWarning, f"mjWARN_{name}")) for name in ("BADQPOS", "BADQVEL", "BADQACC")
)


class Stepper:
    """Stepper of a simulated world: it calls the servos, fingers, cups, belts and corrections of the world at
    each physics step, in compiled code where possible.

    Attributes:
        fingers, servo, suction: drive the grippers, the arms and the suction cups.
        slip, holding: correct the friction of sliding and of held objects.
        welder: welds objects to grippers, depending on the grip mode.
        monitor: records unwanted contacts at every step; `reset` replaces it.
        compiled: takes the steps in compiled code, or None if parts of this world need Python.
    """

    monitor: ContactMonitor
    welder: Welder

    def __init__(self, built: BuiltModel, settings: PhysicsSettings, data: mujoco.MjData):
        self._built, self._data = built, data
        self._settings = settings
        self._warned = data.warning.number.item  # reads the current warning counts when called
        self.fingers = Fingers(built, settings)
        self.servo = ArmServo(built, settings)
        self.slip = SlidingFriction(built)
        self.holding = HeldObjectCorrection(built, settings, data)
        holders, self._owner = self.holding.arrays[3:5]
        self.suction = Suction(built, settings.timestep, holders)
        self._welds = settings.grip_mode != "friction"
        python = built.belts or self.slip or self._welds
        parts = self.fingers, self.holding, self.suction, self.servo
        self.compiled = None if python else compiled_steps(built, data, *parts)

    def reset(self, built: BuiltModel) -> None:
        """Discard the stepper's records of the simulated world. The model `built` may differ from the
        previous model only in the initial state.
        """
        self._built = built
        self.slip.reset()
        self.monitor = ContactMonitor(built)
        self.welder = Welder(built, self._settings, self.fingers.drives)

    def forget(self, hands: bool = True) -> None:
        """Make the stepper test all body pairs of the simulated world again, because its state changes or
        because the next steps do not run in compiled code.

        Args:
            hands: also forget the last poses of hands that hold objects.
        """
        if hands:
            self.holding.forget()
        if self.compiled is not None:
            self.compiled.forget()

    def take(self, n: int) -> None:
        """Let the stepper take n physics steps of the simulated world, in compiled code if possible."""
        if self.compiled is not None and self.compiled.possible:
            self.compiled.take(n, self.monitor)
            return
        self.forget(hands=False)
        data, before = self._data, self._before()
        for _ in range(n):
            for call in before:
                call(data)
            mujoco.mj_step(self._built.mj, data)
            self.holding.update(min(data.ncon, self.monitor.readable), self.monitor.pairs)
            self.monitor.update(data)
            if self.slip:
                self.slip.update(data)
            if self._welds:
                self.welder.update(data)

    def follow(
        self, targets: Array, steps: int, tolerance: float, controls: Controls, columns: NDArray[np.int64]
    ) -> tuple[int, Array] | None:
        """Let the stepper pass joint targets to its compiled stepper, which tracks them. Return None if the
        world cannot be stepped in compiled code.
        """
        if self.compiled is None or not self.compiled.possible or self.servo.computed:
            return None
        return self.compiled.follow(targets, steps, tolerance, controls, columns, self.monitor)

    def check(self) -> None:
        """Raise an ArmcellError if the steps have made the simulated world diverge (its state is not
        finite).
        """
        position, velocity, acceleration = _DIVERGED
        if self._warned(position) or self._warned(velocity) or self._warned(acceleration):
            raise ArmcellError(f"physics diverged at {self._data.time:.3f} s (a state is not finite)")

    def _before(self) -> list[Callable[[mujoco.MjData], None]]:
        """Return the functions that the stepper calls before each physics step."""
        before = [self.fingers.update]
        if self.suction:
            before.append(self._draw_vacuum)
        if self.servo.computed:
            before.append(self.servo.update)
        if self._built.belts:
            before.append(self._run_belts)
        return before

    def _draw_vacuum(self, data: mujoco.MjData) -> None:
        """Let the stepper set the vacuum forces of all suction cups before it takes the next physics step."""
        count = min(data.ncon, self.monitor.readable)
        self.suction.update(count, self.monitor.pairs, self._owner, data.ctrl)

    def _run_belts(self, data: mujoco.MjData) -> None:
        """Let the stepper reset all conveyor belts: joint positions to zero, and joint speeds to the belt
        speeds.
        """
        for position, velocity, speed in self._built.belts:
            data.qpos[position], data.qvel[velocity] = 0.0, speed

    def get_state(self) -> tuple:
        """Return the state of all parts of the stepper, for snapshots of the simulated world."""
        drives = tuple(drive.get_state() for drive in self.fingers.drives.values())
        parts = self.servo, self.slip, self.welder, self.holding, self.suction, self.monitor
        return drives, tuple(part.get_state() for part in parts)

    def set_state(self, state: tuple) -> None:
        """Restore the state of all parts of the stepper from a snapshot of the simulated world."""
        drives, others = state
        for drive, value in zip(self.fingers.drives.values(), drives, strict=True):
            drive.set_state(value)
        parts = self.servo, self.slip, self.welder, self.holding, self.suction, self.monitor
        for part, value in zip(parts, others, strict=True):
            part.set_state(value)
