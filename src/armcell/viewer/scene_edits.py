"""What the panel does to a scene's objects: plain functions of scenes, names and files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from armcell.cell import load_objects, save_objects
from armcell.collision.touch_links import attached_by_contact
from armcell.core import SE3, Box, Cylinder, InputError, Shape, Sphere
from armcell.scene import CollisionObject, PlanningScene, load_scene_file, save_scene_file

KINDS: dict[str, tuple[str, ...]] = {
    "box": ("x", "y", "z"),
    "sphere": ("radius",),
    "cylinder": ("radius", "length"),
}
"""Shapes that can be added, with the names of their sizes."""

_MAKE: dict[str, Callable[..., Shape]] = {"box": Box, "sphere": Sphere, "cylinder": Cylinder}
NEW_COLOR = (0.93, 0.69, 0.13, 1.0)
SUFFIXES = (".scene", ".yaml", ".yml")


def free_name(scene: PlanningScene, kind: str) -> str:
    """A name for a new object that nothing has."""
    taken, number = set(scene.frame_names), 1
    while f"{kind}_{number}" in taken:
        number += 1
    return f"{kind}_{number}"


def with_new(
    scene: PlanningScene, name: str, kind: str, size: tuple[float, ...], T_world_object: SE3
) -> PlanningScene:
    """A box (x, y, z), sphere (radius) or cylinder (radius, length) [m] added.

    Raises:
        InputError: an unknown kind, an impossible size, or a name that something has.
    """
    if kind not in KINDS:
        raise InputError(f"{kind!r} is no shape", cure=f"choose one of {', '.join(KINDS)}")
    if name in scene.frame_names:
        raise InputError(f"something is called {name!r} already", cure="give another name")
    if not name.strip():
        raise InputError("an object needs a name")
    shape = _MAKE[kind](*size[: len(KINDS[kind])])
    return scene.with_object(CollisionObject.single(name, shape, T_world_object, color=NEW_COLOR))


def with_attached(scene: PlanningScene, name: str, link: str | None) -> PlanningScene:
    """An object fixed to a link where it is; links that touch it now may go on touching it.

    Raises:
        InputError: no link, no such object, or a cloud.
    """
    if link is None:
        raise InputError("the group has no tip to attach to", cure="choose a group that is a chain")
    return attached_by_contact(scene, name, link)


def bodies(scene: PlanningScene) -> list[str]:
    """Everything that can touch: links with collision geometry, objects, attached objects."""
    solid = [name for name, link in scene.model.links.items() if link.collisions]
    return [*solid, *scene.objects, *scene.attached]


def other_bodies(scene: PlanningScene, body: str) -> list[str]:
    """What a body can touch: objects do not touch each other in planning, nor rigid parts of one link."""
    standing = set(scene.objects)
    return [b for b in bodies(scene) if b != body and not {b, body} <= standing]


def save(scene: PlanningScene, file: str, folder: Path, ours: set[Path]) -> str:
    """Write the objects, attached ones where they are, to a .scene or .yaml file; says what was done.

    Args:
        file: a name without folders: a web page must not write just anywhere.
        ours: files written before, which may be written again; the new one is added.
    Raises:
        InputError: another suffix, a folder in the name, a file of somebody else's.
    """
    path = _checked(file, folder)
    if path.exists() and path not in ours:
        raise InputError("is there already and was not written here", file=path, cure="choose another name")
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
    """The objects of a file added; one of the same name is replaced.

    Raises:
        InputError: with file, line or element, and reason.
    """
    path = _checked(file, folder)
    if not path.exists():
        raise InputError("no such file", file=path, cure=f"files are looked for in {folder}")
    for item in load_scene_file(path) if path.suffix == ".scene" else load_objects(path):
        scene = scene.with_object(item)
    return scene


def _checked(file: str, folder: Path) -> Path:
    if Path(file).name != file or file.startswith("."):
        raise InputError(f"{file!r} is not a plain file name", cure=f"files are kept in {folder}")
    if Path(file).suffix not in SUFFIXES:
        raise InputError(f"{file!r} has no known suffix", cure=f"use one of {', '.join(SUFFIXES)}")
    return folder / file
