"""Request guard of a web page: `PageGuard` decides which requests the page answers.

Every HTTP and websocket request passes the guard first. A page can move arms and write files, and every page
that is open in the same browser can send requests to it. Three checks reject requests from such pages, from
other users of the machine and from the network:

- Host: accept only host names that belong to this page, so that a foreign name that resolves to this
  address (DNS rebinding) gets no content.
- Origin: only the page itself may open its websocket.
- Secret: the printed URL carries a token that changes at every start. A request with the token gets a
  cookie, and all further requests need the cookie. Browsers send cookies to every port of a host, but only
  below the cookie's path. The path is random, so that a server on another port of this host never receives
  the cookie.
"""

from __future__ import annotations

import hmac
import ipaddress
import logging
import re
import secrets
from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qs

from armcell.core import InputError
from armcell.core.network_endpoints import host_in_url

if TYPE_CHECKING:
    from websockets.asyncio.server import ServerConnection
    from websockets.http11 import Request, Response

    Process = Callable[[ServerConnection, Request], Any]

logger = logging.getLogger(__name__)

MAX_CLIENTS = 16
"""Maximum number of browsers on one page; further browsers get a 503 response."""
MAX_CONNECTIONS = 64
"""Maximum number of connections to one page, including idle connections."""
MAX_MESSAGE = 4 << 20
"""Maximum size [bytes] of one message from a browser; a larger message closes the connection."""
MAX_TOLD = 20
"""Maximum number of different rejections that are logged, so that an attacker cannot fill the log."""
COOKIE = "armcell"
HERE = ("localhost", "127.0.0.1", "::1")
"""Host names of this machine that DNS rebinding cannot affect."""
TIDY = b"<script>history.replaceState = () => {}</script>"
"""Script that keeps viser's page from adding its websocket address to the URL."""
_HOST = re.compile(r"(\[[0-9a-f:.]+\]|[a-z0-9._-]+)(:[0-9]{1,5})?")

HOW = "Open the URL that the armcell command printed when it started; it ends in ?token=...\n"
NO_TOKEN = f"This page needs its token.\n{HOW}"
WRONG_TOKEN = f"This is not the token of this page: every start of a command has a new one.\n{HOW}"
OTHER_HOST = f"This page is not served under this name.\n{HOW}Permit further names with --allow-host NAME.\n"
OTHER_ORIGIN = "Another page asked for this, and only the page itself may.\n"
STARTING = "armcell is starting; this page opens by itself.\n"
FULL = f"{MAX_CLIENTS} browsers show this page already; close one of them.\n"


class PageGuard:
    """Access guard of a web page. It stores the secrets of the page and accepts or rejects each request.

    The guard fails closed: it rejects requests that it cannot parse.

    Args:
        host: the address that the page listens on.
        names: additional host names under which browsers may request the page, e.g. behind a proxy.
    Raises:
        InputError: a name is not a valid host name.
    """

    def __init__(self, host: str, names: Iterable[str] = ()):
        self.token = secrets.token_urlsafe(32)
        self._cookie = secrets.token_urlsafe(32)
        self._path = f"/{secrets.token_urlsafe(12)}"
        self._names = {*HERE, host.lower()} - {"", "0.0.0.0", "::"}
        for name in names:
            plain = name.lower().strip("[]")
            if _name_of(name.lower()) != plain:
                raise InputError(f"{name!r} is not a host name", hint="e.g. cell.example.org, without a port")
            self._names.add(plain)
        self._clients: set[Any] = set()
        self._told: set[tuple[str, str]] = set()
        self._open = False

    def open(self) -> None:
        """Open the web page to requests that pass the guard's checks of host, origin and token.

        Before this call, requests with the token get a "starting" page.
        """
        self._open = True

    def wrap_request_handler(self, serve: Process) -> Process:
        """Wrap a `process_request` function of `websockets` so that the
        guard of the web page checks each request first.
        """

        def process(connection: ServerConnection, request: Request) -> Any:
            return self._process(serve, connection, request)

        return process

    def _process(self, serve: Process, connection: ServerConnection, request: Request) -> Any:
        from websockets.http11 import Request

        headers = request.headers
        hosts, origins = headers.get_all("Host"), headers.get_all("Origin")
        path, _, query = request.path.partition("?")
        host = hosts[0].lower() if len(hosts) == 1 else ""
        if not self._is_ours(host, connection.local_address):
            return self._refuse(OTHER_HOST, "Host", hosts)
        if origins and origins not in ([f"http://{host}"], [f"https://{host}"]):
            return self._refuse(OTHER_ORIGIN, "Origin", origins)
        tokens = parse_qs(query).get("token", [])
        inside = path == self._path or path.startswith(f"{self._path}/")
        if tokens:
            if not _same(tokens[0], self.token):
                return self._refuse(WRONG_TOKEN)
        elif not (inside and any(_same(c, self._cookie) for c in _cookies(headers.get_all("Cookie")))):
            return self._refuse(NO_TOKEN)
        if not self._open:
            return _response(503, STARTING, {"Retry-After": "1", "Refresh": "1"})
        if headers.get_all("Upgrade"):
            return self._admit(connection)
        if query or path == self._path or not inside:
            # Drop the query, because it could make the client connect to another server and run scripts from
            # there. Answer with a page that forwards, not with a redirect: after a redirect, a browser that
            # followed a link from another site does not send a SameSite=Strict cookie.
            cookie = f"{COOKIE}={self._cookie}; Path={self._path}; HttpOnly; SameSite=Strict"
            more = {"Refresh": f"0; url={self._path}/", **({"Set-Cookie": cookie} if tokens else {})}
            return _response(200, "Opening the page ...\n", more)
        plain = headers.copy()
        if "Accept-Encoding" in plain:  # the response is edited below, so it must not be compressed
            del plain["Accept-Encoding"]
        answer = serve(connection, Request(path.removeprefix(self._path), plain))
        if answer is None:
            return _response(400, "Not a request for a page.\n", {})
        answer.body = answer.body.replace(b"<head>", b"<head>" + TIDY, 1)
        del answer.headers["Content-Length"]
        answer.headers["Content-Length"] = str(len(answer.body))
        _harden(answer.headers, host)
        return answer

    def _admit(self, connection: ServerConnection) -> Response | None:
        """Accept a new websocket of the web page by returning None. If too many browsers are connected,
        return a 503 response instead.
        """
        from websockets.protocol import State

        self._clients = {c for c in self._clients if c.state is not State.CLOSED}
        if len(self._clients) >= MAX_CLIENTS:
            logger.warning("page: a browser was turned away: %d show it already", MAX_CLIENTS)
            return _response(503, FULL, {})
        self._clients.add(connection)
        return None

    def _is_ours(self, host: str, local: Any) -> bool:
        name = _name_of(host)
        if name in self._names:
            return True
        try:  # for 0.0.0.0 and ::, use the address to which this browser connected
            mine = ipaddress.ip_address(str(local[0]).partition("%")[0])
            return ipaddress.ip_address(name) in (mine, getattr(mine, "ipv4_mapped", None))
        except (ValueError, TypeError, IndexError):
            return False

    def _refuse(self, text: str, header: str = "", values: Sequence[str] = ()) -> Response:
        """Return the 403 response to a rejected request for a web page.
        Each foreign host or origin is logged only once.
        """
        said = (header, ", ".join(values)[:100])
        if header and said not in self._told and len(self._told) < MAX_TOLD:
            self._told.add(said)
            logger.warning("page: refused a request with %s %r", *said)
        return _response(403, text, {})


def page_url(host: str, port: int, token: str) -> str:
    """Return the URL, including the access token, that opens the protected web page in a browser on this
    machine.
    """
    host = {"": "127.0.0.1", "0.0.0.0": "127.0.0.1", "::": "::1"}.get(host, host)
    return f"http://{host_in_url(host)}:{port}/?token={token}"


def _name_of(host: str) -> str:
    """Return the host name or address in the Host header of a page request, without the port. If the header
    is malformed, the text is empty.
    """
    match = _HOST.fullmatch(host)
    return match[1].strip("[]") if match else ""


def _cookies(headers: Sequence[str]) -> list[str]:
    pairs = (pair.strip().partition("=") for header in headers for pair in header.split(";"))
    return [value for name, _, value in pairs if name == COOKIE]


def _same(given: str, secret: str) -> bool:
    """Compare a text from a page request with a secret in constant time, so that timing does not reveal the
    secret.
    """
    return hmac.compare_digest(given.encode("utf-8", "surrogatepass"), secret.encode())


def _response(status: int, text: str, more: dict[str, str]) -> Response:
    from http import HTTPStatus

    from websockets.datastructures import Headers
    from websockets.http11 import Response

    body = text.encode()
    headers = Headers({"Content-Type": "text/plain; charset=utf-8", "Content-Length": str(len(body)), **more})
    _harden(headers, "")
    return Response(status, HTTPStatus(status).phrase, headers, body)


def _harden(headers: Any, host: str) -> None:
    """Add HTTP headers to the response of a page.
    They forbid framing, connections to other hosts, and referrers.
    """
    own = f"ws://{host} wss://{host}" if host else ""
    headers["Content-Security-Policy"] = (
        f"frame-ancestors 'none'; connect-src 'self' blob: data: {own}; base-uri 'none'; "
        "form-action 'none'; object-src 'none'"
    )
    headers["X-Frame-Options"] = "DENY"
    headers["Cross-Origin-Resource-Policy"] = "same-origin"
    headers["Cross-Origin-Opener-Policy"] = "same-origin"
    headers["Referrer-Policy"] = "no-referrer"
    headers["X-Content-Type-Options"] = "nosniff"
    headers["Cache-Control"] = "no-store"
