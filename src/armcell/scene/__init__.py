"""The planning scene: robot state, collision objects and allowed collisions, all immutable."""

from armcell.scene.depth import depth_points
from armcell.scene.diff import (
    OCTOMAP,
    AddObject,
    AllowCollision,
    AllowCollisionByDefault,
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
from armcell.scene.extent import extent
from armcell.scene.inertia import solid_inertia
from armcell.scene.mesh_object import MeshFacts, check_mesh, mesh_facts, mesh_object
from armcell.scene.moving_object import MovingObject
from armcell.scene.object_library import ObjectKind, library, library_object, object_names
from armcell.scene.objects import (
    DEFAULT_DENSITY,
    CollisionObject,
    Material,
    ObjectType,
    ScrewThread,
    shape_volume,
)
from armcell.scene.octomap import OccupancyMap, SensorModel
from armcell.scene.octree_file import load_octree, octree_from_bytes
from armcell.scene.octree_writer import octree_bytes, save_octree
from armcell.scene.point_cloud_file import load_obstacle, load_points
from armcell.scene.scene import WORLD, AttachedBody, PlanningScene
from armcell.scene.scene_changes import new_obstacles, scene_changes
from armcell.scene.scene_file import load_scene_file, save_scene_file

__all__ = [
    "DEFAULT_DENSITY",
    "OCTOMAP",
    "WORLD",
    "AddObject",
    "AllowCollision",
    "AllowCollisionByDefault",
    "AppendShapes",
    "AttachObject",
    "AttachedBody",
    "CollisionObject",
    "DetachObject",
    "Material",
    "MeshFacts",
    "MoveObject",
    "MovingObject",
    "ObjectKind",
    "ObjectType",
    "OccupancyMap",
    "PlanningScene",
    "RemoveAllObjects",
    "RemoveObject",
    "SceneDiff",
    "ScrewThread",
    "SensorModel",
    "SetColor",
    "SetFixedFrame",
    "SetOctomap",
    "SetPadding",
    "SetState",
    "SetType",
    "check_mesh",
    "depth_points",
    "extent",
    "library",
    "library_object",
    "load_obstacle",
    "load_octree",
    "load_points",
    "load_scene_file",
    "mesh_facts",
    "mesh_object",
    "new_obstacles",
    "object_names",
    "octree_bytes",
    "octree_from_bytes",
    "save_octree",
    "save_scene_file",
    "scene_changes",
    "shape_volume",
    "solid_inertia",
    "with_octomap",
]
