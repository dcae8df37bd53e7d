"""UR arm that the `ur_rtde` library moves; state and supervision are those of `UrArm`."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from armcell.core import InputError
from armcell.drivers.ur.arm import INPUTS, UrArm
from armcell.drivers.ur.program import ProgramSettings
from armcell.drivers.ur.ur_rtde_connection import UrRtdeConnection

SLIDER, TOOL, STANDARD = 0, 1, 2  # indices of the input recipes


class UrRtdeArm(UrArm):
    """UR arm whose state comes from armcell's RTDE client and whose motion is sent with servoJ of `ur_rtde`.

    `ur_rtde` runs in a subprocess.
    """

    inputs = (
        *INPUTS,
        ("tool_digital_output_mask", "tool_digital_output"),
        ("standard_digital_output_mask", "standard_digital_output"),
    )

    def _made_link(self, settings: ProgramSettings) -> UrRtdeConnection:
        # Every keep-alive signal carries the speed scaling of slider and pause.
        own = UrRtdeConnection(self.name, self.settings.host, 1.0 / self.step, settings, self._scaling_now)
        self._rtde_link = own
        return own

    def _scaling_now(self) -> float:
        return self.speed_scaling if self._rtde.latest is not None else 1.0

    def clock(self, number: int) -> float:
        link = self._rtde_link
        return link.clock if link.playing == number else 0.0

    def servo(self, q: ArrayLike, v: ArrayLike, at: float) -> None:
        self._mark_streamed()
        self._link.servo(q, np.asarray(v, dtype=float), at)

    def set_tool_output(self, pin: int, on: bool) -> None:
        self._set(TOOL, (1 << pin, int(on) << pin))

    def set_digital_output(self, pin: int, on: bool) -> None:
        self._set(STANDARD, (1 << pin, int(on) << pin))

    def _set(self, recipe: int, values: tuple[int, int]) -> None:
        try:
            self._rtde.send(recipe, values)
        except OSError as error:
            raise InputError(
                f"arm {self.name!r}: the link to {self.settings.host} is lost: no output is set ({error})",
                hint="check the cable and that the robot is on, then call resume()",
            ) from None
