"""Joining a ROS 2 domain from the command line: options and the words of the status line."""

from __future__ import annotations

from contextlib import ExitStack
from typing import Any

import typer

from armcell.cli.console import err
from armcell.cli.ros1 import Wire
from armcell.core import InputError

ROS2 = typer.Option(
    False, "--ros2", help="Join a ROS 2 domain (extra ros2): ROS_DISTRO, ROS_AUTOMATIC_DISCOVERY_RANGE, ..."
)
DOMAIN = typer.Option(
    None, "--domain", min=0, max=232, show_default=False,
    help="With --ros2: the domain, instead of ROS_DOMAIN_ID.",
)  # fmt: skip


def join(stack: ExitStack, bus: Any, node: str, domain: int | None, bind: str | None = None) -> Wire:
    """Join a domain until the stack is closed.

    Args:
        bind: an address that is not this machine's own lets the network in.
    Raises:
        MissingExtraError: cyclonedds is not installed.
        InputError: an environment variable is wrong, the domain cannot be joined.
    """
    from armcell.ros import Ros2Bridge, Ros2Settings
    from armcell.ros.ros2 import from_environment

    reach = from_environment(domain, network=bind not in (None, "127.0.0.1", "localhost"))
    settings = Ros2Settings(reach, f"/{node}")
    bridge = stack.enter_context(Ros2Bridge(bus, settings))
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

    where = f"domain {reach.domain}, {reach.range}, {settings.distro}"
    return Wire(f"ROS 2: node {settings.node} ({where})", status)


def check_domain(ros2: bool, domain: int | None) -> None:
    """
    Raises:
        InputError: a domain without --ros2.
    """
    if domain is not None and not ros2:
        raise InputError("--domain means nothing here", cure="it goes with --ros2")
