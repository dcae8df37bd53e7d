"""Names of the bus and names of the graph: namespace, private names, remapping.

Source: wiki.ros.org/Names. The bus's names are taken as relative ones, so that a namespace holds a whole
cell; the few that every ROS program means globally stay where they are.
"""

from __future__ import annotations

from collections.abc import Mapping

from armcell.core import InputError
from armcell.ros.names import resolve

GLOBAL = ("/tf", "/tf_static", "/clock", "/rosout", "/rosout_agg", "/use_sim_time", "/run_id")


def resolved(name: str, node: str, namespace: str) -> str:
    """A name as a program wrote it, in full: `/a` as it is, `~a` below the node, `a` in the namespace.

    Raises:
        InputError: not a name ROS accepts.
    """
    if name.startswith("~"):
        return resolve(name[1:].lstrip("/"), node)
    return resolve(name, namespace)


class GraphNames:
    """Between a bus's names and a graph's, one to one.

    Args:
        node: the node's full name.
        remap: pairs as given to a program; both sides are resolved first.
    Raises:
        InputError: a name is none, or two names would become one.
    """

    def __init__(self, node: str, namespace: str = "/", remap: Mapping[str, str] | None = None):
        self.node, self.namespace = resolve(node, namespace), namespace
        self._there: dict[str, str] = {}
        self._back: dict[str, str] = {}
        for before, after in (remap or {}).items():
            one, other = (resolved(name, self.node, namespace) for name in (before, after))
            if other in self._back:
                raise InputError(f"{self._back[other]} and {one} are both remapped to {other}")
            self._there[one], self._back[other] = other, one

    def to_graph(self, name: str) -> str:
        """A name of the bus as the graph has it."""
        full = name if name in GLOBAL else resolve(name.lstrip("/"), self.namespace)
        return self._there.get(full, full)

    def to_bus(self, name: str) -> str:
        """A name of the graph as the bus has it; names outside the namespace stay as they are."""
        full = self._back.get(name, name)
        inside = self.namespace.rstrip("/") + "/"
        return f"/{full[len(inside) :]}" if full.startswith(inside) else full
