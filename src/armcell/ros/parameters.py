"""Parameters by name, in nested namespaces, as ROS 1's parameter server keeps them."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Mapping
from typing import Any

from armcell.core import UnknownNameError
from armcell.ros.names import resolve

_NONE = object()


class Parameters:
    """Thread-safe. A name may be a value or a namespace; a namespace reads and writes as a dict."""

    def __init__(self) -> None:
        self._values: dict[str, Any] = {}
        self._lock = threading.Lock()

    def set(self, name: str, value: Any) -> None:
        """Set a value; a mapping replaces the whole namespace."""
        name = resolve(name)
        with self._lock:
            self._drop(name)
            for parent in _parents(name):  # a value that was there becomes a namespace
                self._values.pop(parent, None)
            self._values.update(_flat(name, value))

    def get(self, name: str, default: Any = _NONE) -> Any:
        """A value, or a namespace as nested dicts; "/" is everything.

        Raises:
            UnknownNameError: not set, and no default given.
        """
        name = "/" if name == "/" else resolve(name)
        with self._lock:
            if name in self._values:
                return self._values[name]
            below = {n: v for n, v in self._values.items() if n.startswith(name.rstrip("/") + "/")}
        if below or name == "/":
            return _tree(below, name)
        if default is not _NONE:
            return default
        raise UnknownNameError("parameter", name, self.names())

    def delete(self, name: str) -> None:
        """Remove a value or a namespace.

        Raises:
            UnknownNameError: not set.
        """
        name = resolve(name)
        with self._lock:
            if not self._drop(name):
                raise UnknownNameError("parameter", name, self._values)

    def names(self) -> list[str]:
        with self._lock:
            return sorted(self._values)

    def __contains__(self, name: str) -> bool:
        name = resolve(name)
        with self._lock:
            return name in self._values or any(n.startswith(f"{name}/") for n in self._values)

    def _drop(self, name: str) -> bool:
        gone = [n for n in self._values if n == name or n.startswith(f"{name}/")]
        for n in gone:
            del self._values[n]
        return bool(gone)


def _parents(name: str) -> Iterator[str]:
    while (name := name.rpartition("/")[0]) != "":
        yield name


def _flat(name: str, value: Any) -> dict[str, Any]:
    if not isinstance(value, Mapping) or not value:
        return {name: value}
    found: dict[str, Any] = {}
    for key, inner in value.items():
        found |= _flat(resolve(str(key), name), inner)
    return found


def _tree(values: Mapping[str, Any], root: str) -> dict[str, Any]:
    tree: dict[str, Any] = {}
    for name, value in values.items():
        *parents, last = name[len(root.rstrip("/")) + 1 :].split("/")
        node = tree
        for parent in parents:
            node = node.setdefault(parent, {})
        node[last] = value
    return tree
