"""Output of the addresses on which a server listens, in one format for all servers."""

from __future__ import annotations

from collections.abc import Iterable

from rich.console import Console

from armcell.cli.console import console
from armcell.core.network_endpoints import Endpoint


def print_addresses(endpoints: Iterable[Endpoint], to: Console = console) -> None:
    """Print the addresses on which a command's server listens,
    e.g. `listening on tcp 127.0.0.1:10000 (ROS-TCP), ...`.
    """
    found = ", ".join(str(endpoint) for endpoint in endpoints)
    to.print(f"listening on {found or 'no port'}", markup=False, soft_wrap=True)
