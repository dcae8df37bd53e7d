"""Values of a cell changed by their path: `objects.cube.mass`, `physics.arm_kp`, `objects.wall.pose.x`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import fields
from typing import Any

import yaml

from armcell.cell.cell import Cell
from armcell.cell.schema import CellSpec, DisturbanceSpec, validated
from armcell.core import InputError, UnknownNameError
from armcell.model.files import yaml_value
from armcell.sim import PhysicsSettings
from armcell.tasks import TaskSettings

COMPONENTS = {"x": 0, "y": 1, "z": 2, "roll": 3, "pitch": 4, "yaw": 5}
"""Names for the numbers of a pose that is a list."""
OPEN_BLOCKS = (
    "settings",
    "physics",
    "start",
    "randomize",
    "disturbances",
)  # whose keys a cell file need not name


def with_values(cell: Cell, values: Mapping[str, Any]) -> Cell:
    """The cell with other values; what they may be is checked as in the file.

    Args:
        values: by path: the keys of the cell file joined by dots; x, y, z, roll, pitch, yaw or a number
            for an entry of a list.
    Raises:
        UnknownNameError: a path that the cell does not have; lists what is near.
        InputError: a value that may not stand there.
    """
    if not values:
        return cell
    data = cell.spec.model_dump(exclude_unset=True)
    for path, value in values.items():
        _put(data, path, value)
        _no_longer_drawn(data, path, value)
    spec = validated(data, cell.file)
    same = spec.robot == cell.spec.robot  # then what was worked out for the model is used again
    return Cell(cell.name, cell.file, spec, cell.model if same else None)


def parsed(setting: str) -> tuple[str, Any]:
    """`PATH=VALUE` as path and value, the latter as YAML reads it.

    Raises:
        InputError: no '=' in it, or a value that is no YAML.
    """
    path, equals, text = setting.partition("=")
    if not equals or not path.strip():
        raise InputError(f"{setting!r} is not PATH=VALUE", cure="e.g. objects.cube.mass=0.3")
    try:
        return path.strip(), yaml_value(text)
    except yaml.YAMLError as error:
        raise InputError(f"{path}: {text!r} is not a value: {str(error).splitlines()[0]}") from None


def _put(data: dict[str, Any], path: str, value: Any) -> None:
    *above, last = path.split(".")
    at: Any = data
    for depth, part in enumerate(above):
        if isinstance(at, list):
            at = at[_index(at, part, path)]
            continue
        if not isinstance(at, dict) or (part not in at and not _may_be_added(above[: depth + 1])):
            raise UnknownNameError("parameter", path, set(_known(data)))
        at.setdefault(part, {})
        if isinstance(at[part], tuple):
            at[part] = list(at[part])
        at = at[part]
    if isinstance(at, list):
        at[_index(at, last, path)] = value
    elif isinstance(at, dict) and (above or last in CellSpec.model_fields):
        at[last] = value
    else:
        raise UnknownNameError("parameter", path, set(_known(data)))


def _no_longer_drawn(data: dict[str, Any], path: str, value: Any) -> None:
    """A value that is given is not drawn; the other draws of a seed stay as they are."""
    block, name, key, *more = [*path.split("."), "", ""]
    drawn = data.get("randomize", {}).get(name, {})
    if block == "objects" and not any(more) and drawn.get(key) is not None:
        drawn[key] = (value, value)


def _may_be_added(parts: list[str]) -> bool:
    return parts[0] in OPEN_BLOCKS and len(parts) <= 2


def _index(at: list[Any], part: str, path: str) -> int:
    index = COMPONENTS.get(part, int(part) if part.isdecimal() else -1)
    if part in COMPONENTS and index >= len(at) == 3:  # [x, y, z] has no rotation yet
        at += [0.0, 0.0, 0.0]
    if not 0 <= index < len(at):
        names = [name for name, i in COMPONENTS.items() if i < len(at)]
        raise UnknownNameError("entry", f"{part} of {path}", names)
    return index


def _known(data: dict[str, Any]) -> Iterator[str]:
    """Paths that may be given: those of the file, and what has a default in blocks that it may not name."""
    yield from _paths(data)
    for block, names in (
        ("physics", [field.name for field in fields(PhysicsSettings)]),
        ("settings", [field.name for field in fields(TaskSettings)]),
        ("disturbances", list(DisturbanceSpec.model_fields)),
    ):
        yield from (f"{block}.{name}" for name in names)


def _paths(data: Any, before: str = "") -> Iterator[str]:
    """Every path that a tree of dicts has."""
    for key, value in data.items() if isinstance(data, dict) else ():
        yield f"{before}{key}"
        yield from _paths(value, f"{before}{key}.")
