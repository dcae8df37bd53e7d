"""Physics of a planning scene with MuJoCo: steps, grippers, contacts, and cameras.

A `SimWorld` advances only when the caller steps it.
"""

# isort: off
from armcell._interrupts import silent_helpers

with silent_helpers():  # mujoco imports glfw, which starts a process that reads standard input
    import mujoco as _mujoco  # noqa: F401
# isort: on

from armcell.collision.convex import convex_pieces
from armcell.sim.build import build
from armcell.sim.built import BuiltModel, GripperIndex
from armcell.sim.camera import Camera, DepthNoise, look_at
from armcell.sim.contacts import ContactMonitor, PhysicsContact, UnwantedContact
from armcell.sim.decals import Decal
from armcell.sim.grip import GripperState, WeldEvent
from armcell.sim.hand_trials import Trial, TrialResult, TrialSettings, run_trials
from armcell.sim.pace import Pacer
from armcell.sim.render import has_gl, render_depth, render_rgb, take_image
from armcell.sim.settings import PhysicsSettings
from armcell.sim.targets import Targets
from armcell.sim.world import SimWorld, WorldSnapshot

__all__ = [
    "BuiltModel",
    "Camera",
    "ContactMonitor",
    "Decal",
    "DepthNoise",
    "GripperIndex",
    "GripperState",
    "Pacer",
    "PhysicsContact",
    "PhysicsSettings",
    "SimWorld",
    "Targets",
    "Trial",
    "TrialResult",
    "TrialSettings",
    "UnwantedContact",
    "WeldEvent",
    "WorldSnapshot",
    "build",
    "convex_pieces",
    "has_gl",
    "look_at",
    "render_depth",
    "render_rgb",
    "run_trials",
    "take_image",
]
