"""The emulated robot kind `franka`."""

from __future__ import annotations

import selectors
from collections.abc import Callable, Mapping
from typing import Any

from armcell.drivers.franka.settings import FrankaArmSettings
from armcell.emulators.franka.controller import TORQUE_PHYSICS, ControllerSettings, FrankaController
from armcell.emulators.franka.plant import FrankaPlant
from armcell.emulators.kinds import emulated_kinds
from armcell.emulators.shared_world import SharedWorld


class EmulatedFranka:
    """Emulated robot kind `franka`: a Franka controller with an arm in the cell's physics world."""

    physics: Mapping[str, Any] = TORQUE_PHYSICS

    def make(
        self, group: str, arm: FrankaArmSettings, shared: SharedWorld, io: selectors.BaseSelector,
        say: Callable[[str], None],
    ) -> FrankaController:  # fmt: skip
        plant = FrankaPlant(shared, group)
        made = FrankaController(ControllerSettings(arm.model, arm.host), io, plant, group)
        made.robot.listeners.append(say)
        return made


emulated_kinds.register("franka")(EmulatedFranka())
