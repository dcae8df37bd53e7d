"""Connects a command to a ROS 2 domain: options, connection and status line."""

from __future__ import annotations

from contextlib import ExitStack
from typing import Any

import typer

from armcell.cli.console import err
from armcell.cli.ros1 import Join, Wire
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
    """Read the ROS 2 settings; return a function that joins the domain until the stack closes.

    Args:
        bind: an address that is not this machine's own allows other machines to connect.
    Raises:
        MissingExtraError: cyclonedds is not installed.
        InputError: an environment variable is wrong, or the domain cannot be joined.
    """
    from armcell.ros import Ros2Bridge, Ros2Settings
    from armcell.ros.ros2 import from_environment
    from armcell.ros.ros2.dds import library

    reach = from_environment(domain, network=bind not in (None, "127.0.0.1", "localhost"))
    settings = Ros2Settings(reach, f"/{namespace}/{node}" if namespace else f"/{node}")
    library()  # report a missing extra before the cell is loaded
    bridge = Ros2Bridge(bus, settings)
    if reach.is_open:
        err("ROS 2: every machine in the network can move the cell (no password, no encryption)")

    def status() -> str:
        now = bridge.status()
        peers = ", ".join(now.nodes[:3]) + (" ..." if len(now.nodes) > 3 else "")
        words = [
            f"ROS 2 domain {now.domain}  {peers or 'no other node'}",
            f"dropped {now.dropped}" if now.dropped else "",
            f"mistakes {now.errors}" if now.errors else "",
        ]
        return "  ".join(word for word in words if word)

    def joined() -> Wire:
        stack.enter_context(bridge)
        peers = f", peers {' '.join(reach.peers)}" if reach.peers else ""
        where = f"domain {reach.domain}, {reach.range}{peers}, {settings.distro}"
        if not reach.is_open and not all(endpoint.is_local for endpoint in bridge.endpoints()):
            err(
                "ROS 2: DDS looks for nodes on this machine alone, but it listens on the network, too: "
                "a machine that names this one as its peer can move the cell; cure: a firewall"
            )
        return Wire(f"ROS 2: node {settings.node} ({where})", status, bridge.endpoints())

    return joined


def check_domain(ros2: bool, domain: int | None) -> None:
    """Check that --domain is used with --ros2.

    Raises:
        InputError: --domain without --ros2.
    """
    if domain is not None and not ros2:
        raise InputError("--domain means nothing here", cure="it goes with --ros2")
