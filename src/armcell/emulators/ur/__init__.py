"""Emulated Universal Robots controller for testing clients without a robot."""

from armcell.emulators.ur.controller import ControllerSettings, Rack, UrController
from armcell.emulators.ur.external_control import RemoteHost
from armcell.emulators.ur.kind import EmulatedUr
from armcell.emulators.ur.plant import KinematicPlant, WorldPlant

__all__ = [
    "ControllerSettings", "EmulatedUr", "KinematicPlant", "Rack", "RemoteHost", "UrController", "WorldPlant",
]  # fmt: skip
