"""Emulated Franka controller (FR3, Panda) with physics, to test clients without a robot."""

from armcell.emulators.franka.controller import (
    ControllerSettings,
    FrankaController,
    Rack,
    free_arm,
    torque_world,
)
from armcell.emulators.franka.kind import EmulatedFranka
from armcell.emulators.franka.plant import FrankaPlant

__all__ = [
    "ControllerSettings",
    "EmulatedFranka",
    "FrankaController",
    "FrankaPlant",
    "Rack",
    "free_arm",
    "torque_world",
]
