"""Import of Gazebo worlds as objects of a new cell file or an existing cell."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import yaml

from armcell.cell.built_in import CELL_FILE, LIBRARY
from armcell.cell.loader import load
from armcell.cell.objects_file import load_objects, object_entries, objects_text
from armcell.core import SE3, InputError
from armcell.model.untrusted_files import SafeLoader, read_text
from armcell.scene import CollisionObject
from armcell.scene.sdf import SdfWorld, load_sdf


def import_world(
    file: str | Path,
    folders: Sequence[Path] = (),
    skip: Collection[str] = (),
    prefix: str = "",
    T_cell_world: SE3 | None = None,
) -> SdfWorld:
    """Load a Gazebo world and convert the poses of its objects to the frame of the cell.

    Args:
        folders, skip: see `load_sdf`.
        prefix: prefix of every object's name.
        T_cell_world: pose of the world's origin in the cell frame, which is the frame of the robot's file.
    Raises:
        InputError: see `load_sdf`.
    """
    world = load_sdf(file, folders, skip)
    T = T_cell_world or SE3.identity()
    moved = (
        replace(item, name=f"{prefix}{item.name}", T_world_object=T @ item.T_world_object)
        for item in world.objects
    )
    return replace(world, objects=tuple(moved))


def write_imported(
    objects: Iterable[CollisionObject], file: Path, robot: str | None, force: bool = False
) -> None:
    """Write the objects of an imported Gazebo world to a file: a cell file if a robot is given, otherwise an
    objects file.

    The file is written only if it can be loaded. Meshes are written to the same folder. `load_objects` reads
    an objects file.

    Args:
        robot: the cell's robot; None to write an objects file.
        force: overwrite an existing file.
    Raises:
        InputError: the file exists (without `force`) or cannot be written, or the robot is invalid.
    """
    if os.path.exists(file) and not force:
        raise InputError("file exists", file=file, hint="add --force, or add the objects to it with --into")
    head = "" if robot is None else yaml.safe_dump({"robot": robot})
    _write_checked(file, lambda entries: head + objects_text(entries), objects, robot is not None)


def add_to_cell(objects: Sequence[CollisionObject], cell: str | Path) -> Path:
    """Add the objects of a Gazebo world to a cell file and return the file. Its other lines and comments stay
    unchanged.

    Raises:
        InputError: the cell is built in or does not exist, or it already contains an object's name.
    """
    path = Path(cell)
    file = path / CELL_FILE if os.path.isdir(path) else path
    if not os.path.isfile(file):
        built_in = os.path.isdir(LIBRARY / str(cell))
        hint = "write a cell of your own with --robot MODEL -o FILE.yaml" if built_in else "check the path"
        raise InputError("is a built-in cell" if built_in else "file not found", file=file, hint=hint)
    loaded = load(file)
    taken = sorted({o.name for o in objects} & {*loaded.spec.objects, *loaded.model.links})
    if taken:
        raise InputError(
            f"has {', '.join(repr(n) for n in taken[:5])} already", file=file, hint="add --prefix TEXT"
        )
    text = read_text(file)
    _write_checked(file, lambda entries: with_objects(text, entries), objects, True)
    return file


def with_objects(text: str, entries: dict) -> str:
    """Return the text of a cell file with the imported objects added at the end of its block `objects`."""
    block = objects_text(entries).partition("\n")[2]
    lines = text.splitlines(keepends=True)
    if lines and not lines[-1].endswith("\n"):
        lines[-1] += "\n"
    node = yaml.compose(text, SafeLoader)
    assert isinstance(node, yaml.MappingNode)
    found = next(((k, v) for k, v in node.value if k.value == "objects"), None)
    if found is None:
        return "".join(lines) + "\nobjects:\n" + block
    key, value = found
    if isinstance(value, yaml.MappingNode) and not value.flow_style and value.value:
        end = value.value[-1][1].end_mark.line  # the line after the block and its comments
        last = min(end + 1, len(lines)) if value.value[-1][1].end_mark.column else end
        while last > 0 and not lines[last - 1].split("#")[0].strip():
            last -= 1
        indent = " " * value.value[0][0].start_mark.column
        block = "".join(indent + line[2:] for line in block.splitlines(keepends=True))
        return "".join([*lines[:last], block, *lines[last:]])
    data = yaml.load(text, SafeLoader)["objects"] or {}  # {} or null, or a block in braces
    start, end = key.start_mark.index, value.end_mark.index
    return text[:start] + objects_text({**data, **entries}).rstrip("\n") + text[end:]


def _write_checked(file: Path, text_of, objects: Iterable[CollisionObject], is_cell: bool) -> None:
    """Write imported objects to a temporary file, check that it loads, and then rename it to the target file.

    Args:
        text_of: returns the text of the file for the entries of the objects.
        is_cell: whether the file is a cell, else an objects file.
    Raises:
        InputError: the file cannot be written or is invalid; new files are removed.
    """
    before = set(file.parent.iterdir()) if os.path.isdir(file.parent) else set()
    trial = file.with_name(f".{file.stem}.{os.getpid()}.yaml")
    try:
        trial.write_text(text_of(object_entries(objects, file)), encoding="utf-8")
        if is_cell:
            load(trial)
        else:
            load_objects(trial)
        os.replace(trial, file)
    except OSError as error:
        raise InputError(f"cannot be written ({error.strerror})", file=file) from None
    except InputError as error:
        for made in set(file.parent.iterdir()) - before:
            made.unlink(missing_ok=True)
        where = file if error.file == trial else error.file
        raise InputError(
            error.reason, file=where, line=error.line, element=error.element, hint=error.hint
        ) from None
