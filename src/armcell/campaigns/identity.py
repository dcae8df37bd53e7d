"""Whether two campaigns are about the same thing: hashes of all that a cell says."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from typing import Any

import numpy as np

from armcell.cell import Cell
from armcell.cell.run import versions


def content_hashes(cell: Cell) -> dict[str, str]:
    """Of the parts that decide a run, by name; the same in every process."""
    spec = cell.spec.model_dump(mode="json")
    parts: dict[str, Any] = {
        "robot": {k: v for k, v in _fields(cell.model).items() if k != "source"},
        "objects": (spec["objects"], [item.shapes for item in cell.scene().objects.values()]),
        "task": spec["task"],
        "settings": cell.settings,
        "physics": cell.physics,
        "versions": versions(),
    }
    rest = {k: v for k, v in spec.items() if k not in (*parts, "description", "cameras")}
    return {name: _hash(part) for name, part in {**parts, "cell": rest}.items()}


def _hash(value: Any) -> str:
    digest = hashlib.sha256()
    _feed(digest, value)
    return digest.hexdigest()[:32]


def _fields(value: Any) -> dict[str, Any]:
    return {f.name: getattr(value, f.name) for f in fields(value)}


def _feed(digest: Any, value: Any) -> None:
    """Type and content of a value, unambiguously."""
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
    """Without what differs between processes: the order of sets, addresses."""
    if isinstance(value, frozenset):
        return tuple(sorted(value))
    if isinstance(value, Enum):
        return value.name
    if value is None or isinstance(value, str | int | float | bool | bytes | tuple):
        return value
    return str(value)
