"""Emulated Universal Robots controller, to test clients without a robot."""

from armcell.control.ur_controller.controller import ControllerSettings, Rack, UrController
from armcell.control.ur_controller.external_control import RemoteHost
from armcell.control.ur_controller.plant import KinematicPlant, SharedWorld, WorldPlant

__all__ = [
    "ControllerSettings", "KinematicPlant", "Rack", "RemoteHost", "SharedWorld", "UrController", "WorldPlant",
]  # fmt: skip
