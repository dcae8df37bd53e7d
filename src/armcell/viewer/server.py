"""Starting and stopping viser's server: on a free port, and without a word on stdout."""

from __future__ import annotations

import contextlib
import logging
import socket
import sys
import threading
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from armcell.core import InputError

if TYPE_CHECKING:
    import viser

logger = logging.getLogger(__name__)

PORTS_TRIED = 100
_printing = threading.Lock()


def free_port(host: str, port: int) -> int:
    """The first port from `port` on that can be bound (viser would wait for ever for a bad host).

    Raises:
        InputError: the host is no address of this machine, or none of `PORTS_TRIED` ports is free.
    """
    cure = "give an address of this machine and a port between 0 and 65535"
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
    except (OSError, OverflowError) as error:
        raise InputError(f"the viewer cannot listen on {host!r}, port {port}: {error}", cure=cure) from None
    problem: object = "no such port"
    for candidate in range(port, min(port + PORTS_TRIED, 65536)):
        with contextlib.closing(socket.socket(family, socket.SOCK_STREAM)) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind((host, candidate))
                return candidate
            except (OSError, OverflowError) as error:
                problem = error
    raise InputError(f"the viewer cannot listen on {host!r}, port {port}: {problem}", cure=cure)


def start_server(host: str, port: int, label: str) -> viser.ViserServer:
    """A running viser server, its theme set."""
    import viser

    with _viser_prints_to_log():
        server = viser.ViserServer(host=host, port=port, label=label, verbose=False)
    server.gui.configure_theme(show_logo=False, show_share_button=False, control_width="medium")
    return server


def stop_server(server: viser.ViserServer) -> None:
    """Stop a server and wait for its thread; clients are disconnected."""
    with _viser_prints_to_log():
        server.stop()


@contextlib.contextmanager
def _viser_prints_to_log() -> Iterator[None]:
    """While inside, what viser gives to `rich.print` is logged; that of others is printed as ever.

    viser announces its start and end on stdout even with `verbose=False`, and stdout is the caller's.
    """
    import rich

    with _printing:
        real = rich.print

        def routed(*objects: Any, **options: Any) -> None:
            if str(sys._getframe(1).f_globals.get("__name__", "")).startswith("viser"):
                logger.debug("viser: %s", " ".join(str(o) for o in objects))
            else:
                real(*objects, **options)

        rich.print = routed
        try:
            yield
        finally:
            rich.print = real
