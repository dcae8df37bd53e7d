"""Connection of a command to a ROS 2 domain: options, connection and status line."""

from __future__ import annotations

from contextlib import ExitStack
from typing import Any

import typer

from armcell.cli.console import err
from armcell.cli.ros1 import Join, OpenTransport, reserve_transport
from armcell.core import InputError

ROS2 = typer.Option(
    False, "--ros2", help="Join a ROS 2 domain (extra ros2): ROS_DISTRO, ROS_AUTOMATIC_DISCOVERY_RANGE, ..."
)
DOMAIN = typer.Option(
    None, "--domain", min=0, max=232, show_default=False,
    help="With --ros2: the domain, instead of ROS_DOMAIN_ID.",
)  # fmt: skip


def join(
    stack: ExitStack, bus: Any, node: str, domain: int | None, bind: str | None = None, namespace: str = ""
) -> Join:
    """Read the ROS 2 options of a command, and return a function that joins the domain.

    The exit stack leaves the domain when it closes.

    Args:
        bind: an address that is not this machine's own allows other machines to connect.
    Raises:
        MissingExtraError: cyclonedds is not installed.
        InputError: an environment variable is wrong, or the domain cannot be joined.
    """
    from armcell.ros import Ros2Settings
    from armcell.ros.ros2 import from_environment
    from armcell.ros.transports import Ros2Transport

    reach = from_environment(domain, network=bind not in (None, "127.0.0.1", "localhost"))
    settings = Ros2Settings(reach, f"/{namespace}/{node}" if namespace else f"/{node}")
    connect = reserve_transport(stack, Ros2Transport(bus, "", settings))
    if reach.is_open:
        err("ROS 2: every machine in the network can move the cell (no password, no encryption)")

    def joined() -> OpenTransport:
        wire = connect()
        if not reach.is_open and not all(endpoint.is_local for endpoint in wire.endpoints):
            err(
                "ROS 2: DDS looks for nodes on this machine alone, but it listens on the network, too: "
                "a machine that names this one as its peer can move the cell; hint: a firewall"
            )
        return wire

    return joined


def check_domain(ros2: bool, domain: int | None) -> None:
    """Check that the ROS 2 option --domain is used only with --ros2.

    Raises:
        InputError: --domain without --ros2.
    """
    if domain is not None and not ros2:
        raise InputError("--domain means nothing here", hint="it goes with --ros2")
