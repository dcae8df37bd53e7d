"""ROS 1 parameters: the tree of a parameter server, and a bus's parameters stored in the ROS master.

Keys of the tree may be any strings that XML-RPC carries. Source:
wiki.ros.org/ROS/Parameter%20Server%20API. Every value that is set through the bus is also kept locally.
While the master is unreachable, reads return the kept value; a restarted master receives all kept
values again.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from typing import Any

import numpy as np

from armcell.core import InputError, UnknownNameError
from armcell.ros.names import NameMap
from armcell.ros.parameters import _NONE, Parameters
from armcell.ros.ros1.xmlrpc import ERROR, RpcError

logger = logging.getLogger(__name__)
Ask = Callable[..., Any]


def _parts(key: str) -> list[str]:
    return [part for part in key.split("/") if part]


class ParameterTree:
    """Tree of ROS 1 parameters by their full names.
    It is not thread-safe; the ROS master protects it with a lock.
    """

    def __init__(self) -> None:
        self._root: dict[str, Any] = {}

    def get(self, key: str) -> Any:
        """Return the value of a parameter from the ROS 1 parameter tree. A namespace is returned as nested
        dicts.

        Raises:
            KeyError: the parameter is not set.
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
        """Set a value in the ROS 1 parameter tree. A dict replaces the whole namespace.

        A parent in the key's path that holds a value becomes a namespace.

        Raises:
            ValueError: `key` is the root and `value` is not a dict.
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
        """Delete a parameter, or a namespace with all its parameters, from the ROS 1 parameter tree.

        Raises:
            KeyError: the parameter is not set.
        """
        *parents, last = _parts(key) or [""]
        node = self.get("/".join(parents)) if last else None
        if not isinstance(node, dict) or last not in node:
            raise KeyError(key)
        del node[last]

    def search(self, namespace: str, key: str) -> str | None:
        """Search for a ROS 1 parameter in a namespace and then in the enclosing namespaces, beginning with
        the nearest.

        Only the first part of the key must exist.

        Returns:
            The full name of the parameter, or None if no namespace contains the first part of the key.
        """
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
        """Return the full names of all parameters in the ROS 1 parameter tree."""
        found: list[str] = []

        def walk(node: dict[str, Any], prefix: str) -> None:
            for name, value in node.items():
                if isinstance(value, dict):
                    walk(value, f"{prefix}{name}/")
                else:
                    found.append(prefix + name)

        walk(self._root, "/")
        return found


def subscriber_update(subscribed: str, changed: str, value: Any) -> tuple[str, Any] | None:
    """Return the update that a ROS 1 parameter server sends to a subscriber after a parameter has changed.

    Args:
        subscribed: full name that the node subscribed to.
        changed: full name that was set or deleted.
        value: the new value; an empty dict for a deleted parameter.
    Returns:
        Key and value of the update, or None if the change does not affect the subscribed parameter.
        Source: the answers of rosmaster.
    """
    inner, outer = _parts(subscribed), _parts(changed)
    if outer[: len(inner)] == inner:  # the subscribed key or a descendant changed
        return "/" + "/".join([*outer, ""]), value
    if inner[: len(outer)] != outer:
        return None
    for part in inner[len(outer) :]:  # an ancestor namespace was replaced
        if not isinstance(value, dict) or part not in value:
            return "/" + "/".join([*inner, ""]), {}
        value = value[part]
    return "/" + "/".join([*inner, ""]), value


class GraphParameters(Parameters):
    """Thread-safe view of the parameters that the ROS 1 master stores, under the names that the bus uses.

    Args:
        ask: calls the master: `ask(method, *arguments)`.
        kept: the bus's parameters before it joined the graph; `upload_all` sends them to the master.
    """

    def __init__(self, ask: Ask, names: NameMap, kept: Parameters):
        super().__init__()
        self._ask, self._names, self.kept = ask, names, kept
        self._telling = threading.Lock()

    def upload_all(self) -> None:
        """Send all parameters that the bus has stored so far to the parameter server of the ROS 1 master.

        Raises:
            RpcError: the master does not answer.
        """
        for name in self.kept.names():
            self._tell(name, self.kept.get(name))

    def _tell(self, name: str, value: Any) -> None:
        with self._telling:
            try:
                self._ask("setParam", self._names.to_graph(name), _plain(value))
            except InputError as error:
                logger.warning("parameter %s: %s", name, error)

    def set(self, name: str, value: Any) -> None:
        self.kept.set(name, value)
        try:
            self._tell(name, value)
        except RpcError as error:
            logger.warning("parameter %s is kept, but not set at the master: %s", name, error)

    def get(self, name: str, default: Any = _NONE) -> Any:
        try:
            return self._ask("getParam", "/" if name == "/" else self._names.to_graph(name))
        except RpcError as error:
            if error.code is None:
                return self.kept.get(name, default)
            if default is not _NONE:
                return default
            raise UnknownNameError("parameter", name, self.names()) from None

    def delete(self, name: str) -> None:
        if name in self.kept:
            self.kept.delete(name)
        try:
            self._ask("deleteParam", self._names.to_graph(name))
        except RpcError as error:
            if error.code == ERROR:
                raise UnknownNameError("parameter", name, self.names()) from None
            raise InputError(f"parameter {name} is not deleted: {error}") from None

    def names(self) -> list[str]:
        try:
            return sorted(self._names.to_bus(name) for name in self._ask("getParamNames"))
        except RpcError:
            return self.kept.names()

    def __contains__(self, name: str) -> bool:
        try:
            return bool(self._ask("hasParam", self._names.to_graph(name)))
        except RpcError:
            return name in self.kept


def _plain(value: Any) -> Any:
    """Convert the value of a parameter for the ROS 1 master:
    numpy values and tuples become types that XML-RPC supports.
    """
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, dict):
        return {str(k): _plain(v) for k, v in value.items()}
    return [_plain(v) for v in value] if isinstance(value, list | tuple) else value
