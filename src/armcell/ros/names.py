"""ROS graph names: full names, namespaces, private names and remappings.

`joint_states` and `/joint_states` name the same topic.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

from armcell.core import InputError

MAX_LENGTH = 256
ACTION_PARTS = ("goal", "cancel", "status", "feedback", "result")
GLOBAL = ("/tf", "/tf_static", "/clock", "/rosout", "/rosout_agg", "/use_sim_time", "/run_id")
_PART = re.compile(r"^[A-Za-z_][A-Za-z0-9_]*$")


def resolve(name: str, namespace: str = "/") -> str:
    """Return the full ROS name of a topic or service, with a leading slash.

    Args:
        name: a relative name, or a full name that starts with a slash.
        namespace: prefix for a relative name.
    Raises:
        InputError: ROS does not accept the name (valid: letters, digits and _ between slashes, no leading
            digit).
    """
    full = name if name.startswith("/") else f"{namespace.rstrip('/')}/{name}"
    parts = [part for part in full.split("/") if part]
    if not parts or len(full) > MAX_LENGTH or not all(_PART.match(part) for part in parts):
        raise InputError(
            f"{name[:80]!r} is no topic or service name", hint="letters, digits and _ between slashes"
        )
    return "/" + "/".join(parts)


def resolve_program_name(name: str, node: str, namespace: str) -> str:
    """Resolve an absolute, private or relative ROS name from the source code of a program to a full ROS name.

    `/a` stays `/a`, `~a` is relative to the node, and `a` is relative to the namespace.

    Args:
        name: absolute, private or relative name.
        node: full name of the node.
        namespace: namespace of the node.
    Raises:
        InputError: ROS does not accept the name.
    """
    if name.startswith("~"):
        return resolve(name[1:].lstrip("/"), node)
    return resolve(name, namespace)


class NameMap:
    """One-to-one map between the ROS names of a program and the names on the ROS graph.

    The namespace prefixes all names of the program, including names with a leading slash; only the names in
    `GLOBAL` stay unchanged. Remapping an action remaps its five topics as well. Source of the rules:
    wiki.ros.org/Names.

    Args:
        node: full name of the node, or its name relative to the namespace.
        namespace: namespace of the program.
        remap: maps original names to new names; both are resolved in the namespace first.
    Raises:
        InputError: a name is invalid, or two names map to the same name.
    """

    def __init__(self, node: str, namespace: str = "/", remap: Mapping[str, str] | None = None):
        namespace = "/" + namespace.strip("/")
        self.node, self.namespace = resolve(node, namespace), namespace
        self._there: dict[str, str] = {}
        self._back: dict[str, str] = {}
        for before, after in (remap or {}).items():
            one, other = (resolve_program_name(name, self.node, namespace) for name in (before, after))
            if other in self._back:
                raise InputError(f"{self._back[other]} and {one} are both remapped to {other}")
            self._there[one], self._back[other] = other, one

    @property
    def remappings(self) -> list[str]:
        """Return the names that a program uses for those topics and services whose ROS names are remapped."""
        return [self.to_bus(self._there[name]) for name in self._there]

    def to_graph(self, name: str) -> str:
        """Return the name on the ROS graph for a name that the program uses."""
        full = name if name in GLOBAL else resolve(name.lstrip("/"), self.namespace)
        return _renamed(self._there, full)

    def to_bus(self, name: str) -> str:
        """Convert the name of a topic or service on the ROS graph to the name that the program uses.

        Names outside the namespace stay unchanged.
        """
        full = _renamed(self._back, name)
        inside = self.namespace.rstrip("/") + "/"
        return f"/{full[len(inside) :]}" if full.startswith(inside) else full


def _renamed(table: Mapping[str, str], name: str) -> str:
    """Look up a ROS name in a table of remappings. Remapping an action also remaps its topics."""
    if name in table:
        return table[name]
    action, _, part = name.rpartition("/")
    return f"{table[action]}/{part}" if part in ACTION_PARTS and action in table else name


def name_map(node: str, namespace: str = "", remap: Iterable[str] = ()) -> NameMap | None:
    """Return the map that applies a namespace and remappings to ROS names,
    or None if it would change no name.

    Args:
        node: name of the node.
        namespace: namespace of the program; empty for none.
        remap: remappings of the form `from:=to`.
    Raises:
        InputError: an argument is not of the form `from:=to`, a name is invalid, or two names map to the same
            name.
    """
    pairs: dict[str, str] = {}
    for argument in remap:
        before, sign, after = (part.strip() for part in argument.partition(":="))
        if not (sign and before and after):
            raise InputError(f"{argument!r} is not a remapping", hint="write FROM:=TO")
        pairs[_own(before, namespace)] = after
    if not namespace.strip("/") and not pairs:
        return None
    return NameMap(node, namespace, pairs)


def _own(name: str, namespace: str) -> str:
    """Remove the leading slash of a remapped ROS name, so that it is relative to the namespace. Global names
    and names inside the namespace stay unchanged.
    """
    inside = f"/{namespace.strip('/')}/"
    if name in GLOBAL or name.startswith(inside):
        return name
    return name.lstrip("/")
