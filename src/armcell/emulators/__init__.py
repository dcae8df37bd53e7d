"""Emulated robot controllers that speak the vendors' own network protocols."""

from armcell.emulators.ur import ControllerSettings, UrRack

__all__ = ["ControllerSettings", "UrRack"]
