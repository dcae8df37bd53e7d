"""Planning of grasps and placements: candidates for picking up and putting down an object."""

import armcell.grasping.generators  # noqa: F401  registers them
from armcell.grasping.candidates import (
    Proposals,
    generator_for,
    generators,
    grasp_candidates,
    surface_coverage,
    turned_grasp,
)
from armcell.grasping.drags import DragSettings, HeapDrag, drags_off_walls
from armcell.grasping.grasp import (
    LIFT_ACCELERATION,
    Grasp,
    PadContact,
    Rejection,
    grip_force,
    nearest_miss,
    needed_force,
    openings,
    pair_friction,
    rejection_sort_key,
    why_none,
)
from armcell.grasping.hand import POSE_ERROR, Hand, hand_of, pre_opening
from armcell.grasping.placements import (
    FRICTION_MARGIN,
    RELEASE_GAP,
    Placement,
    lowest_point,
    place_candidates,
    placement_axis,
    rotated_placement,
    surface_for,
)
from armcell.grasping.pushes import HeapPush, PushSettings, pushes_off_walls
from armcell.grasping.quality import (
    Noise,
    Quality,
    approach_depth,
    contact_wrenches,
    grasp_quality,
    hull_quality,
    robustness,
)
from armcell.grasping.stability import resting_now, stable_poses
from armcell.grasping.support import support_surface, tilt_of
from armcell.grasping.surface import Surface, cloud_surface, surface_of
from armcell.grasping.top_down import HeapGrasp, TopDownGraspSettings, top_down_grasps
from armcell.scene.resting import StablePose

__all__ = [
    "FRICTION_MARGIN",
    "LIFT_ACCELERATION",
    "POSE_ERROR",
    "RELEASE_GAP",
    "DragSettings",
    "Grasp",
    "Hand",
    "HeapDrag",
    "HeapGrasp",
    "HeapPush",
    "Noise",
    "PadContact",
    "Placement",
    "Proposals",
    "PushSettings",
    "Quality",
    "Rejection",
    "StablePose",
    "Surface",
    "TopDownGraspSettings",
    "approach_depth",
    "cloud_surface",
    "contact_wrenches",
    "drags_off_walls",
    "generator_for",
    "generators",
    "grasp_candidates",
    "grasp_quality",
    "grip_force",
    "hand_of",
    "hull_quality",
    "lowest_point",
    "nearest_miss",
    "needed_force",
    "openings",
    "pair_friction",
    "place_candidates",
    "placement_axis",
    "pre_opening",
    "pushes_off_walls",
    "rejection_sort_key",
    "resting_now",
    "robustness",
    "rotated_placement",
    "stable_poses",
    "support_surface",
    "surface_coverage",
    "surface_for",
    "surface_of",
    "tilt_of",
    "top_down_grasps",
    "turned_grasp",
    "why_none",
]
