"""`PageGuard`: who may use a page. Every request of a browser, HTTP or websocket, passes it first.

A page can move arms and write files, and any page that is open in the same browser can send requests to it.
Three checks keep those out, and other users of the machine and of the network too:

- Host: only names that belong to this page, so that a foreign name that is made to point here (DNS
  rebinding) gets nothing.
- Origin: only the page itself may open its websocket.
- A secret: the printed URL carries a token that is new at every start. A request with the token gets a
  cookie, and everything else of the page asks for this cookie. Browsers send cookies to every port of a
  host, but only below the cookie's path. The path is random, too, so that a server on another port of this
  host never receives the cookie.
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
from armcell.core.endpoints import host_in_url

if TYPE_CHECKING:
    from websockets.asyncio.server import ServerConnection
    from websockets.http11 import Request, Response

    Process = Callable[[ServerConnection, Request], Any]

logger = logging.getLogger(__name__)

MAX_CLIENTS = 16
"""Browsers on one page; a further one is answered 503."""
MAX_CONNECTIONS = 64
"""Connections to one page, those included that have not asked for anything yet."""
MAX_MESSAGE = 4 << 20
"""[bytes] of one message from a browser; a larger one ends its connection."""
MAX_TOLD = 20
"""Refusals of different kinds that are logged; an attacker must not fill the log."""
COOKIE = "armcell"
HERE = ("localhost", "127.0.0.1", "::1")
"""Always this machine: browsers resolve `localhost` themselves, and an address cannot be rebound."""
TIDY = b"<script>history.replaceState = () => {}</script>"
"""viser's page adds the address of its websocket to the URL where that has a path."""
_HOST = re.compile(r"(\[[0-9a-f:.]+\]|[a-z0-9._-]+)(:[0-9]{1,5})?")

HOW = "Open the URL that the armcell command printed when it started; it ends in ?token=...\n"
NO_TOKEN = f"This page needs its token.\n{HOW}"
WRONG_TOKEN = f"This is not the token of this page: every start of a command has a new one.\n{HOW}"
OTHER_HOST = f"This page is not served under this name.\n{HOW}Permit further names with --allow-host NAME.\n"
OTHER_ORIGIN = "Another page asked for this, and only the page itself may.\n"
STARTING = "armcell is starting; this page opens by itself.\n"
FULL = f"{MAX_CLIENTS} browsers show this page already; close one of them.\n"


class PageGuard:
    """The secrets of one page, and the decision on each request.

    Fails closed: it refuses requests that it does not understand.

    Args:
        host: the address that the page listens on.
        names: further host names under which browsers may ask, for instance behind a proxy.
    Raises:
        InputError: a name is not a host name.
    """

    def __init__(self, host: str, names: Iterable[str] = ()):
        self.token = secrets.token_urlsafe(32)
        self._cookie = secrets.token_urlsafe(32)
        self._path = f"/{secrets.token_urlsafe(12)}"
        self._names = {*HERE, host.lower()} - {"", "0.0.0.0", "::"}
        for name in names:
            plain = name.lower().strip("[]")
            if _name_of(name.lower()) != plain:
                raise InputError(f"{name!r} is not a host name", cure="e.g. cell.example.org, without a port")
            self._names.add(plain)
        self._clients: set[Any] = set()
        self._told: set[tuple[str, str]] = set()
        self._open = False

    def open(self) -> None:
        """Answer from now on; until then those who have the token hear that the page is starting."""
        self._open = True

    def in_front_of(self, serve: Process) -> Process:
        """A `process_request` for `websockets` that hands on what may pass."""

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
            # A query could have the client connect to another server and run scripts from there. This is a
            # page that leads on and no redirection: after one, a browser that came here by a link on
            # another site does not send a strict cookie.
            cookie = f"{COOKIE}={self._cookie}; Path={self._path}; HttpOnly; SameSite=Strict"
            more = {"Refresh": f"0; url={self._path}/", **({"Set-Cookie": cookie} if tokens else {})}
            return _response(200, "Opening the page ...\n", more)
        plain = headers.copy()
        if "Accept-Encoding" in plain:  # the answer is changed below, so it must not be compressed
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
        """None, which accepts a websocket, while there are not too many."""
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
        try:  # of 0.0.0.0 and ::, the address by which this browser came
            mine = ipaddress.ip_address(str(local[0]).partition("%")[0])
            return ipaddress.ip_address(name) in (mine, getattr(mine, "ipv4_mapped", None))
        except (ValueError, TypeError, IndexError):
            return False

    def _refuse(self, text: str, header: str = "", values: Sequence[str] = ()) -> Response:
        """403; foreign hosts and origins are logged, once each."""
        said = (header, ", ".join(values)[:100])
        if header and said not in self._told and len(self._told) < MAX_TOLD:
            self._told.add(said)
            logger.warning("page: refused a request with %s %r", *said)
        return _response(403, text, {})


def page_url(host: str, port: int, token: str) -> str:
    """Where to point a browser on this machine."""
    host = {"": "127.0.0.1", "0.0.0.0": "127.0.0.1", "::": "::1"}.get(host, host)
    return f"http://{host_in_url(host)}:{port}/?token={token}"


def _name_of(host: str) -> str:
    """The name or address in a Host header, without port and brackets; empty where it is malformed."""
    match = _HOST.fullmatch(host)
    return match[1].strip("[]") if match else ""


def _cookies(headers: Sequence[str]) -> list[str]:
    pairs = (pair.strip().partition("=") for header in headers for pair in header.split(";"))
    return [value for name, _, value in pairs if name == COOKIE]


def _same(given: str, secret: str) -> bool:
    """Compares in a time that does not depend on where the texts differ."""
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
    """No frames around the page, no connections to elsewhere, and no trace of its path elsewhere."""
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
