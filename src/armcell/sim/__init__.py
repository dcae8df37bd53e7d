"""Physics of a planning scene with MuJoCo: steps, grippers, contacts, and cameras.

A `SimWorld` advances only when the caller steps it.
"""

# isort: off
from armcell._interrupts import silent_helpers

with silent_helpers():  # mujoco imports glfw, which starts a process that reads standard input
    import mujoco as _mujoco  # noqa: F401
# isort: on

from armcell.collision.convex_decomposition import convex_pieces
from armcell.sim.camera import Camera, DepthNoise, look_at
from armcell.sim.contacts import ContactMonitor, PhysicsContact, UnwantedContact
from armcell.sim.decals import Decal
from armcell.sim.grasp_trials import GraspTrial, TrialResult, TrialSettings, run_trials
from armcell.sim.gripper_servos import GripperState
from armcell.sim.mujoco_model import BuiltModel, GripperIndex, build
from armcell.sim.pace import Pacer
from armcell.sim.render import has_gl, render_depth, render_rgb, take_image
from armcell.sim.servo import JointTargets
from armcell.sim.settings import PhysicsSettings
from armcell.sim.welds import WeldEvent
from armcell.sim.world import SimWorld, WorldSnapshot

__all__ = [
    "BuiltModel",
    "Camera",
    "ContactMonitor",
    "Decal",
    "DepthNoise",
    "GraspTrial",
    "GripperIndex",
    "GripperState",
    "JointTargets",
    "Pacer",
    "PhysicsContact",
    "PhysicsSettings",
    "SimWorld",
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
