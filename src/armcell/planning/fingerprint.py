"""One short text for the content of a value: the same for equal robots, scenes and goals, in every run."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np


def fingerprint(*values: Any) -> str:
    """32 hexadecimal digits. Where a value's file lies does not matter, what it holds does.

    Raises:
        TypeError: a kind of value that is not known here.
    """
    digest = hashlib.blake2b(digest_size=16)
    _add(digest, values)
    return digest.hexdigest()


def _add(digest: Any, value: Any) -> None:
    match value:
        case None | bool() | int() | float() | str() | np.generic():
            text = repr(value.item() if isinstance(value, np.generic) else value)
            digest.update(f"{type(value).__name__}:{len(text)}:{text}".encode())
        case Path():
            digest.update(b"path")
        case np.ndarray():
            digest.update(f"array:{value.dtype.str}:{value.shape}".encode())
            digest.update(np.ascontiguousarray(value).tobytes())
        case Mapping():
            digest.update(f"map:{len(value)}".encode())
            for key, item in sorted(((fingerprint(k), v) for k, v in value.items()), key=lambda kv: kv[0]):
                digest.update(key.encode())
                _add(digest, item)
        case set() | frozenset():
            digest.update(f"set:{','.join(sorted(fingerprint(v) for v in value))}".encode())
        case tuple() | list():
            digest.update(f"list:{len(value)}".encode())
            for item in value:
                _add(digest, item)
        case _ if is_dataclass(value) and not isinstance(value, type):
            digest.update(type(value).__name__.encode())
            for field in fields(value):
                _add(digest, field.name)
                _add(digest, getattr(value, field.name))
        case _:
            raise TypeError(f"a {type(value).__name__} has no fingerprint")
