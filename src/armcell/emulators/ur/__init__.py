"""Emulated Universal Robots controller for testing clients without a robot."""

from armcell.emulators.ur.controller import ControllerSettings, EmulatedUr, UrController, UrRack
from armcell.emulators.ur.plant import KinematicPlant, PhysicsPlant
from armcell.emulators.ur.script_server import RemoteHost

__all__ = [
    "ControllerSettings",
    "EmulatedUr",
    "KinematicPlant",
    "PhysicsPlant",
    "RemoteHost",
    "UrController",
    "UrRack",
]  # fmt: skip
