"""Emulated Franka controller (FR3, Panda) with physics, to test clients without a robot."""

from armcell.emulators.franka.controller import (
    ControllerSettings,
    EmulatedFranka,
    FrankaController,
    FrankaRack,
    scene_without_cell,
    torque_world,
)
from armcell.emulators.franka.plant import FrankaPlant

__all__ = [
    "ControllerSettings",
    "EmulatedFranka",
    "FrankaController",
    "FrankaPlant",
    "FrankaRack",
    "scene_without_cell",
    "torque_world",
]
