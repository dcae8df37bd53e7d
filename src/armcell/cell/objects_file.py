"""Objects as YAML: the block `objects` of a cell file, or a separate file."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from armcell.cell.schema import CellSpec, FrictionSpec, ObjectSpec, ShapeSpec
from armcell.cell.validation import validated
from armcell.core import (
    SE3,
    InputError,
    Mesh,
    Octree,
    PointCloud,
    Shape,
    make_shape,
    shape_kind,
    shape_name,
    with_small_holes_filled,
)
from armcell.model.assets import load_mesh, resolve_uri
from armcell.model.untrusted_files import read_yaml
from armcell.scene import (
    CollisionObject,
    Material,
    ObjectType,
    ScrewThread,
    check_mesh,
    library_object,
    load_obstacle,
)


def object_of(name: str, spec: ObjectSpec, folder: Path) -> CollisionObject:
    """Return the scene object that an entry of a cell's objects file describes.

    Args:
        folder: folder for relative file names in the entry.
    """
    given: dict[str, Any] = {
        "subframes": {n: SE3.from_mapping(pose, f"subframes/{n}") for n, pose in spec.subframes.items()},
        "type": ObjectType(spec.type.key, spec.type.db),
        "movable": spec.movable,
        "belt": spec.belt,
        "thread": None if spec.thread is None else ScrewThread(**spec.thread.model_dump()),
    }
    if spec.color is not None:
        given["color"] = tuple(spec.color) if len(spec.color) == 4 else (*spec.color, 1.0)
    if spec.mass is not None:
        given["mass"] = spec.mass
    if spec.friction is not None:
        given["material"] = material_of(spec.friction)
    pose = SE3.from_mapping(spec.pose, "pose")
    if spec.model is not None:
        item = library_object(spec.model, name, pose, scale=spec.mesh_scale, sizes=spec.sizes, **given)
    else:
        shapes = (
            (_shape(s, folder, spec.movable), SE3.from_mapping(s.pose, "pose")) for s in spec.shape_specs()
        )
        item = CollisionObject(name, tuple(shapes), pose, **given)
    return item if spec.density is None else replace(item, mass=spec.density * item.volume)


def material_of(friction: float | FrictionSpec) -> Material:
    """Return the material that the entry `friction` in a cell's objects file describes.

    Raises:
        InputError: see `Material`.
    """
    if isinstance(friction, FrictionSpec):
        return Material(friction.static, dynamic_friction=friction.dynamic)
    return Material(friction)


def _shape(spec: ShapeSpec, folder: Path, movable: bool) -> Shape:
    if (solid := spec.sized()) is not None:
        return make_shape(*solid)
    if spec.mesh is not None:
        s = spec.mesh_scale
        mesh = load_mesh(resolve_uri(spec.mesh, folder), (s, s, s))
        mesh = with_small_holes_filled(mesh) if movable else mesh
        check_mesh(mesh, movable)
        return mesh
    assert spec.cloud is not None  # a validated entry has exactly one shape
    return load_obstacle(resolve_uri(spec.cloud, folder), spec.radius)


def load_objects(path: str | Path) -> tuple[CollisionObject, ...]:
    """Load objects from a YAML file that contains only an `objects` block in the format of a cell file.

    Raises:
        InputError: the file is invalid; the error has the file, the element and the reason.
    """
    file = Path(path)
    data = read_yaml(file)
    if set(data) != {"objects"}:
        raise InputError(f"has the keys {', '.join(map(str, data)) or 'none'}, only 'objects'", file=file)
    spec: CellSpec = validated({"robot": "none", **data}, file)
    found: dict[str, CollisionObject] = {}
    for name, entry in spec.objects.items():
        try:
            item = object_of(name, entry, file.parent)
            found[name] = item if item.thread is None else screwed(item, found)
        except InputError as error:
            if error.file is not None:
                raise
            raise InputError(error.reason, file=file, element=f"objects/{name}", hint=error.hint) from None
    return tuple(found.values())


def screwed(item: CollisionObject, others: Mapping[str, CollisionObject]) -> CollisionObject:
    """Return an object with a screw thread from an objects file. Its pose is converted to the world frame.

    The given pose is in the frame of the object into which it is screwed, as in a cell file.

    Args:
        others: objects by name, with poses in the world frame.
    Raises:
        InputError: `others` lacks the object into which it is screwed, or the object is not movable.
    """
    assert item.thread is not None
    into = item.thread.into
    if into not in others or not item.movable:
        raise InputError(
            f"is screwed into {into!r}: that has to stand before it in the file, and it has to be movable",
            hint=f"before it: {', '.join(others) or 'nothing'}",
        )
    return item.at(others[into].T_world_object @ item.T_world_object)


def save_objects(objects: Iterable[CollisionObject], path: str | Path) -> None:
    """Write objects to a YAML file that `load_objects` can read.
    Its content can also be the `objects` block of a cell file.

    Meshes and clouds are written to files in the same folder, named after the file, the object and the
    shape's index. Of a material, only the static and dynamic friction are written, as cell files have no
    other.

    Raises:
        InputError: an object is screwed into an object that is not in `objects`.
    """
    file = Path(path)
    file.write_text(objects_text(object_entries(objects, file)), encoding="utf-8")


def objects_text(entries: Mapping[str, Any]) -> str:
    """Return the YAML text of an objects file, with the given entries in an `objects` block, as in a cell
    file.
    """
    return yaml.safe_dump({"objects": dict(entries)}, sort_keys=False, default_flow_style=None, width=110)


def object_entries(objects: Iterable[CollisionObject], file: Path) -> dict[str, Any]:
    """Convert scene objects to entries of an objects file. Each mesh and each cloud is written only once.

    Meshes and clouds are written to the folder of `file`.

    Raises:
        InputError: an object is screwed into an object that is not in `objects`.
    """
    entries, stems, written = {}, set(), {}
    every = sorted(objects, key=lambda item: item.thread is not None)  # threaded objects last
    named = {item.name: item for item in every}
    for item in every:
        stem = re.sub(r"\W+", "_", f"{file.stem}_{item.name}")
        while stem in stems:  # names may be equal without special characters
            stem += "_"
        stems.add(stem)
        entries[item.name] = _entry(item, named, file.parent / stem, written)
    return entries


def _pose(T: SE3) -> Any:
    if np.array_equal(T.rotation.matrix, np.eye(3)):
        return T.translation.tolist()
    return {"xyz": T.translation.tolist(), "quat_xyzw": T.quat_xyzw.tolist()}


def _entry(
    item: CollisionObject, every: Mapping[str, CollisionObject], beside: Path, written: dict[int, Any]
) -> dict[str, Any]:
    """Convert a scene object to an entry of an objects file.

    Args:
        every: all objects to write, by name.
        beside: common start of the file paths for meshes and clouds.
        written: entries of already written shapes, by `id` of the shape: shared meshes are written once.
    """
    shapes = []
    for i, (shape, T) in enumerate(item.shapes):
        if id(shape) not in written:
            written[id(shape)] = _shape_entry(shape, beside.with_name(f"{beside.name}_{i}"))
        shapes.append({**written[id(shape)], "pose": _pose(T)})
    T, thread = item.T_world_object, item.thread
    if thread is not None:
        if thread.into not in every:
            raise InputError(
                f"{item.name!r} is screwed into {thread.into!r}, which is not among the objects",
                hint="write both",
            )
        T = every[thread.into].T_world_object.inverse() @ T
    entry: dict[str, Any] = {"shapes": shapes, "pose": _pose(T)}
    if len(shapes) == 1 and shapes[0]["pose"] == [0.0, 0.0, 0.0]:
        entry = {**shapes[0], "pose": entry["pose"]}
    entry["color"] = [float(c) for c in item.color]
    if item.movable:
        entry["movable"] = True
    if item.belt is not None:
        entry["belt"] = [float(v) for v in item.belt]
    if item.mass is not None:
        entry["mass"] = float(item.mass)
    if item.material != Material():
        entry["friction"] = _friction_entry(item.material)
    if item.subframes:
        entry["subframes"] = {name: _pose(T) for name, T in item.subframes.items()}
    if thread is not None:
        entry["thread"] = asdict(thread)
    if item.type != ObjectType():
        entry["type"] = {"key": item.type.key, "db": item.type.db}
    return entry


def _friction_entry(material: Material) -> float | dict[str, float]:
    if material.dynamic_friction is None:
        return float(material.friction)
    return {"static": float(material.friction), "dynamic": float(material.dynamic_friction)}


def _shape_entry(shape: Shape, beside: Path) -> dict[str, Any]:
    """Convert a shape to an entry of an objects file. A mesh or point cloud is written to a separate file.

    Args:
        beside: path of that file without the suffix.
    """
    kind = shape_kind(shape)
    if kind is not None:
        sizes = kind.values(shape)
        return {shape_name(shape): sizes if len(sizes) > 1 else sizes[0] if sizes else True}
    match shape:
        case Mesh():
            lines = ["v " + " ".join(map(repr, v)) for v in shape.vertices.tolist()]
            lines += ["f " + " ".join(str(k + 1) for k in f) for f in shape.faces.tolist()]
            target = beside.with_name(beside.name + ".obj")
            target.write_text("\n".join(lines) + "\n", encoding="ascii")
            return {"mesh": target.name}
        case PointCloud():
            target = beside.with_name(beside.name + ".npy")
            np.save(target, shape.points)
            return {"cloud": target.name, "radius": float(shape.radius)}
        case Octree():
            target = beside.with_name(beside.name + ".npz")
            np.savez(target, centers=shape.centers, sizes=shape.sizes)
            return {"cloud": target.name}
    raise AssertionError(f"{shape_name(shape)} has no row in the table of shapes")
