"""Parameters in nested namespaces, as on ROS 1's parameter server."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Mapping
from typing import Any

from armcell.core import UnknownNameError
from armcell.ros.names import NameMap, resolve

_NONE = object()


class Parameters:
    """Thread-safe store of ROS parameters. Each name is either a parameter with a value or a namespace.

    Reading or writing a namespace uses a nested dict.
    """

    def __init__(self) -> None:
        self._values: dict[str, Any] = {}
        self._lock = threading.Lock()

    def set(self, name: str, value: Any) -> None:
        """Set the value of a ROS parameter.
        A mapping replaces all parameters in the namespace of that name.
        """
        name = resolve(name)
        with self._lock:
            self._drop(name)
            for parent in _parents(name):  # a parent that held a value becomes a namespace
                self._values.pop(parent, None)
            self._values.update(_flat(name, value))

    def get(self, name: str, default: Any = _NONE) -> Any:
        """Return the value of a ROS parameter.
        A namespace is returned as nested dicts; the name "/" returns all parameters.

        Raises:
            UnknownNameError: the parameter is not set and the caller gave no default.
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
        """Delete a ROS parameter, or a namespace with all of its parameters.

        Raises:
            UnknownNameError: the parameter is not set.
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


class RemappedParameters(Parameters):
    """View of the ROS parameters for a program that runs in a namespace or with remapped names."""

    def __init__(self, parameters: Parameters, names: NameMap):
        self._parameters, self._map = parameters, names

    def set(self, name: str, value: Any) -> None:
        self._parameters.set(self._map.to_graph(name), value)

    def get(self, name: str, default: Any = _NONE) -> Any:
        full = self._map.namespace if name == "/" else self._map.to_graph(name)
        return self._parameters.get(full, default)

    def delete(self, name: str) -> None:
        self._parameters.delete(self._map.to_graph(name))

    def names(self) -> list[str]:
        return [self._map.to_bus(name) for name in self._parameters.names()]

    def __contains__(self, name: str) -> bool:
        return self._map.to_graph(name) in self._parameters


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
