"""An emulated Universal Robots controller, for trying out clients without the robot."""

from armcell.control.ur_controller.controller import ControllerSettings, Rack, UrController
from armcell.control.ur_controller.plant import KinematicPlant, SharedWorld, WorldPlant

__all__ = ["ControllerSettings", "KinematicPlant", "Rack", "SharedWorld", "UrController", "WorldPlant"]
