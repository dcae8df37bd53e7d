"""The planning scene: an immutable value of robot, state, objects and allowed contacts."""

from armcell.scene.diff import (
    OCTOMAP,
    AddObject,
    Allow,
    AllowByDefault,
    AppendShapes,
    AttachObject,
    DetachObject,
    MoveObject,
    RemoveAllObjects,
    RemoveObject,
    SceneDiff,
    SetColor,
    SetFixedFrame,
    SetOctomap,
    SetPadding,
    SetState,
    SetType,
    with_octomap,
)
from armcell.scene.geometry_file import load_scene_file, save_scene_file
from armcell.scene.inertia import solid_inertia
from armcell.scene.objects import DEFAULT_DENSITY, CollisionObject, Material, ObjectType, shape_volume
from armcell.scene.scene import WORLD, AttachedBody, PlanningScene

__all__ = [
    "DEFAULT_DENSITY",
    "OCTOMAP",
    "WORLD",
    "AddObject",
    "Allow",
    "AllowByDefault",
    "AppendShapes",
    "AttachObject",
    "AttachedBody",
    "CollisionObject",
    "DetachObject",
    "Material",
    "MoveObject",
    "ObjectType",
    "PlanningScene",
    "RemoveAllObjects",
    "RemoveObject",
    "SceneDiff",
    "SetColor",
    "SetFixedFrame",
    "SetOctomap",
    "SetPadding",
    "SetState",
    "SetType",
    "load_scene_file",
    "save_scene_file",
    "shape_volume",
    "solid_inertia",
    "with_octomap",
]
