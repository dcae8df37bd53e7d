"""Plain clients of a page: HTTP requests and websockets with any header. For tests only."""

from __future__ import annotations

import http.client
import socket
import time
from collections.abc import Mapping
from contextlib import contextmanager
from typing import Any, NamedTuple
from urllib.parse import urlsplit

import msgspec.msgpack
import viser
import zstandard
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

CAMERA = {
    "type": "ViewerCameraMessage", "wxyz": [1.0, 0.0, 0.0, 0.0], "position": [1.0, 1.0, 1.0], "fov": 0.8,
    "near": 0.01, "far": 100.0, "look_at": [0.0, 0.0, 0.0], "up_direction": [0.0, 0.0, 1.0],
    "image_height": 480, "image_width": 640,
}  # fmt: skip


class Answer(NamedTuple):
    status: int
    headers: Mapping[str, str]
    text: str


class Login(NamedTuple):
    """What a browser has after it opened the printed URL."""

    host: str  # with port
    path: str
    cookie: str

    @property
    def origin(self) -> str:
        return f"http://{self.host}"


def get(url: str, path: str | None = None, **headers: str) -> Answer:
    """One GET at the server of a URL; `Host` and every other header may be chosen."""
    parts = urlsplit(url)
    connection = http.client.HTTPConnection(parts.hostname or "", parts.port, timeout=10)
    try:
        target = path if path is not None else f"{parts.path or '/'}{'?' if parts.query else ''}{parts.query}"
        connection.request("GET", target, headers=headers)
        answer = connection.getresponse()
        return Answer(answer.status, dict(answer.headers), answer.read().decode("utf-8", "replace"))
    finally:
        connection.close()


def login(url: str) -> Login:
    """Open the printed URL as a browser does."""
    answer = get(url)
    assert answer.status == 200, answer
    path = answer.headers["Refresh"].partition("url=")[2]
    return Login(urlsplit(url).netloc, path, answer.headers["Set-Cookie"].partition(";")[0])


@contextmanager
def websocket(url: str, login: Login | None = None, path: str | None = None, **headers: str):
    """A websocket as viser's page opens it; `headers` replace those that a browser would send."""
    parts = urlsplit(url)
    query = f"?{parts.query}" if parts.query else ""
    given = {"Cookie": login.cookie, "Origin": login.origin} if login else {}
    given |= headers
    origin = given.pop("Origin", None)
    where = path if path is not None else (login.path.rstrip("/") if login else f"/{query}")
    host = given.pop("Host", None)
    # The connection goes to the server, whatever name the request gives it.
    sock = socket.create_connection((parts.hostname, parts.port), timeout=10)
    sock.settimeout(None)
    version = f"viser-v{viser.__version__}"
    with connect(
        f"ws://{host or parts.netloc}{where}", sock=sock, origin=origin, subprotocols=[version],
        additional_headers=given, compression=None, max_size=None, proxy=None, open_timeout=10,
    ) as link:  # fmt: skip
        send(link, CAMERA)  # a browser says where it looks from; viser hears no button before
        yield link


def refusal(url: str, login: Login | None = None, path: str | None = None, **headers: str) -> int:
    """The status with which a websocket is refused; 101 where it is opened."""
    try:
        with websocket(url, login, path, **headers):
            return 101
    except InvalidStatus as error:
        return error.response.status_code


def press(link: ClientConnection, button: Any) -> None:
    """What the page sends when a button is clicked."""
    change(link, button._impl.uuid, True)


def change(link: ClientConnection, uuid: str, value: Any) -> None:
    """What the page sends when a widget is used."""
    send(link, {"type": "GuiUpdateMessage", "uuid": uuid, "updates": {"value": value}})


def send(link: ClientConnection, message: dict[str, Any]) -> None:
    link.send(msgspec.msgpack.encode(message))


def closed(link: ClientConnection, timeout: float = 10.0) -> bool:
    """Whether the server ends a connection within a time [s]."""
    end = time.monotonic() + timeout
    try:
        while time.monotonic() < end:
            link.recv(timeout=0.2)
    except TimeoutError:
        return closed(link, end - time.monotonic()) if time.monotonic() < end else False
    except ConnectionClosed:
        return True
    return False


def heard(link: ClientConnection, timeout: float = 60.0):
    """The messages that a page is sent, as dictionaries, as they come."""
    end = time.monotonic() + timeout
    while (left := end - time.monotonic()) > 0:
        frame = link.recv(timeout=left)
        assert isinstance(frame, bytes)
        size = int.from_bytes(frame[8:16], "little")
        packed = zstandard.ZstdDecompressor().decompress(frame[16 : 16 + size])
        yield from msgspec.msgpack.decode(packed)["messages"]
    raise TimeoutError("the page did not say it")


def widgets(link: ClientConnection, *labels: str) -> dict[str, str]:
    """The ids of some widgets of a page, by label."""
    found: dict[str, str] = {}
    for message in heard(link):
        label = (message.get("props") or {}).get("label")
        if label in labels and "uuid" in message:
            found[label] = message["uuid"]
        if len(found) == len(labels):
            break
    return found


def wait_for(link: ClientConnection, text: str, timeout: float = 60.0) -> None:
    """Until the page shows a text."""
    for message in heard(link, timeout):
        if text in str(message):
            return
