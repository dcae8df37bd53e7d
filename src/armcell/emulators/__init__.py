"""Emulated robot controllers, which speak the vendors' own protocols."""

from armcell.emulators.ur import ControllerSettings, Rack

__all__ = ["ControllerSettings", "Rack"]
