"""Changes of a cell's values by path, e.g. `objects.cube.mass` or `physics.arm_kp`."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping
from dataclasses import asdict, fields, is_dataclass
from math import isfinite
from typing import Any

import yaml

from armcell.cell.cameras import noise_of
from armcell.cell.cell import Cell
from armcell.cell.schema import CellSpec, DisturbanceSpec, NoiseSpec
from armcell.cell.validation import validated
from armcell.core import InputError, UnknownNameError
from armcell.model.untrusted_files import yaml_value
from armcell.sim import PhysicsSettings
from armcell.sim.gain_files import gain_values
from armcell.tasks import TaskSettings

COMPONENTS = {"x": 0, "y": 1, "z": 2, "roll": 3, "pitch": 4, "yaw": 5}
"""Index of each named component in a pose given as a list."""
OPEN_BLOCKS = (
    "settings",
    "physics",
    "start",
    "randomize",
    "disturbances",
)  # blocks whose keys may be absent from the cell file
BLOCKS = {"settings": TaskSettings, "physics": PhysicsSettings}
NOISES = ("none", "stereo")  # named noise models of a camera


def with_values(cell: Cell, values: Mapping[str, Any]) -> Cell:
    """Return a cell with overridden values, each of which is given by its path. The result is validated like
    a cell file.

    Args:
        values: new values by path. A path joins the keys of the cell file with dots; x, y, z, roll, pitch,
            yaw or an index selects an entry of a list.
    Raises:
        UnknownNameError: the cell has no such path; the error lists similar paths.
        InputError: a value is not valid at its path.
    """
    if not values:
        return cell
    data = cell.spec.model_dump(exclude_unset=True)
    for path, value in values.items():
        _put(data, path, value)
        _no_longer_drawn(data, path, value)
    spec = validated(data, cell.file)
    same = spec.robot == cell.spec.robot  # keeps the model, and with it all cached data
    return Cell(cell.name, cell.file, spec, cell.model if same else None, cell.allow_env)


def gains_as_values(cell: Cell, gains: str | None) -> dict[str, Any]:
    """Return the overrides that set the joint gains in a cell's physics block, as values by path (for example
    `physics.joint_gains`). The gains come from a named gain set or a gain file.

    The values contain the gains themselves, so a record of the run does not depend on the file.

    Args:
        gains: name of a gain set, or a file, see `sim.gain_files`; None gives no values.
    """
    if gains is None:
        return {}
    values = {"gains": None, "joint_gains": {}, **gain_values(gains, cell.model)}
    return {f"physics.{key}": value for key, value in values.items()}


def parse_value(setting: str) -> tuple[str, Any]:
    """Split the text `PATH=VALUE` of an override into the path of a cell value and the new value, which is
    parsed as YAML.

    Raises:
        InputError: the text has no '=', or the value is not valid YAML.
    """
    path, equals, text = setting.partition("=")
    if not equals or not path.strip():
        raise InputError(f"{setting!r} is not PATH=VALUE", hint="e.g. objects.cube.mass=0.3")
    try:
        return path.strip(), yaml_value(text)
    except yaml.YAMLError as error:
        raise InputError(f"{path}: {text!r} is not a value: {str(error).splitlines()[0]}") from None


def split_path(path: str) -> tuple[str, ...]:
    """Split the path of an overridden cell value into normalized parts. For example, `pose.x` and `pose.0`
    give the same result.
    """
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
        at[_index(at, last, path)] = copy.deepcopy(value)  # a later path may change a part of the value
    elif isinstance(at, dict) and (above or last in CellSpec.model_fields):
        at[last] = copy.deepcopy(value)
    else:
        raise UnknownNameError("parameter", path, set(_known(data)))


def _write_out(data: dict[str, Any], path: str) -> None:
    """Replace the name of a noise preset, or a default value, in the cell data by a mapping of its
    components. An override at `path` can then change a single component.
    """
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
    """Return the nested mapping of cell data to which the keys of an override lead. Create missing mappings.

    If a value on the path is not a mapping, return a new empty mapping.
    """
    for key in keys:
        data = data.setdefault(key, {}) if isinstance(data, dict) else {}
    return data if isinstance(data, dict) else {}


def _no_longer_drawn(data: dict[str, Any], path: str, value: Any) -> None:
    """Exclude an overridden value of a cell from randomization, so that the value stays constant. A seed
    still draws the same values for all other entries.
    """
    block, name, key, *more = [*path.split("."), "", ""]
    drawn = data.get("randomize", {}).get(name, {})
    if isinstance(value, Mapping):  # the draw replaces the static friction
        value = value.get("static")
    if block == "objects" and "".join(more) in ("", "static") and drawn.get(key) is not None:
        drawn[key] = (value, value)


def _may_be_added(parts: list[str]) -> bool:
    return parts[0] in OPEN_BLOCKS and len(parts) <= 2


def _index(at: list[Any], part: str, path: str) -> int:
    index = COMPONENTS.get(part, int(part) if part.isdecimal() else -1)
    if part in COMPONENTS and index >= len(at) == 3:  # extend [x, y, z] by a rotation
        at += [0.0, 0.0, 0.0]
    if not 0 <= index < len(at):
        names = [name for name, i in COMPONENTS.items() if i < len(at)]
        raise UnknownNameError("entry", f"{part} of {path}", names)
    return index


def _known(data: dict[str, Any]) -> Iterator[str]:
    """Yield the path of each cell value that an override can change. The paths also include values with a
    default that the cell file does not contain.
    """
    yield from _paths(data)
    yield "physics.gains"
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
    """Yield the dotted path, such as `objects.cube.mass`, by which an override can address each value in
    nested cell data.
    """
    for key, value in data.items() if isinstance(data, dict) else ():
        yield f"{before}{key}"
        yield from _paths(value, f"{before}{key}.")
