"""ROS 1 services over TCPROS: server and client.

A request is `u32 length | bytes`. A response has the same form with one byte before it: 1 for success, or 0
followed by a text with the reason of the failure. With `persistent=1` in the header the connection stays
open for more calls.
"""

from __future__ import annotations

import contextlib
import logging
import socket
import threading
from collections.abc import Callable
from typing import Any

from armcell.core import ArmcellError, InputError
from armcell.ros.bus import ServiceError
from armcell.ros.codec import WireError, ros1_codec
from armcell.ros.ros1.publication import ANY
from armcell.ros.ros1.settings import host_and_port
from armcell.ros.ros1.sockets import LENGTH, Fields, encode_header, read_exactly, receive, shut_down_socket
from armcell.ros.schema import Schema

logger = logging.getLogger(__name__)
TRUE = ("1", "true")

Answerer = Callable[[Any], Any]


class ServedService:
    """Service that a ROS 1 node offers to other nodes over TCPROS.

    Args:
        answer: called with the request message, returns the response message; raises ServiceError to report
            why the request failed.
        most: maximum size of a request [bytes].
    """

    def __init__(self, name: str, type_name: str, schema: Schema, caller: str, answer: Answerer, most: int):
        self.name, self.type, self.md5 = name, type_name, schema.md5(type_name)
        self._caller, self._answer, self._codec, self._most = caller, answer, ros1_codec(schema), most
        self.calls = 0

    def refusal(self, header: Fields) -> str | None:
        """Return why a ROS 1 service refuses a client, in the wording of roscpp and rospy, or None if the
        service accepts the client.
        """
        md5 = header["md5sum"]
        if md5 in (ANY, self.md5):
            return None
        return f"request from [{header['callerid']}]: md5sums do not match: [{md5}] vs. [{self.md5}]"

    def handle(self, sock: socket.socket, header: Fields) -> None:
        """Answer the service calls of a ROS 1 client until it disconnects. A connection that is not
        persistent ends after one call.
        """
        fields = {
            "callerid": self._caller, "service": self.name, "md5sum": self.md5, "type": self.type,
            "request_type": f"{self.type}Request", "response_type": f"{self.type}Response",
        }  # fmt: skip
        sock.sendall(encode_header(fields))
        if header.get("probe") == "1":
            return
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        sock.settimeout(None)
        persistent = header.get("persistent", "0").lower() in TRUE
        while True:
            (size,) = LENGTH.unpack(read_exactly(sock, 4))
            if size > self._most:
                sock.sendall(_refused(f"a request of {size} bytes"))
                return
            sock.sendall(self._answered(read_exactly(sock, size)))
            if not persistent:
                return

    def _answered(self, body: bytes) -> bytes:
        self.calls += 1
        try:
            request = self._codec.decode(f"{self.type}Request", body)
            response = self._codec.encode(self._answer(request))
        except ServiceError as error:
            return _refused(f"service cannot process request: {error}")
        except ArmcellError as error:
            return _refused(f"error processing request: {error}")
        return b"\1" + LENGTH.pack(len(response)) + response


def _refused(text: str) -> bytes:
    reason = text.encode()
    return b"\0" + LENGTH.pack(len(reason)) + reason


class ServiceClient:
    """Client for services of other ROS 1 nodes. `close` also ends calls that are in progress."""

    def __init__(self, caller: str, schema: Schema, timeout: float, most: int):
        self._caller, self._schema, self._timeout, self._most = caller, schema, timeout, most
        self._lock = threading.Lock()
        self._open: set[socket.socket] = set()
        self._closed = False

    def connect(self, name: str, uri: str, type_name: str, persistent: bool = False) -> Connection:
        """Connect to a service of another ROS 1 node.

        Raises:
            ServiceError: the service cannot be reached, or its type differs.
        """
        fields = {
            "callerid": self._caller, "service": name, "type": type_name,
            "md5sum": self._schema.md5(type_name), "persistent": "1" if persistent else "0",
        }  # fmt: skip
        sock, header = self._opened(name, uri, fields)
        return Connection(self, sock, name, type_name, self._schema, self._most, header)

    def probe(self, name: str, uri: str) -> str:
        """Connect to a ROS 1 service and return its type, which the connection header contains.

        Raises:
            ServiceError: the service cannot be reached, or its header contains no type.
        """
        fields = {"callerid": self._caller, "service": name, "md5sum": ANY, "probe": "1"}
        sock, header = self._opened(name, uri, fields)
        self.discard(sock)
        if "type" not in header:
            raise ServiceError(f"service {name} at {uri} does not say its type")
        return header["type"]

    def _opened(self, name: str, uri: str, fields: Fields) -> tuple[socket.socket, Fields]:
        try:
            sock = socket.create_connection(host_and_port(uri, "rosrpc"), timeout=self._timeout)
        except (OSError, InputError) as error:
            raise ServiceError(f"service {name} cannot be reached at {uri}: {error}") from None
        with self._lock:
            closed = self._closed
            self._open.add(sock)
        try:
            if closed:
                raise ServiceError(f"service {name}: the node is closed")
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            sock.sendall(encode_header(fields))
            header = receive(sock)
            if "error" in header:
                raise ServiceError(f"service {name} refuses: {header['error']}")
            return sock, header
        except (OSError, WireError) as error:
            self.discard(sock)
            raise ServiceError(f"service {name} at {uri}: {error}") from None
        except ServiceError:
            self.discard(sock)
            raise

    def discard(self, sock: socket.socket) -> None:
        with self._lock:
            self._open.discard(sock)
        sock.close()

    def close(self) -> None:
        with self._lock:
            self._closed = True
            for sock in self._open:
                shut_down_socket(sock)


class Connection:
    """Connection of a client to a ROS 1 service. It carries one call at a time."""

    def __init__(
        self,
        caller: ServiceClient,
        sock: socket.socket,
        name: str,
        type_name: str,
        schema: Schema,
        most: int,
        header: Fields,
    ):
        self._caller, self._sock, self._name, self._type = caller, sock, name, type_name
        self._codec, self._most = ros1_codec(schema), most
        self.header = header
        self._turn = threading.Lock()

    def call(self, request: Any) -> Any:
        """Call the ROS 1 service and return its response. The call waits without a time limit.

        Raises:
            ServiceError: the service reports a failure, or the connection broke.
        """
        body = self._codec.encode(request)
        with self._turn:
            try:
                self._sock.settimeout(None)
                self._sock.sendall(LENGTH.pack(len(body)) + body)
                ok = read_exactly(self._sock, 1)
                (size,) = LENGTH.unpack(read_exactly(self._sock, 4))
                if size > self._most:
                    raise ServiceError(f"service {self._name} announces an answer of {size} bytes")
                answer = read_exactly(self._sock, size)
            except OSError as error:
                raise ServiceError(f"service {self._name} gave no answer: {error}") from None
        if ok == b"\0":
            raise ServiceError(f"service {self._name}: {answer.decode(errors='replace')[:1000]}")
        try:
            return self._codec.decode(f"{self._type}Response", answer)
        except WireError as error:
            raise ServiceError(f"service {self._name}: {error}") from None

    def close(self) -> None:
        with contextlib.suppress(OSError):
            self._caller.discard(self._sock)

    def __enter__(self) -> Connection:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()
