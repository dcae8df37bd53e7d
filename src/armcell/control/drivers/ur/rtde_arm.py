"""An arm that `ur_rtde` moves. Its state, and whoever stops it, are those of every other arm."""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import ArrayLike

from armcell.control.drivers.ur.arm import INPUTS, UrArm
from armcell.control.drivers.ur.program import ProgramSettings
from armcell.control.drivers.ur.rtde_link import RtdeLink
from armcell.control.safety import Fault
from armcell.control.ur_wire.modes import RuntimeState

SLIDER, TOOL, STANDARD = 0, 1, 2  # recipes of inputs


class UrRtdeArm(UrArm):
    """State over our own RTDE client; motion by servoJ of `ur_rtde` in a process of its own."""

    inputs = (
        *INPUTS,
        ("tool_digital_output_mask", "tool_digital_output"),
        ("standard_digital_output_mask", "standard_digital_output"),
    )

    def _made_link(self, settings: ProgramSettings) -> RtdeLink:
        # What the state says of slider and pause goes along with every beat.
        return RtdeLink(self.name, self.settings.host, 1.0 / self.step, settings, self._scaling_now)

    def _scaling_now(self) -> float:
        return self.scaling if self._rtde.latest is not None else 1.0

    def start_program(self) -> None:
        super().start_program()
        end = time.monotonic() + 1.0
        while self.state.runtime_state == RuntimeState.STOPPED and time.monotonic() < end:
            time.sleep(0.005)  # the state that says so is on its way

    def fault(self) -> Fault | None:
        """As of every arm; besides, the script on the robot must run."""
        found = super().fault()
        if found is None and self.armed and self.state.runtime_state == RuntimeState.STOPPED:
            return self._found("program ended", "ur_rtde's script on the robot ended", "resume")
        return found

    def clock(self, number: int) -> float:
        link = self._link
        assert isinstance(link, RtdeLink)
        return link.clock if link.playing == number else 0.0

    def servo(self, q: ArrayLike, v: ArrayLike, at: float) -> None:
        self._mark_streamed()
        self._link.servo(q, np.asarray(v, dtype=float), at)

    def set_tool_output(self, pin: int, on: bool) -> None:
        self._rtde.send(TOOL, (1 << pin, int(on) << pin))

    def set_digital_output(self, pin: int, on: bool) -> None:
        self._rtde.send(STANDARD, (1 << pin, int(on) << pin))
