"""JSON conversion of objects that are added to a scene during a run."""

from __future__ import annotations

from typing import Any

import numpy as np

from armcell.core import SE3, Mesh, Shape, make_shape, shape_kind, shape_name, shapes
from armcell.scene import CollisionObject


def pose_data(T: SE3) -> dict[str, Any]:
    return {"xyz": T.translation.tolist(), "quat_xyzw": T.quat_xyzw.tolist()}


def object_data(item: CollisionObject) -> dict[str, Any]:
    """Convert the shapes and properties of a scene object to JSON data for the record of a run.

    Point clouds and octrees are stored by name only, because they are large and may arrive ten times a
    second.
    """
    return {
        "shapes": [{**_shape_data(shape), "pose": pose_data(T)} for shape, T in item.shapes],
        "pose": pose_data(item.T_world_object),
        "color": [float(c) for c in item.color],
        "movable": item.movable,
    }


def object_of(name: str, data: dict[str, Any]) -> CollisionObject | None:
    """Create a scene object from JSON data in a record.
    Return None if the record contains no shapes for it.
    """
    shapes = [
        (shape, SE3.from_mapping(each["pose"], "pose"))
        for each in data["shapes"]
        if (shape := _shape_of(each)) is not None
    ]
    if not shapes:
        return None
    pose = SE3.from_mapping(data["pose"], "pose")
    return CollisionObject(name, tuple(shapes), pose, color=tuple(data["color"]), movable=data["movable"])


def _shape_data(shape: Shape) -> dict[str, Any]:
    kind = shape_kind(shape)
    if kind is None and isinstance(shape, Mesh):
        return {"mesh": {"vertices": shape.vertices.tolist(), "faces": shape.faces.tolist()}}
    return {shape_name(shape): [] if kind is None else kind.values(shape)}


def _shape_of(data: dict[str, Any]) -> Shape | None:
    if "mesh" in data:
        return Mesh(np.array(data["mesh"]["vertices"], float), np.array(data["mesh"]["faces"], int))
    return next((make_shape(name, sizes) for name, sizes in data.items() if name in shapes), None)
