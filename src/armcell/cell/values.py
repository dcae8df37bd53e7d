"""Values of a cell changed by their path: `objects.cube.mass`, `physics.arm_kp`, `objects.wall.pose.x`."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping
from dataclasses import asdict, fields, is_dataclass
from math import isfinite
from typing import Any

import yaml

from armcell.cell.cameras import noise_of
from armcell.cell.cell import Cell
from armcell.cell.schema import CellSpec, DisturbanceSpec, NoiseSpec, validated
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
BLOCKS = {"settings": TaskSettings, "physics": PhysicsSettings}
NOISES = ("none", "stereo")  # a camera's noise by name


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
    return Cell(cell.name, cell.file, spec, cell.model if same else None, cell.allow_env)


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


def place_of(path: str) -> tuple[str, ...]:
    """The path's parts, the same for two ways to write one place (`pose.x` and `pose.0`)."""
    return tuple(str(COMPONENTS.get(part, part)) for part in path.split("."))


def _put(data: dict[str, Any], path: str, value: Any) -> None:
    _write_out(data, path)
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
        at[_index(at, last, path)] = copy.deepcopy(value)  # the next path may be within it
    elif isinstance(at, dict) and (above or last in CellSpec.model_fields):
        at[last] = copy.deepcopy(value)
    else:
        raise UnknownNameError("parameter", path, set(_known(data)))


def _write_out(data: dict[str, Any], path: str) -> None:
    """What a path leads into, where the file has a name for it or leaves it to its default."""
    match path.split("."):
        case ["cameras", name, "noise", _]:
            camera = _table(data, "cameras").get(name)
            if isinstance(camera, dict) and (noise := camera.get("noise", "none")) in NOISES:
                camera["noise"] = {k: v for k, v in asdict(noise_of(noise)).items() if isfinite(v)}
        case [("settings" | "physics") as block, name, _, *_]:
            default = getattr(BLOCKS[block], name, None)
            if isinstance(default, tuple):
                _table(data, block).setdefault(name, list(default))
            elif is_dataclass(default) and not isinstance(default, type):
                _table(data, block).setdefault(name, asdict(default))
        case ["disturbances", "moved", name, "by", _]:
            _table(data, "disturbances", "moved", name).setdefault("by", [0.0, 0.0, 0.0])
        case ["disturbances", "moved", name, _]:
            _table(data, "disturbances", "moved", name)


def _table(data: Any, *keys: str) -> dict[str, Any]:
    """What stands under keys, made where there is nothing; an empty one where no table may be."""
    for key in keys:
        data = data.setdefault(key, {}) if isinstance(data, dict) else {}
    return data if isinstance(data, dict) else {}


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
    for block, settings in BLOCKS.items():
        for field in fields(settings):
            yield f"{block}.{field.name}"
            if is_dataclass(field.default) and not isinstance(field.default, type):
                yield from _paths(asdict(field.default), f"{block}.{field.name}.")
    yield from (f"disturbances.{name}" for name in DisturbanceSpec.model_fields)
    yield from (f"disturbances.moved.{name}.by" for name in data.get("objects", {}))
    for name in data.get("cameras", {}):
        yield from (f"cameras.{name}.noise.{field}" for field in NoiseSpec.model_fields)


def _paths(data: Any, before: str = "") -> Iterator[str]:
    """Every path that a tree of dicts has."""
    for key, value in data.items() if isinstance(data, dict) else ():
        yield f"{before}{key}"
        yield from _paths(value, f"{before}{key}.")
