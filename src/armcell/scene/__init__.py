"""The planning scene: an immutable value of robot, state, objects and allowed contacts."""

from armcell.scene.inertia import solid_inertia
from armcell.scene.objects import DEFAULT_DENSITY, CollisionObject, Material, shape_volume
from armcell.scene.scene import WORLD, AttachedBody, PlanningScene

__all__ = [
    "DEFAULT_DENSITY",
    "WORLD",
    "AttachedBody",
    "CollisionObject",
    "Material",
    "PlanningScene",
    "shape_volume",
    "solid_inertia",
]
