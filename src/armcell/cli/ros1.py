"""Joining a ROS 1 graph from the command line: options and the words of the status line."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import ExitStack
from typing import Any, NamedTuple

import typer

from armcell.cli.console import err
from armcell.core import InputError
from armcell.core.endpoints import Endpoint

ROS1 = typer.Option(
    False, "--ros1", help="Join the ROS 1 graph at ROS_MASTER_URI; start a master where there is none."
)
OWN_MASTER = typer.Option(
    None, "--own-master/--no-own-master", show_default=False,
    help="With --ros1: always start an own master, or never.",
)  # fmt: skip
REMAP = typer.Argument(
    None, metavar="[FROM:=TO]...", show_default=False,
    help="With --ros1: remappings as for a ROS program, __name:= and __ns:= among them.",
)  # fmt: skip


class Wire(NamedTuple):
    """What the bus is joined to: what is said when the cell is ready, and on the status line."""

    ready: str
    status: Callable[[], str]
    endpoints: Iterable[Endpoint]


Join = Callable[[], Wire]
"""Joins the bus to a wire that was looked at, and whose port was taken, before the cell was loaded.

To be called when the cell is ready: from then on others can reach it.
"""


def join(
    stack: ExitStack, bus: Any, name: str, own_master: bool | None, remap: list[str] | None, bind: str | None
) -> Join:
    """Find a graph's master, and give what joins the graph until the stack is closed.

    Raises:
        InputError: there is no master, an address cannot be listened on, a remapping is none.
    """
    from armcell.ros.nodes.description import NAME
    from armcell.ros.ros1 import Ros1Graph, from_environment

    settings = from_environment(name, remap or (), bind, own_master=own_master)
    graph = Ros1Graph(bus, settings, keep=(NAME,))
    stack.callback(graph.close)
    graph.reserve()
    if not settings.is_local:
        err(f"{settings.bind}: every machine in the network can move the cell (no password, no encryption)")

    def status() -> str:
        """Raises InputError when the node was asked to end."""
        if graph.ended.is_set():
            raise InputError(f"the ROS 1 node has to end: {graph.reason}")
        now = graph.status()
        peers = ", ".join(now.peers[:3]) + (" ..." if len(now.peers) > 3 else "")
        words = [
            f"ROS 1 {now.node}  {peers or 'no other node'}",
            "" if now.reachable else "master gone",
            f"dropped {now.dropped}" if now.dropped else "",
            f"mistakes {now.mistakes}" if now.mistakes else "",
        ]
        return "  ".join(word for word in words if word)

    def joined() -> Wire:
        graph.start()
        own = "its own master" if graph.master else "the master"
        ready = f"ROS 1: node {graph.node.name} at {own}, {graph.node.master}"
        return Wire(ready, status, graph.endpoints())

    return joined


def check_remap(ros1: bool, remap: list[str] | None, own_master: bool | None) -> None:
    """
    Raises:
        InputError: options of --ros1 without it.
    """
    if not ros1 and (remap or own_master is not None):
        what = "--own-master" if own_master is not None else f"argument {(remap or [''])[0]!r}"
        raise InputError(f"{what} means nothing here", cure="it goes with --ros1")
