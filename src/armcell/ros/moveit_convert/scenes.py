"""Conversion of moveit_msgs/PlanningScene to a scene diff, and of a scene to a message."""

from __future__ import annotations

import logging
from collections.abc import Iterable
from enum import IntFlag
from itertools import combinations
from typing import Any

import numpy as np

from armcell.core import InputError, Octree
from armcell.core.gc_pauses import gc_paused
from armcell.ros.convert import pose_from_message, pose_message, transform_message
from armcell.ros.moveit_convert.objects import (
    ADD,
    APPEND,
    MOVE,
    REMOVE,
    frame_of,
    object_from_message,
    object_message,
    shapes_from_message,
)
from armcell.ros.moveit_convert.states import robot_state_message
from armcell.ros.schema import Schema
from armcell.scene import (
    OCTOMAP,
    WORLD,
    AddObject,
    AllowCollision,
    AllowCollisionByDefault,
    AppendShapes,
    AttachObject,
    CollisionObject,
    DetachObject,
    MoveObject,
    PlanningScene,
    RemoveAllObjects,
    RemoveObject,
    SceneDiff,
    SetColor,
    SetFixedFrame,
    SetOctomap,
    SetPadding,
    octree_bytes,
    octree_from_bytes,
)
from armcell.scene.scene import Change

logger = logging.getLogger(__name__)


class Components(IntFlag):
    """Bit flags in a moveit_msgs/PlanningSceneComponents message that select the requested parts of a
    planning scene.
    """

    SCENE_SETTINGS = 1
    ROBOT_STATE = 2
    ROBOT_STATE_ATTACHED_OBJECTS = 4
    WORLD_OBJECT_NAMES = 8
    WORLD_OBJECT_GEOMETRY = 16
    OCTOMAP = 32
    TRANSFORMS = 64
    ALLOWED_COLLISION_MATRIX = 128
    LINK_PADDING_AND_SCALING = 256
    OBJECT_COLORS = 512
    ALL = 1023


# --- a message as changes ---
def object_changes(message: Any, scene: PlanningScene, known: PlanningScene | None = None) -> list[Change]:
    """Return the planning scene changes that a moveit_msgs/CollisionObject message requests.

    Args:
        message: the CollisionObject message.
        scene: the current scene.
        known: scene with the known mass, friction and color of objects; default: `scene`.
    Raises:
        InputError: a shape or the operation is invalid.
    """
    name, frame, operation = message.id, frame_of(message.header), int(message.operation)
    if operation == ADD:
        changes: list[Change] = []
        if name in scene.attached:  # unlike MoveIt, one name cannot be both attached and in the world
            changes.append(DetachObject(name))
        return [*changes, AddObject(object_from_message(message, _known(known or scene, name)), frame)]
    if operation == APPEND:
        if name not in scene.objects:
            return [AddObject(object_from_message(message), frame)]
        into = scene.objects[name].T_world_object.inverse() @ scene.frame_pose(frame)
        T = into @ pose_from_message(message.pose)
        return [AppendShapes(name, tuple((s, T @ T_shape) for s, T_shape in shapes_from_message(message)))]
    if operation == MOVE:
        return [_moved(message, scene, frame)]
    if operation == REMOVE:
        if not name:
            return [RemoveAllObjects()]
        if name in scene.objects:
            return [RemoveObject(name)]
        logger.info("object %r is not in the world: nothing to remove", name)
        return []
    raise InputError(f"object {name!r}: operation {operation}", hint="0 add, 1 remove, 2 append, 3 move")


def _known(scene: PlanningScene, name: str) -> Any:
    if name in scene.objects:
        return scene.objects[name]
    return scene.attached[name].object if name in scene.attached else None


def _moved(message: Any, scene: PlanningScene, frame: str) -> Change:
    """Return the planning scene change that a moveit_msgs/CollisionObject message with the operation MOVE
    requests.

    Older clients send the new pose as the pose of the object's only shape.
    """
    poses = [*message.primitive_poses, *message.mesh_poses, *message.plane_poses]
    p, r = message.pose.position, message.pose.orientation
    given = any((p.x, p.y, p.z, r.x, r.y, r.z, r.w))
    T = pose_from_message(message.pose if given or not poses else poses[0])
    return MoveObject(message.id, T, frame)


def attached_changes(message: Any, scene: PlanningScene, known: PlanningScene | None = None) -> list[Change]:
    """Return the planning scene changes that a moveit_msgs/AttachedCollisionObject message requests.

    Args:
        message: the AttachedCollisionObject message.
        scene: the current scene.
        known: scene with the known mass, friction and color of objects; default: `scene`.
    Raises:
        InputError: a shape or the operation is invalid.
    """
    name, operation = message.object.id, int(message.object.operation)
    if operation in (ADD, APPEND):
        changes: list[Change] = [DetachObject(name)] if name in scene.attached else []
        if message.object.primitives or message.object.meshes:
            item = object_from_message(message.object, _known(known or scene, name))
            frame = message.object.header.frame_id.lstrip("/") or message.link_name
            changes.append(AddObject(item, frame))
        return [*changes, AttachObject(name, message.link_name, tuple(message.touch_links))]
    if operation == REMOVE:
        wanted = [
            n for n, body in scene.attached.items()
            if (not name or n == name) and (not message.link_name or body.link == message.link_name)
        ]  # fmt: skip
        if name and not wanted:
            logger.info("object %r is not attached: nothing to detach", name)
        return [DetachObject(n) for n in wanted]
    raise InputError(f"attached object {name!r}: operation {operation}", hint="0 add, 1 remove")


@gc_paused()
def diff_from_message(message: Any, scene: PlanningScene) -> SceneDiff:
    """Convert a moveit_msgs/PlanningScene message to a scene diff.

    The robot's joint positions and name are ignored, because the joints are measured. An allowed collision
    matrix changes only the pairs that it names. Without `is_diff`, the message replaces the world, unless its
    world is empty.

    Raises:
        InputError: the message contains an invalid value or an unknown frame.
    """
    changes: list[Change] = []
    now = scene

    def add(more: Iterable[Change]) -> None:
        nonlocal now
        more = list(more)
        now = SceneDiff(tuple(more)).applied_to(now)
        changes.extend(more)

    world = message.world
    if not message.is_diff and (world.collision_objects or len(world.octomap.octomap.data)):
        add([RemoveAllObjects()])
    add(_frames(message.fixed_frame_transforms, now))
    # Attach first, as MoveIt does: an object that a diff attaches and removes from the world stays attached.
    for attached in message.robot_state.attached_collision_objects:
        add(attached_changes(attached, now, scene))
    add(_world(world, now, scene))
    add(_allowed(message.allowed_collision_matrix, now))
    if message.link_padding or message.link_scale:
        add([
            SetPadding(
                None,
                {p.link_name: float(p.padding) for p in message.link_padding},
                {s.link_name: float(s.scale) for s in message.link_scale},
            )
        ])  # fmt: skip
    changes.extend(
        SetColor(c.id, (float(c.color.r), float(c.color.g), float(c.color.b), float(c.color.a)))
        for c in message.object_colors
        if c.id in now.objects or c.id in now.attached
    )
    return SceneDiff(tuple(changes))


def world_from_message(message: Any, scene: PlanningScene) -> SceneDiff:
    """Convert a moveit_msgs/PlanningSceneWorld message to a scene diff that replaces the world objects and
    the octomap.

    Raises:
        InputError: the message contains an invalid value or an unknown frame.
    """
    empty = SceneDiff.of(RemoveAllObjects(), *([SetOctomap(None)] if OCTOMAP in scene.objects else []))
    return empty + SceneDiff(tuple(_world(message, empty.applied_to(scene), scene)))


def _world(message: Any, now: PlanningScene, known: PlanningScene) -> list[Change]:
    """Convert a PlanningSceneWorld message to changes of the planning scene, in the order of the message.

    Each object is converted in the scene that results from the previous changes, as far as they concern it:
    adding and moving other objects do not.
    """
    changes: list[Change] = []
    pending: dict[str, list[Change]] = {}  # by object, not yet made in `now`
    for item in message.collision_objects:
        if int(item.operation) not in (ADD, MOVE) or item.id in pending:
            now = SceneDiff(tuple(c for more in pending.values() for c in more)).applied_to(now)
            pending = {}
        pending[item.id] = object_changes(item, now, known)
        changes += pending[item.id]
    return [*changes, *_octomap(message.octomap)]


def _frames(transforms: Any, scene: PlanningScene) -> list[Change]:
    known = {WORLD, *scene.model.links, *scene.objects, *scene.attached}
    return [
        SetFixedFrame(t.child_frame_id.lstrip("/"), pose_from_message(t.transform), frame_of(t.header))
        for t in transforms
        if t.child_frame_id.lstrip("/") not in known
    ]


def _octomap(message: Any) -> list[Change]:
    octomap = message.octomap
    if not len(octomap.data):
        return []
    data = np.asarray(octomap.data, dtype=np.int8).tobytes()
    octree = octree_from_bytes(data, float(octomap.resolution), bool(octomap.binary), octomap.id or "OcTree")
    return [SetOctomap(octree, pose_from_message(message.origin))]


def _allowed(matrix: Any, scene: PlanningScene) -> list[Change]:
    known = {*scene.model.links, *scene.objects, *scene.attached}
    names = list(matrix.entry_names)
    if len(matrix.entry_values) != len(names) or any(
        len(v.enabled) != len(names) for v in matrix.entry_values
    ):
        raise InputError(f"the allowed collision matrix is not {len(names)} by {len(names)}")
    found: list[Change] = []
    for i, j in combinations(range(len(names)), 2):
        allowed = bool(matrix.entry_values[i].enabled[j])
        if names[i] in known and names[j] in known and scene.is_allowed(names[i], names[j]) != allowed:
            found.append(AllowCollision(names[i], names[j], allowed))
    for name, value in zip(matrix.default_entry_names, matrix.default_entry_values):
        if name in known:
            found.append(AllowCollisionByDefault(name, bool(value)))
    return found


# --- a scene as a message ---
def scene_message(
    schema: Schema, header: Any, scene: PlanningScene, parts: Components = Components.ALL
) -> Any:
    """Convert the planning scene to a moveit_msgs/PlanningScene message with the requested components."""
    message = schema.new("moveit_msgs/PlanningScene", name="armcell", robot_model_name=scene.model.name)
    if parts & (Components.ROBOT_STATE | Components.ROBOT_STATE_ATTACHED_OBJECTS):
        attached = bool(parts & Components.ROBOT_STATE_ATTACHED_OBJECTS)
        message.robot_state = robot_state_message(schema, header, scene, attached)
    if parts & Components.TRANSFORMS:
        message.fixed_frame_transforms = [
            transform_message(
                schema, schema.new("std_msgs/Header", stamp=header.stamp, frame_id=WORLD), name, T
            )
            for name, T in scene.fixed_frames.items()
        ]
    if parts & Components.ALLOWED_COLLISION_MATRIX:
        message.allowed_collision_matrix = _matrix(schema, scene)
    if parts & Components.LINK_PADDING_AND_SCALING:
        Padding, Scale = schema.message("moveit_msgs/LinkPadding"), schema.message("moveit_msgs/LinkScale")
        links = [n for n, link in scene.model.links.items() if link.collisions]
        message.link_padding = [Padding(n, scene.link_padding.get(n, scene.padding)) for n in links]
        message.link_scale = [Scale(n, scene.link_scale.get(n, 1.0)) for n in links]
    if parts & Components.OBJECT_COLORS:
        items = [*scene.objects.values(), *(body.object for body in scene.attached.values())]
        message.object_colors = [
            schema.new(
                "moveit_msgs/ObjectColor", o.name, schema.new("std_msgs/ColorRGBA", *map(float, o.color))
            )
            for o in items
        ]
    world = [o for o in scene.objects.values() if o.name != OCTOMAP]
    if parts & Components.WORLD_OBJECT_GEOMETRY:
        message.world.collision_objects = [object_message(schema, header, item) for item in world]
    elif parts & Components.WORLD_OBJECT_NAMES:
        message.world.collision_objects = [
            schema.new("moveit_msgs/CollisionObject", header=header, id=item.name) for item in world
        ]
    if parts & Components.OCTOMAP and OCTOMAP in scene.objects:
        message.world.octomap = _octomap_message(schema, header, scene.objects[OCTOMAP])
    return message


def _octomap_message(schema: Schema, header: Any, item: CollisionObject) -> Any:
    """Convert the octree of a planning scene to the octomap in a moveit_msgs/PlanningScene message
    (octomap_msgs/OctomapWithPose, in the binary format of OctoMap).

    The size of the smallest cell becomes the resolution.
    """
    [(octree, T_object_shape)] = item.shapes
    assert isinstance(octree, Octree)
    data, resolution = octree_bytes(octree)
    octomap = schema.new(
        "octomap_msgs/Octomap", header, True, "OcTree", resolution, np.frombuffer(data, np.int8)
    )
    origin = pose_message(schema, item.T_world_object @ T_object_shape)
    return schema.new("octomap_msgs/OctomapWithPose", header, origin, octomap)


def _matrix(schema: Schema, scene: PlanningScene) -> Any:
    names = [n for n, link in scene.model.links.items() if link.collisions]
    names += [*scene.objects, *scene.attached]
    enabled = np.zeros((len(names), len(names)), dtype=bool)
    index = {name: k for k, name in enumerate(names)}
    touches = {frozenset((o, link)): True for o, held in scene.attached.items() for link in held.touch_links}
    for pair, allow in (
        dict.fromkeys(scene.model.disabled_collisions, True) | touches | dict(scene.allowed)
    ).items():
        ends = [index[name] for name in pair if name in index]
        if len(ends) == 2:
            enabled[ends, ends[::-1]] = allow
    Entry = schema.message("moveit_msgs/AllowedCollisionEntry")
    return schema.new(
        "moveit_msgs/AllowedCollisionMatrix",
        names,
        [Entry(enabled=row) for row in enabled],
        list(scene.allowed_defaults),
        np.array(list(scene.allowed_defaults.values()), dtype=bool),
    )
