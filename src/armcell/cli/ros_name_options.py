"""Namespace and remappings of ROS names, from the command line and the cell file."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import typer

from armcell.core import InputError

if TYPE_CHECKING:
    from armcell.ros.names import NameMap

NAMESPACE = typer.Option(
    "", "--ns", metavar="NAMESPACE", show_default=False,
    help="Put all names into a namespace, on every wire: --ns arm_left gives /arm_left/joint_states.",
)  # fmt: skip
REMAP = typer.Option(
    None, "--remap", metavar="FROM:=TO", show_default=False,
    help="Rename a topic, service or action on every wire; repeat it for several.",
)  # fmt: skip
ARGUMENTS = typer.Argument(
    None, metavar="[FROM:=TO]...", show_default=False,
    help="As for a ROS program: remappings, __ns:= and, with --ros1, __name:= and private parameters.",
)  # fmt: skip


@dataclass(frozen=True)
class RosNameOptions:
    """Command-line options for ROS names: the namespace and the remappings.

    Attributes:
        namespace: the namespace for all names; empty for none.
        remap: remappings FROM:=TO.
        special: ROS 1 arguments that begin with an underscore.
    """

    namespace: str
    remap: tuple[str, ...]
    special: tuple[str, ...]

    @property
    def command_line(self) -> list[str]:
        """Return the ROS namespace and the remappings in the form of
        command line options, for the record of a run.
        """
        space = ["--ns", self.namespace] if self.namespace else []
        return space + [word for pair in self.remap for word in ("--remap", pair)]

    def map_for(self, cell: Any) -> NameMap | None:
        """Return the map from a cell's ROS names to the names on the bus, or None if they are equal.
        Command-line options override the cell file.

        Raises:
            InputError: a name is invalid, or two names become equal.
        """
        from armcell.ros.names import name_map

        spec = cell.spec.ros
        pairs = (*(f"{before}:={after}" for before, after in spec.remap.items()), *self.remap)
        return name_map("armcell", self.namespace or spec.namespace, pairs)


def parse_ros_names(
    namespace: str, remap: list[str] | None, arguments: list[str] | None, ros1: bool
) -> RosNameOptions:
    """Parse the command line options for ROS names.
    With ROS 1, the environment variable ROS_NAMESPACE is the default namespace.

    Raises:
        InputError: the namespace is invalid, an argument is not a remapping, or an argument applies to ROS 1
            only.
    """
    from armcell.ros.names import name_map

    special = [a for a in arguments or () if a.startswith("_")]
    spaces = [a for a in special if a.startswith("__ns:=")]
    rest = tuple(a for a in special if a not in spaces)
    if rest and not ros1:
        raise InputError(f"argument {rest[0]!r} applies to ROS 1 alone", hint="add --ros1")
    namespace = namespace or "".join(a.partition(":=")[2] for a in spaces[-1:])
    namespace = (namespace or (os.environ.get("ROS_NAMESPACE", "") if ros1 else "")).strip("/")
    pairs = (*(a for a in arguments or () if not a.startswith("_")), *(remap or ()))
    name_map("armcell", namespace, pairs)
    return RosNameOptions(namespace, pairs, rest)


def unused_remappings_warning(bus: Any) -> str:
    """Return a warning if a remapped ROS name matches no topic, service or action of the cell. Return an
    empty text otherwise.
    """
    if bus.names is None:
        return ""
    have = {t.name for t in bus.topics()} | set(bus.services())
    have |= {name.rpartition("/")[0] for name in have if name.endswith("/goal")}
    odd = [name for name in bus.names.remappings if name not in have]
    return f"the cell has no topic, service or action {', '.join(odd)}: nothing is remapped" if odd else ""
