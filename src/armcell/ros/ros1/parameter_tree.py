"""The parameter server's values: a tree of dicts, whose keys may be anything that XML-RPC carries.

Source: wiki.ros.org/ROS/Parameter%20Server%20API.
"""

from __future__ import annotations

from typing import Any


def _parts(key: str) -> list[str]:
    return [part for part in key.split("/") if part]


class ParameterTree:
    """Not thread-safe: the master's lock guards it. Keys are full names."""

    def __init__(self) -> None:
        self._root: dict[str, Any] = {}

    def get(self, key: str) -> Any:
        """A value, or a namespace as nested dicts.

        Raises:
            KeyError: not set.
        """
        value: Any = self._root
        for part in _parts(key):
            if not isinstance(value, dict):
                raise KeyError(key)
            value = value[part]
        return value

    def __contains__(self, key: str) -> bool:
        try:
            self.get(key)
        except KeyError:
            return False
        return True

    def set(self, key: str, value: Any) -> None:
        """Set a value; a dict replaces the whole namespace. A value on the way becomes a namespace.

        Raises:
            ValueError: the root can only be a dict.
        """
        *parents, last = _parts(key) or [""]
        if not last:
            if not isinstance(value, dict):
                raise ValueError("cannot set root of parameter tree to non-dictionary")
            self._root = value
            return
        node = self._root
        for part in parents:
            inner = node.get(part)
            if not isinstance(inner, dict):
                inner = node[part] = {}
            node = inner
        node[last] = value

    def delete(self, key: str) -> None:
        """
        Raises:
            KeyError: not set.
        """
        *parents, last = _parts(key) or [""]
        node = self.get("/".join(parents)) if last else None
        if not isinstance(node, dict) or last not in node:
            raise KeyError(key)
        del node[last]

    def search(self, namespace: str, key: str) -> str | None:
        """The full name of a key whose first part is set in a namespace or the nearest one above it."""
        if key.startswith("/"):
            return key if key in self else None
        first = _parts(key)[0]
        parents = _parts(namespace)
        for count in range(len(parents), -1, -1):
            below = "/" + "/".join([*parents[:count], ""]) if count else "/"
            if below + first in self:
                return below + key
        return None

    def names(self) -> list[str]:
        """Every value's full name."""
        found: list[str] = []

        def walk(node: dict[str, Any], prefix: str) -> None:
            for name, value in node.items():
                if isinstance(value, dict):
                    walk(value, f"{prefix}{name}/")
                else:
                    found.append(prefix + name)

        walk(self._root, "/")
        return found


def told(subscribed: str, changed: str, value: Any) -> tuple[str, Any] | None:
    """What the subscriber of a key hears of a change: the key and value, or None if it is not concerned.

    A deleted value is told as an empty dict. Source: rosmaster's answers.
    """
    inner, outer = _parts(subscribed), _parts(changed)
    if outer[: len(inner)] == inner:  # the key itself or something below it
        return "/" + "/".join([*outer, ""]), value
    if inner[: len(outer)] != outer:
        return None
    for part in inner[len(outer) :]:  # something above it was replaced
        if not isinstance(value, dict) or part not in value:
            return "/" + "/".join([*inner, ""]), {}
        value = value[part]
    return "/" + "/".join([*inner, ""]), value
