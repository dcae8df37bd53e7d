"""Edits of a scene's objects for the planning panel, as functions of scenes and files."""

from __future__ import annotations

import os
from pathlib import Path

from armcell.cell import load_objects, save_objects
from armcell.collision.touch_links import attached_by_contact
from armcell.core import SE3, InputError, make_shape, shapes
from armcell.scene import CollisionObject, PlanningScene, load_scene_file, save_scene_file

KINDS: dict[str, tuple[str, ...]] = {name: shapes[name].sizes for name in ("box", "sphere", "cylinder")}
"""Shapes that the user can add, with the names of their dimensions."""

NEW_COLOR = (0.93, 0.69, 0.13, 1.0)
SUFFIXES = (".scene", ".yaml", ".yml")


def free_name(scene: PlanningScene, kind: str) -> str:
    """Return an unused name, such as "box_2", for a new object that the user adds to the scene."""
    taken, number = set(scene.frame_names), 1
    while f"{kind}_{number}" in taken:
        number += 1
    return f"{kind}_{number}"


def with_new(
    scene: PlanningScene, name: str, kind: str, size: tuple[float, ...], T_world_object: SE3
) -> PlanningScene:
    """Return a copy of the scene with a new box, sphere or cylinder that the user adds.

    Args:
        size: box (x, y, z), sphere (radius) or cylinder (radius, length) [m].
    Raises:
        InputError: the kind is unknown, a size is invalid, or the name is in use.
    """
    if kind not in KINDS:
        raise InputError(f"{kind!r} is no shape", hint=f"choose one of {', '.join(KINDS)}")
    if name in scene.frame_names:
        raise InputError(f"something is called {name!r} already", hint="give another name")
    if not name.strip():
        raise InputError("an object needs a name")
    shape = make_shape(kind, size[: len(KINDS[kind])])
    return scene.with_object(CollisionObject.single(name, shape, T_world_object, color=NEW_COLOR))


def with_attached(scene: PlanningScene, name: str, link: str | None) -> PlanningScene:
    """Return a copy of the edited scene with an object attached to a link. The object keeps its current pose.

    Links that are in contact with the object now are allowed to stay in contact.

    Raises:
        InputError: there is no link or no such object, or the object is a point cloud.
    """
    if link is None:
        raise InputError("the group has no tip to attach to", hint="choose a group that is a chain")
    return attached_by_contact(scene, name, link)


def bodies(scene: PlanningScene) -> list[str]:
    """Return the names of all bodies in the scene that the user edits: links with geometry, objects and
    attached objects.
    """
    solid = [name for name, link in scene.model.links.items() if link.collisions]
    return [*solid, *scene.objects, *scene.attached]


def other_bodies(scene: PlanningScene, body: str) -> list[str]:
    """Return the bodies that can collide with a given body.
    The user chooses among them when editing the allowed collisions.

    Planning does not check objects against each other.
    """
    standing = set(scene.objects)
    return [b for b in bodies(scene) if b != body and not {b, body} <= standing]


def save(scene: PlanningScene, file: str, folder: Path, ours: set[Path]) -> str:
    """Write the objects of the edited scene to a .scene or .yaml file and return a message for the user.

    Attached objects are written at their current pose.

    Args:
        file: plain file name without folders, because a web page must not write to arbitrary paths.
        ours: files that this session has written and may overwrite; the new file is added.
    Raises:
        InputError: wrong suffix, a folder in the name, or the file exists and is not in `ours`.
    """
    path = _checked(file, folder)
    if os.path.exists(path) and path not in ours:
        raise InputError("is there already and was not written here", file=path, hint="choose another name")
    objects = [scene.object(name) for name in (*scene.objects, *scene.attached)]
    left_out: list[str] = []
    if path.suffix == ".scene":
        left_out = save_scene_file(objects, path)
    else:
        save_objects(objects, path)
    ours.add(path)
    return f"{len(objects) - len(left_out)} objects written to {path}" + (
        f", without {', '.join(left_out)} (a .scene file knows no clouds)" if left_out else ""
    )


def with_loaded(scene: PlanningScene, file: str, folder: Path) -> PlanningScene:
    """Return a copy of the edited scene with the objects from a file.
    Objects in the scene that have the same names are replaced.

    Raises:
        InputError: the file is invalid; the error names the file, the line or element, and the reason.
    """
    path = _checked(file, folder)
    if not os.path.exists(path):
        raise InputError("no such file", file=path, hint=f"files are looked for in {folder}")
    for item in load_scene_file(path) if path.suffix == ".scene" else load_objects(path):
        scene = scene.with_object(item)
    return scene


def _checked(file: str, folder: Path) -> Path:
    if Path(file).name != file or file.startswith("."):
        raise InputError(f"{file!r} is not a plain file name", hint=f"files are kept in {folder}")
    if Path(file).suffix not in SUFFIXES:
        raise InputError(f"{file!r} has no known suffix", hint=f"use one of {', '.join(SUFFIXES)}")
    return folder / file
