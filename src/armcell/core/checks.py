"""Checking settings dataclasses: types against the defaults, numbers finite."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, fields, is_dataclass
from typing import Any, TypeVar

import numpy as np

from armcell.core.errors import InputError, UnknownNameError

T = TypeVar("T")


def settings_from(cls: type[T], values: Any, what: str) -> T:
    """A settings dataclass from a mapping, as a file gives it; nested settings are mappings too.

    Raises:
        InputError: unknown name (lists those there are), wrong type, missing or impossible value.
    """
    if not isinstance(values, Mapping):
        raise InputError(f"{what} is {values!r}, a mapping is needed")
    known = {f.name: f for f in fields(cls)}  # type: ignore[arg-type]
    ready: dict[str, Any] = {}
    for name, value in values.items():
        if name not in known:
            raise UnknownNameError(f"setting of {what}", name, known)
        default = known[name].default
        if default is MISSING:
            default = 0.0  # settings without a default are numbers
        ready[name] = _like(default, value, f"{what}/{name}")
    missing = [n for n, f in known.items() if f.default is MISSING and n not in ready]
    if missing:
        raise InputError(f"{what} lacks {', '.join(missing)}")
    return cls(**ready)


def _number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and bool(np.isfinite(value))


def _like(default: Any, value: Any, what: str) -> Any:
    """A value of the kind the default is of."""
    if is_dataclass(default) and not isinstance(default, type):
        return settings_from(type(default), value, what)
    if isinstance(default, str):
        if not isinstance(value, str):
            raise InputError(f"{what} is {value!r}, a text is needed")
        return value
    if isinstance(default, bool):
        if not isinstance(value, bool):
            raise InputError(f"{what} is {value!r}, true or false is needed")
        return value
    if isinstance(default, tuple):
        if not isinstance(value, (list, tuple)) or len(value) != len(default) or not all(map(_number, value)):
            raise InputError(f"{what} is {value!r}, a list of {len(default)} numbers is needed")
        return tuple(float(v) for v in value)
    if isinstance(default, int):
        if not _number(value) or int(value) != value:
            raise InputError(f"{what} is {value!r}, a whole number is needed")
        return int(value)
    if not _number(value):
        raise InputError(f"{what} is {value!r}, a number is needed")
    return float(value)


def require(condition: bool, text: str) -> None:
    """Raise an InputError unless the condition holds."""
    if not condition:
        raise InputError(text)
