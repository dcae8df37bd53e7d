"""Emulated robot controllers that speak the vendors' own network protocols."""

from armcell.emulators.franka import EmulatedFranka
from armcell.emulators.rack import EmulatedKind, cell_rack, emulated_kinds
from armcell.emulators.ur import ControllerSettings, EmulatedUr, UrRack

__all__ = [
    "ControllerSettings",
    "EmulatedFranka",
    "EmulatedKind",
    "EmulatedUr",
    "UrRack",
    "cell_rack",
    "emulated_kinds",
]
