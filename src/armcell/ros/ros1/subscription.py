"""A topic that a ROS 1 node subscribes to: reconnecting connections to its publishers."""

from __future__ import annotations

import contextlib
import itertools
import logging
import socket
import threading
from collections.abc import Callable
from concurrent.futures import Executor
from typing import Protocol

from armcell.core import ArmcellError, InputError
from armcell.ros.codec import WireError
from armcell.ros.faults import FaultCounter
from armcell.ros.ros1.publication import ANY
from armcell.ros.ros1.sockets import LENGTH, Fields, Reactor, encode_header, receive
from armcell.ros.ros1.xmlrpc import RpcError, call_method

logger = logging.getLogger(__name__)
RECEIVE_BYTES = 256 << 10
FIRST_RETRY, LAST_RETRY = 0.2, 5.0  # [s] first and longest delay between attempts; doubles each time


class Sink(Protocol):
    """Receiver of the messages from one publisher to which a ROS 1 node has subscribed."""

    def on_message(self, body: bytes) -> None:
        """Handle one serialized message that a publisher has sent to the ROS 1 subscription.

        Raises:
            WireError: the bytes are not a message of the topic's type.
        """
        ...

    def close(self) -> None: ...


class Subscription:
    """Subscription of a ROS 1 node to one topic.

    Args:
        type_name: message type; `*` accepts any.
        md5: MD5 sum of the message type; `*` accepts any.
        own_uri: address of this node, which is skipped among the publishers: the bus delivers those messages.
        open_sink: called with the publisher's connection header; returns the sink for the connection.
        max_message: maximum size of a message [bytes].
    """

    def __init__(
        self, topic: str, type_name: str, md5: str, text: str, caller: str, own_uri: str, reactor: Reactor,
        executor: Executor, open_sink: Callable[[Fields], Sink], timeout: float, max_message: int,
    ):  # fmt: skip
        self.topic, self.type, self.md5, self.text = topic, type_name, md5, text
        self.caller, self.reactor, self.timeout, self.max_message = caller, reactor, timeout, max_message
        self.open_sink = open_sink
        self._own_uri, self._executor = own_uri, executor
        self._lock = threading.Lock()
        self._links: dict[str, PublisherLink] = {}
        self._complaints = FaultCounter()
        self._closed = False

    def links(self) -> list[PublisherLink]:
        """Return the connections of a ROS 1 subscription to publishers, including those that are being
        established.
        """
        with self._lock:
            return list(self._links.values())

    def update(self, uris: list[str]) -> None:
        """Update a ROS 1 subscription from a list of publishers: connect to new publishers and disconnect
        from publishers no longer listed.
        """
        with self._lock:
            if self._closed:
                return
            gone = [link for uri, link in self._links.items() if uri not in uris]
            for link in gone:
                del self._links[link.uri]
            new = [
                PublisherLink(self, uri) for uri in uris if uri not in self._links and uri != self._own_uri
            ]
            self._links |= {link.uri: link for link in new}
        for link in gone:
            link.close()
        for link in new:
            self.connect(link)

    def connect(self, link: PublisherLink) -> None:
        """Connect a ROS 1 subscription to a publisher, in a thread of the executor."""
        if not self._closed:
            with contextlib.suppress(RuntimeError):  # the executor is shut down because the node is closing
                self._executor.submit(link.connect)

    def say_once(self, text: str) -> None:
        if self._complaints.count(text):
            logger.warning("%s: %s", self.topic, text)

    def close(self) -> None:
        with self._lock:
            self._closed = True
            links, self._links = list(self._links.values()), {}
        for link in links:
            link.close()


class PublisherLink:
    """Connection of a ROS 1 subscription to one publisher."""

    _numbers = itertools.count(1)

    def __init__(self, subscription: Subscription, uri: str):
        self.uri, self._of = uri, subscription
        self.number = next(self._numbers)
        self.sock: socket.socket  # exists once connected
        self.publisher = ""  # the other node's name
        self.received = self.received_bytes = 0
        self.connected = False
        self._sink: Sink | None = None
        self._lock = threading.Lock()
        self._closed = False
        self._retry = FIRST_RETRY
        self._buffer = bytearray()

    # --- in the executor ---
    def connect(self) -> None:
        """Connect to the TCPROS port of a publisher and exchange headers. If this fails, the subscription
        tries again.
        """
        if self._closed:
            return
        try:
            sock = self._opened()
            try:
                header = self._greeted(sock)
                sink = self._of.open_sink(header)
            except BaseException:
                sock.close()
                raise
        except (RpcError, WireError, InputError, OSError) as error:
            text = str(error) if isinstance(error, ArmcellError) else (error.strerror or str(error))
            self._of.say_once(f"no connection to the publisher at {self.uri}: {text[:300]}; trying on")
            self._again()
            return
        sock.setblocking(False)
        with self._lock:
            self.sock, self._sink, self._buffer = sock, sink, bytearray()
            self.publisher = header.get("callerid", "")
            self.connected, closed = not self._closed, self._closed
        if closed:
            sock.close()
            sink.close()
        else:
            self._of.reactor.add(self)

    def _opened(self) -> socket.socket:
        of = self._of
        chosen = call_method(self.uri, "requestTopic", of.caller, of.topic, [["TCPROS"]], timeout=of.timeout)
        if not (isinstance(chosen, list) and len(chosen) >= 3 and chosen[0] == "TCPROS"):
            raise WireError(f"it does not offer TCPROS but {str(chosen)[:100]}")
        _, host, port = chosen[:3]
        if not (isinstance(host, str) and isinstance(port, int) and 0 < port < 65536):
            raise WireError(f"{str(chosen)[:100]} is no address")
        return socket.create_connection((host, port), timeout=of.timeout)

    def _greeted(self, sock: socket.socket) -> Fields:
        of = self._of
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        fields = {
            "callerid": of.caller, "topic": of.topic, "type": of.type, "md5sum": of.md5,
            "message_definition": of.text, "tcp_nodelay": "1",
        }  # fmt: skip
        sock.sendall(encode_header(fields))
        header = receive(sock)
        if "error" in header:
            raise WireError(f"it refuses: {header['error']}")
        for name in ("type", "md5sum"):
            if name not in header:
                raise WireError(f"its header has no {name}")
        if of.md5 not in (ANY, header["md5sum"]):
            raise WireError(
                f"it publishes {header['type']} ({header['md5sum']}), {of.type} ({of.md5}) was expected"
            )
        return header

    def _again(self) -> None:
        if not self._closed:
            self._of.reactor.later(self._retry, lambda: self._of.connect(self))
            self._retry = min(2 * self._retry, LAST_RETRY)

    # --- in the reactor ---
    def on_readable(self) -> None:
        try:
            data = self.sock.recv(RECEIVE_BYTES)
        except BlockingIOError:
            return
        if not data:
            raise ConnectionError("the publisher closed the connection")
        self._retry = FIRST_RETRY
        self.received_bytes += len(data)
        buffer = self._buffer
        buffer += data
        at = 0
        while len(buffer) - at >= 4:
            (size,) = LENGTH.unpack_from(buffer, at)
            if size > self._of.max_message:
                self._of.say_once(f"{self.uri} announces a message of {size} bytes: connection closed")
                raise ConnectionError("a message is too long")
            if len(buffer) - at - 4 < size:
                break
            self._take(bytes(memoryview(buffer)[at + 4 : at + 4 + size]))
            at += 4 + size
        if at:
            del buffer[:at]

    def _take(self, body: bytes) -> None:
        assert self._sink is not None
        try:
            self._sink.on_message(body)
            self.received += 1
        except ArmcellError as error:
            self._of.say_once(f"from {self.uri}: {error}")

    def on_writable(self) -> bool:
        return False

    def on_closed(self, reason: str) -> None:
        with self._lock:
            self.connected, sink, self._sink = False, self._sink, None
        if sink is not None:
            sink.close()
        logger.debug("%s: publisher %s: %s", self._of.topic, self.uri, reason)
        self._again()

    def close(self) -> None:
        """Close the connection of a ROS 1 subscription to a publisher. Any thread may call this method."""
        with self._lock:
            self._closed = True
            connected = self.connected
        if connected:
            self._of.reactor.drop(self)
