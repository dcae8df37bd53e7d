"""Identity of a cell: content hashes of its parts, and versions of the software it uses."""

from __future__ import annotations

import hashlib
import os
import platform
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from armcell.cell.schema import CellSpec
from armcell.model import RobotModel
from armcell.scene import PlanningScene
from armcell.sim import PhysicsSettings
from armcell.tasks import TaskSettings

REPORTED_PACKAGES = ("armcell", "mujoco", "coal", "ompl", "numpy", "numba")


def versions() -> dict[str, str]:
    """Return the versions of Python, armcell and the main libraries, such as MuJoCo. They are included in the
    content hashes of a cell.
    """
    return {"python": platform.python_version(), **{name: _installed(name) for name in REPORTED_PACKAGES}}


@cache
def _installed(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"


ADDRESSES = ("host", "port", "own_host")  # network addresses of a real arm; no effect on motions


class HashedCell(Protocol):
    """Parts of a cell that its content hashes cover."""

    @property
    def file(self) -> Path: ...
    @property
    def spec(self) -> CellSpec: ...
    @property
    def model(self) -> RobotModel: ...
    @property
    def settings(self) -> TaskSettings: ...
    @property
    def physics(self) -> PhysicsSettings: ...
    def scene(self) -> PlanningScene: ...


def content_hashes(cell: HashedCell) -> dict[str, str]:
    """Return a content hash for each part of a cell that influences a run, by name.
    Together the hashes identify the cell.

    The names are the cell file's keys (`task`, `objects.cube`, `physics`), `robot` (with its meshes), `code`
    (armcell's source) and `versions.<library>`. The hash of a script includes the file content. The hashes
    are equal in all processes.
    """
    spec = cell.spec.model_dump(mode="json")
    objects = cell.scene().objects
    parts: dict[str, Any] = {
        "robot": {k: v for k, v in _fields(cell.model).items() if k != "source"},
        **{f"objects.{n}": (entry, objects[n].shapes) for n, entry in spec["objects"].items()},
        "objects": list(spec["objects"]),  # the result of physics depends on their order
        "task": (spec["task"], _script(cell)),
        "settings": cell.settings,
        "physics": cell.physics,
        "real": _without_addresses(spec["real"]),
        "code": code_hash(),
        **{f"versions.{name}": version for name, version in versions().items()},
    }
    by_task = any(step.cameras for step in cell.spec.task)
    # a script may use cameras
    looked_at = by_task or cell.spec.perception is not None or cell.spec.script is not None
    passed_over = {"description", "script", "controllers", *(() if looked_at else ("cameras", "markers"))}
    rest = {k: v for k, v in spec.items() if k not in parts and k not in passed_over}
    return {name: _hash(part) for name, part in {**parts, **rest}.items()}


@cache
def code_hash() -> str:
    """Return the hash of armcell's own source code, which is part of a cell's identity."""
    root, digest = Path(__file__).parents[1], hashlib.sha256()
    for file in sorted(f for f in root.rglob("*") if f.suffix in (".py", ".script")):
        digest.update(f"{file.relative_to(root)} ".encode())
        digest.update(hashlib.sha256(file.read_bytes()).digest())
    return digest.hexdigest()[:32]


def _script(cell: HashedCell) -> bytes:
    file = cell.file.parent / (cell.spec.script or "")
    return file.read_bytes() if cell.spec.script is not None and os.path.isfile(file) else b""


def _without_addresses(real: dict[str, Any]) -> dict[str, Any]:
    arms = {
        name: {k: v for k, v in arm.items() if k not in ADDRESSES} if isinstance(arm, dict) else arm
        for name, arm in real.get("arms", {}).items()
    }
    return {**real, "arms": arms} if real else {}


def _hash(value: Any) -> str:
    digest = hashlib.sha256()
    _feed(digest, value)
    return digest.hexdigest()[:32]


def _fields(value: Any) -> dict[str, Any]:
    return {f.name: getattr(value, f.name) for f in fields(value)}


def _feed(digest: Any, value: Any) -> None:
    """Update a cell's content hash with the type and content of a value, such that different values add
    different bytes.
    """
    if isinstance(value, np.ndarray):
        digest.update(f"array {value.dtype} {value.shape} ".encode())
        digest.update(np.ascontiguousarray(value).tobytes())
    elif is_dataclass(value) and not isinstance(value, type):
        digest.update(f"{type(value).__name__} ".encode())
        _feed(digest, _fields(value))
    elif isinstance(value, Mapping):
        rows = sorted(((repr(_plain(k)), v) for k, v in value.items()), key=lambda row: row[0])
        digest.update(f"mapping {len(rows)} ".encode())
        for name, inner in rows:
            digest.update(name.encode())
            _feed(digest, inner)
    elif isinstance(value, list | tuple):
        digest.update(f"list {len(value)} ".encode())
        for inner in value:
            _feed(digest, inner)
    elif isinstance(value, set | frozenset):
        _feed(digest, sorted(repr(inner) for inner in value))
    else:
        digest.update(f"{_plain(value)!r} ".encode())


def _plain(value: Any) -> Any:
    """Convert a value of a cell to a form that has the same hash in all processes.

    Sets are sorted, and memory addresses are removed.
    """
    if isinstance(value, frozenset):
        return tuple(sorted(value))
    if isinstance(value, Enum):
        return value.name
    if value is None or isinstance(value, str | int | float | bool | bytes | tuple):
        return value
    return str(value)
