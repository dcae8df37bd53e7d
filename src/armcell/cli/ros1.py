"""Connects a command to a ROS 1 graph: options, connection and status line."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import ExitStack
from dataclasses import replace
from typing import Any, NamedTuple

import typer

from armcell.cli.console import err
from armcell.cli.naming import Naming
from armcell.core import InputError
from armcell.core.endpoints import Endpoint

ROS1 = typer.Option(
    False, "--ros1", help="Join the ROS 1 graph at ROS_MASTER_URI; start a master where there is none."
)
OWN_MASTER = typer.Option(
    None, "--own-master/--no-own-master", show_default=False,
    help="With --ros1: always start an own master, or never.",
)  # fmt: skip


class Wire(NamedTuple):
    """A connection of the bus to other programs.

    Attributes:
        ready: the message to print when the cell is ready.
        status: returns the text for the status line.
        endpoints: the sockets that listen.
    """

    ready: str
    status: Callable[[], str]
    endpoints: Iterable[Endpoint]


Join = Callable[[], Wire]
"""Connects the bus. The connection was checked and its port reserved before the cell was loaded.

Call it when the cell is ready: afterwards, other programs can reach the cell.
"""


def join(
    stack: ExitStack, bus: Any, name: str, own_master: bool | None, naming: Naming, bind: str | None
) -> Join:
    """Find the ROS 1 master and return a function that joins the graph until the stack closes.

    Args:
        own_master: start an own master (True), never (False), or only if there is none (None).
        bind: address to listen on.
    Raises:
        InputError: there is no master, or the address cannot be used.
    """
    from armcell.ros.nodes.description import NAME
    from armcell.ros.ros1 import Ros1Graph, from_environment

    found = from_environment(name, naming.special, bind, own_master=own_master)
    settings = replace(found, namespace=f"/{naming.namespace}")
    description = NAME if not naming.namespace else f"/{naming.namespace}{NAME}"
    graph = Ros1Graph(bus, settings, keep=(description,), bus_is_graph=True)
    stack.callback(graph.close)
    graph.reserve()
    if not settings.is_local:
        err(f"{settings.bind}: every machine in the network can move the cell (no password, no encryption)")

    def status() -> str:
        """Return the status text of the ROS 1 node.

        Raises:
            InputError: the node was asked to end.
        """
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


def check_own_master(ros1: bool, own_master: bool | None) -> None:
    """Check that --own-master is used with --ros1.

    Raises:
        InputError: --own-master without --ros1.
    """
    if not ros1 and own_master is not None:
        raise InputError("--own-master means nothing here", cure="it goes with --ros1")
