"""Start and stop of viser's server behind `PageGuard`, without output on stdout."""

from __future__ import annotations

import contextlib
import http.client
import logging
import socket
import sys
import threading
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from armcell.core import ArmcellError, InputError
from armcell.core.network_endpoints import Endpoint
from armcell.viewer.page_guard import MAX_CONNECTIONS, MAX_MESSAGE, PageGuard, page_url

if TYPE_CHECKING:
    import viser

logger = logging.getLogger(__name__)

PORTS_TRIED = 100
PROBE_S = 5.0  # [s] until the page must have rejected a request without a token
_starting = threading.Lock()


@dataclass(frozen=True)
class PageServer:
    """Web server for a browser page. It is a viser server whose requests are checked by a guard.

    Attributes:
        url: URL with the token; anyone who knows the URL can use the page.
        endpoints: sockets that the page listens on.
    """

    viser: viser.ViserServer
    guard: PageGuard
    url: str
    endpoints: tuple[Endpoint, ...]

    @property
    def port(self) -> int:
        return self.endpoints[0].port

    def open(self) -> None:
        """Start to serve the page to browsers through the viser server. Call this method after the page is
        built.
        """
        self.guard.open()

    def stop(self) -> None:
        """Disconnect all browsers, stop the viser server of the page and wait for its thread."""
        with _quiet_viser():
            self.viser.stop()


def start_page(host: str, port: int, label: str, names: Iterable[str] = ()) -> PageServer:
    """Start a viser server whose page shows a "starting" message until `open` is called.

    Args:
        host: address to listen on.
        port: first port to try; if it is in use, the next free port is taken.
        label: title of the panel.
        names: additional host names under which browsers may request the page.
    Raises:
        InputError: the host is not an address of this machine, no port is free, or a name is not a valid
            host name.
        ArmcellError: the guard does not work with the installed viser; the server is stopped.
    """
    import viser

    guard = PageGuard(host, names)
    with _guarding_viser(guard) as serving, _quiet_viser():
        server = viser.ViserServer(host=host, port=_free_port(host, port), label=label, verbose=False)
    try:
        endpoints = tuple(Endpoint.of(sock, "page") for each in serving for sock in each.server.sockets)
        if len(serving) != 1 or not endpoints:
            raise _unguarded("does not start its server as armcell expects")
        for endpoint in endpoints:
            _probe(endpoint)
        # Otherwise a browser could make viser open a tunnel that exposes the page to the internet.
        setattr(server, "request_share_url", lambda verbose=True: None)  # noqa: B010
        server.gui.configure_theme(show_logo=False, show_share_button=False, control_width="medium")
    except BaseException:
        with _quiet_viser():
            server.stop()
        raise
    if not all(endpoint.is_local for endpoint in endpoints):
        logger.warning(
            "the page is plain HTTP on %s: anyone who can read this network's traffic can read its token; "
            "use it in a trusted network, through SSH (ssh -L) or behind a proxy with TLS",
            ", ".join(str(endpoint) for endpoint in endpoints),
        )
    return PageServer(server, guard, page_url(host, endpoints[0].port, guard.token), endpoints)


def _free_port(host: str, port: int) -> int:
    """Return the first port, starting at `port`, to which the viser server can bind.

    viser itself would wait forever for an invalid host.

    Raises:
        InputError: the host is not an address of this machine, or none of `PORTS_TRIED` ports is free.
    """
    hint = "give an address of this machine and a port between 0 and 65535"
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
    except (OSError, OverflowError) as error:
        raise InputError(f"the viewer cannot listen on {host!r}, port {port}: {error}", hint=hint) from None
    problem: object = "no such port"
    for candidate in range(port, min(port + PORTS_TRIED, 65536)):
        with contextlib.closing(socket.socket(family, socket.SOCK_STREAM)) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind((host, candidate))
                return candidate
            except (OSError, OverflowError) as error:
                problem = error
    raise InputError(f"the viewer cannot listen on {host!r}, port {port}: {problem}", hint=hint)


# --- patches of viser, which has no hooks for the guard and for its console output ---
@contextlib.contextmanager
def _guarding_viser(guard: PageGuard) -> Iterator[list[Any]]:
    """Protect every page server that viser starts during a `with` block: a guard checks each request before
    viser handles it.

    Yields:
        List that receives the `websockets` server object.
    """
    import websockets.asyncio.server as websockets

    serving: list[Any] = []
    with _starting:
        real = websockets.serve

        def serve(*arguments: Any, **options: Any) -> Any:
            if not _from_viser():
                return real(*arguments, **options)
            process = options.pop("process_request", None)
            if process is None:  # do not raise here: viser's caller would wait for the thread forever
                process = lambda connection, request: None  # noqa: E731
            options |= {
                "process_request": guard.wrap_request_handler(process),
                "max_size": MAX_MESSAGE,
                "logger": _wire,
                "create_connection": _counted(),
            }
            started = real(*arguments, **options)
            serving[:] = [started]  # viser tries the next port if this port is in use
            return started

        setattr(websockets, "serve", serve)  # noqa: B010
        try:
            yield serving
        finally:
            setattr(websockets, "serve", real)  # noqa: B010


class _OneLine(logging.Filter):
    """Log filter of the page server that removes untrusted data and tracebacks from messages about malformed
    requests.
    """

    def filter(self, record: logging.LogRecord) -> bool:
        if record.exc_info:
            record.msg, record.args = f"page: {record.getMessage()}: {record.exc_info[1]!r}", ()
            record.exc_info = record.exc_text = None
        return "opening handshake failed" not in record.getMessage()


_wire = logging.getLogger(f"{__name__}.wire")
_wire.addFilter(_OneLine())


def _counted() -> Any:
    """Return the websocket class of the page server.
    If too many connections are open, a new one is closed at once.

    The limit applies with and without the token: idle connections would otherwise use up the file
    descriptors of a process that controls robots.
    """
    from websockets.asyncio.server import ServerConnection

    class Counted(ServerConnection):
        def connection_made(self, transport: Any) -> None:
            super().connection_made(transport)
            if len(self.server.handlers) > MAX_CONNECTIONS:
                transport.abort()

    return Counted


def _probe(endpoint: Endpoint) -> None:
    """Verify that the page server rejects a request that does not contain the token.

    The check guards against changes in the installed viser version.

    Raises:
        ArmcellError: the page answers the request.
    """
    host = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(endpoint.host, endpoint.host)
    websocket = {
        "Upgrade": "websocket", "Connection": "Upgrade", "Sec-WebSocket-Version": "13",
        "Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA==",
    }  # fmt: skip
    for headers in ({}, websocket):
        connection = http.client.HTTPConnection(host, endpoint.port, timeout=PROBE_S)
        try:
            connection.request("GET", "/", headers=headers)
            status = connection.getresponse().status
        except (OSError, http.client.HTTPException) as error:
            raise _unguarded(f"does not answer ({error!r})") from None
        finally:
            connection.close()
        if status != 403:
            raise _unguarded(f"answers {status} to a request without the token")


def _unguarded(why: str) -> ArmcellError:
    import viser

    return ArmcellError(
        f"viser {viser.__version__} {why}: armcell does not serve a page that it cannot guard "
        "(install the tested version: pip install viser==1.1.1)"
    )


def _from_viser(depth: int = 2) -> bool:
    """Return whether the function two levels up in the call stack belongs to viser.
    The page server redirects viser's output to the log.
    """
    return str(sys._getframe(depth).f_globals.get("__name__", "")).partition(".")[0] == "viser"


_printing = threading.Lock()


@contextlib.contextmanager
def _quiet_viser() -> Iterator[None]:
    """Redirect the output of viser's `rich.print` to the log during a `with` block.
    Output of other modules is printed as usual.

    viser announces its start and end on stdout even with `verbose=False`, and stdout belongs to the caller.
    """
    import rich

    with _printing:
        real = rich.print

        def routed(*objects: Any, **options: Any) -> None:
            if _from_viser():
                logger.debug("viser: %s", " ".join(str(o) for o in objects))
            else:
                real(*objects, **options)

        rich.print = routed
        try:
            yield
        finally:
            rich.print = real
