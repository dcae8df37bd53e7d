"""Connection of a command to a ROS 1 graph: options, connection and status line."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import ExitStack
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import typer

from armcell.cli.console import err
from armcell.cli.ros_name_options import RosNameOptions
from armcell.core import InputError
from armcell.core.network_endpoints import Endpoint

if TYPE_CHECKING:
    from armcell.ros.transports import Transport

ROS1 = typer.Option(
    False, "--ros1", help="Join the ROS 1 graph at ROS_MASTER_URI; start a master where there is none."
)
OWN_MASTER = typer.Option(
    None, "--own-master/--no-own-master", show_default=False,
    help="With --ros1: always start an own master, or never.",
)  # fmt: skip


class OpenTransport(NamedTuple):
    """Transport that an armcell command has opened between its message bus and ROS or another program.

    Attributes:
        ready: the message to print when the cell is ready.
        status: returns the text for the status line.
        endpoints: the sockets that listen.
    """

    ready: str
    status: Callable[[], str]
    endpoints: Iterable[Endpoint]


Join = Callable[[], OpenTransport]
"""Connects the bus. The connection was checked and its port reserved before the cell was loaded.

Call it when the cell is ready: afterwards, other programs can reach the cell.
"""


def join(
    stack: ExitStack, bus: Any, name: str, own_master: bool | None, naming: RosNameOptions, bind: str | None
) -> Join:
    """Find a ROS 1 master or, if allowed, start the built-in master. Return a function that connects a
    command's message bus to the ROS 1 graph of this master.

    Args:
        own_master: True starts a built-in master, False never does, None does if no master is reachable.
        bind: address to listen on.
    Raises:
        InputError: there is no master, or the address cannot be used.
    """
    from armcell.ros.robot_description import NAME
    from armcell.ros.ros1 import from_environment
    from armcell.ros.transports import Ros1Transport

    found = from_environment(name, naming.special, bind, own_master=own_master)
    settings = replace(found, namespace=f"/{naming.namespace}")
    description = NAME if not naming.namespace else f"/{naming.namespace}{NAME}"
    connect = reserve_transport(stack, Ros1Transport(bus, "", settings, keep=(description,)))
    if not settings.is_local:
        err(f"{settings.bind}: every machine in the network can move the cell (no password, no encryption)")
    return connect


def reserve_transport(stack: ExitStack, transport: Transport) -> Join:
    """Reserve the port of a transport (ROS 1, Unity) for a command,
    and return a function that opens the transport.

    Raises:
        InputError: the port is in use.
    """
    stack.callback(transport.close)
    transport.reserve()

    def joined() -> OpenTransport:
        transport.start()
        return OpenTransport(transport.ready_message(), transport.status_text, transport.endpoints())

    return joined


def check_own_master(ros1: bool, own_master: bool | None) -> None:
    """Check that the ROS 1 option --own-master is used only with --ros1.

    Raises:
        InputError: --own-master without --ros1.
    """
    if not ros1 and own_master is not None:
        raise InputError("--own-master means nothing here", hint="it goes with --ros1")
