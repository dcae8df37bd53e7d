"""Where to hold an object and where to put it."""

from armcell.grasping.candidates import Grasp, Rejection, generators, grasp_candidates, grip_force
from armcell.grasping.placing import RELEASE_GAP, Placement, place_candidates, support_surface

__all__ = [
    "RELEASE_GAP",
    "Grasp",
    "Placement",
    "Rejection",
    "generators",
    "grasp_candidates",
    "grip_force",
    "place_candidates",
    "support_surface",
]
