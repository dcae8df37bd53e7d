"""Conversion of collision objects from and to moveit_msgs/CollisionObject."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from armcell.core import SE3, InputError, Plane, Shape
from armcell.ros.convert import pose_from_message, pose_message
from armcell.ros.moveit_convert.shapes import ShapeMessages, mesh_shape, plane_pose, primitive_shape
from armcell.ros.schema import Schema
from armcell.scene import WORLD, CollisionObject, ObjectType

ADD, REMOVE, APPEND, MOVE = 0, 1, 2, 3  # moveit_msgs/CollisionObject


def frame_of(header: Any) -> str:
    """Return the frame in the header of a collision object, without a leading slash.
    An empty name stands for the world frame.
    """
    return header.frame_id.lstrip("/") or WORLD


def shapes_from_message(message: Any) -> tuple[tuple[Shape, SE3], ...]:
    """Convert the shapes in a CollisionObject or BoundingVolume message to pairs (shape, T_object_shape).

    A shape without a pose is at the origin, as in MoveIt.

    Raises:
        InputError: a shape is invalid, or the message has more poses than shapes.
    """
    found: list[tuple[Shape, SE3]] = []

    def each(kind: str, items: Any, poses: Any) -> list[tuple[Any, SE3]]:
        if len(poses) > len(items):
            raise InputError(f"{len(poses)} {kind} poses for {len(items)} shapes")
        placed = [pose_from_message(p) for p in poses]
        placed += [SE3.identity() for _ in items[len(placed) :]]
        return list(zip(items, placed))

    for item, T in each("primitive", message.primitives, message.primitive_poses):
        found.append((primitive_shape(item), T))
    for item, T in each("mesh", message.meshes, message.mesh_poses):
        found.append((mesh_shape(item), T))
    if hasattr(message, "planes"):
        for item, T in each("plane", message.planes, message.plane_poses):
            found.append((Plane(), T @ plane_pose(item)))
    return tuple(found)


def object_from_message(message: Any, like: CollisionObject | None = None) -> CollisionObject:
    """Convert a moveit_msgs/CollisionObject message to a collision object of the planning scene.

    If the object has one shape and no pose, the pose of the shape becomes the pose of the object, as in
    MoveIt.

    Args:
        message: the CollisionObject message.
        like: a known object with this name; its mass, friction and color are kept.
    Raises:
        InputError: the object has no name or no shape, or a shape is invalid.
    """
    shapes, T = shapes_from_message(message), pose_from_message(message.pose)
    if not shapes:
        raise InputError(f"object {message.id!r} has no shape")
    if len(shapes) == 1 and _is_unset(message.pose):
        T, shapes = shapes[0][1], ((shapes[0][0], SE3.identity()),)
    subframes = {
        name: pose_from_message(pose) for name, pose in zip(message.subframe_names, message.subframe_poses)
    }
    kind = ObjectType(message.type.key, message.type.db)
    if like is None:
        return CollisionObject(message.id, shapes, T, subframes=subframes, type=kind)
    return replace(like, shapes=shapes, T_world_object=T, subframes=subframes, type=kind)


def object_message(schema: Schema, header: Any, item: CollisionObject, operation: int = ADD) -> Any:
    """Convert a collision object of the planning scene to a moveit_msgs/CollisionObject message in the world
    frame.

    Point clouds and octrees are omitted; an object that consists only of these has no shapes in its message.

    Args:
        schema: the message types.
        header: header that names the world frame.
        item: the object.
        operation: ADD, REMOVE, APPEND or MOVE.
    """
    lists = ShapeMessages(schema)
    for shape, T in item.shapes:
        lists.add(shape, T)
    poses = lambda pairs: [pose_message(schema, T) for _, T in pairs]  # noqa: E731
    return schema.new(
        "moveit_msgs/CollisionObject",
        header=header,
        pose=pose_message(schema, item.T_world_object),
        id=item.name,
        type=schema.new("object_recognition_msgs/ObjectType", key=item.type.key, db=item.type.db),
        primitives=[m for m, _ in lists.primitives],
        primitive_poses=poses(lists.primitives),
        meshes=[m for m, _ in lists.meshes],
        mesh_poses=poses(lists.meshes),
        planes=[m for m, _ in lists.planes],
        plane_poses=poses(lists.planes),
        subframe_names=list(item.subframes),
        subframe_poses=[pose_message(schema, T) for T in item.subframes.values()],
        operation=operation,
    )


def _is_unset(pose: Any) -> bool:
    p, r = pose.position, pose.orientation
    return not (p.x or p.y or p.z or r.x or r.y or r.z) and r.w in (0.0, 1.0)
