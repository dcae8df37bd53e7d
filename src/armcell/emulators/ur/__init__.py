"""Emulated Universal Robots controller for testing clients without a robot."""

from armcell.emulators.ur.controller import ControllerSettings, UrController, UrRack
from armcell.emulators.ur.external_control import RemoteHost
from armcell.emulators.ur.plant import KinematicPlant, PhysicsPlant, SharedWorld

__all__ = [
    "ControllerSettings",
    "KinematicPlant",
    "PhysicsPlant",
    "RemoteHost",
    "SharedWorld",
    "UrController",
    "UrRack",
]  # fmt: skip
