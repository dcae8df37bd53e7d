"""Emulated robot controllers that speak the vendors' own network protocols."""

from armcell.emulators.ur import ControllerSettings, Rack

__all__ = ["ControllerSettings", "Rack"]
