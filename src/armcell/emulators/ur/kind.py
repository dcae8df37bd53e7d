"""The emulated robot kind `ur`."""

from __future__ import annotations

import selectors
from collections.abc import Callable, Mapping
from typing import Any
from zlib import crc32

from armcell.drivers.ur.settings import UrArmSettings
from armcell.emulators.kinds import emulated_kinds
from armcell.emulators.shared_world import SharedWorld
from armcell.emulators.ur.controller import ControllerSettings, UrController
from armcell.emulators.ur.notices import Popup, ScriptFault
from armcell.emulators.ur.plant import PhysicsPlant


class EmulatedUr:
    """Emulated robot kind `ur`: a UR controller with an arm in the cell's physics world."""

    physics: Mapping[str, Any] = {}

    def make(
        self, group: str, arm: UrArmSettings, shared: SharedWorld, io: selectors.BaseSelector,
        say: Callable[[str], None],
    ) -> UrController:  # fmt: skip
        serial = arm.serial or f"2026{crc32(group.encode()) % 10000:04d}"
        plant = PhysicsPlant(shared, group, arm.model)
        made = UrController(ControllerSettings(arm.model, arm.host, serial), io, plant)
        made.robot.listeners.append(lambda n: say(str(n)) if isinstance(n, Popup | ScriptFault) else None)
        return made


emulated_kinds.register("ur")(EmulatedUr())
