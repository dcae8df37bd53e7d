"""Parameters of a bus, stored in the parameter server of a ROS master.

Every value that is set here is also kept locally. While the master is unreachable, reads return the kept
value; a restarted master receives all kept values again.
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
