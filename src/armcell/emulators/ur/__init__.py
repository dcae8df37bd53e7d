"""Emulated Universal Robots controller for testing clients without a robot."""

from armcell.emulators.ur.controller import ControllerSettings, Rack, UrController
from armcell.emulators.ur.external_control import RemoteHost
from armcell.emulators.ur.plant import KinematicPlant, SharedWorld, WorldPlant

__all__ = [
    "ControllerSettings", "KinematicPlant", "Rack", "RemoteHost", "SharedWorld", "UrController", "WorldPlant",
]  # fmt: skip
