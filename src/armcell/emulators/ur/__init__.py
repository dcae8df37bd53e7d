"""Emulated Universal Robots controller for testing clients without a robot."""

from armcell.emulators.ur.controller import ControllerSettings, EmulatedUr, UrController, UrRack
from armcell.emulators.ur.external_control import RemoteHost
from armcell.emulators.ur.plant import KinematicPlant, PhysicsPlant

__all__ = [
    "ControllerSettings",
    "EmulatedUr",
    "KinematicPlant",
    "PhysicsPlant",
    "RemoteHost",
    "UrController",
    "UrRack",
]  # fmt: skip
