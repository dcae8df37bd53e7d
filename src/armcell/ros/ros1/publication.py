"""A topic that a ROS 1 node publishes: subscriber connections and their send queues."""

from __future__ import annotations

import contextlib
import itertools
import logging
import socket
import threading
from collections import deque
from collections.abc import Callable
from typing import Any, Protocol

from armcell.core import InputError
from armcell.ros.codec import ros1_codec
from armcell.ros.definitions import field_parts
from armcell.ros.ros1.sockets import LENGTH, Fields, Reactor, encode_header
from armcell.ros.schema import Schema

logger = logging.getLogger(__name__)
ANY = "*"  # type and MD5 sum of a subscriber that accepts every type
UNSENT_BYTES = 128 << 10  # limit of unsent bytes in the kernel; further messages wait in the send queue


class Closable(Protocol):
    def close(self) -> None: ...


Attach = Callable[[Callable[[Any], None]], Closable]
"""Subscribes a function to every message of a topic; latched messages arrive immediately."""


class Publication:
    """Topic that a ROS 1 node publishes, with one connection to each subscriber.

    The publication attaches each subscriber connection separately, so that each one gets the latched
    messages.

    Args:
        attach: see `Attach`; the attached function runs in the publisher's thread and never blocks.
        latching: returns whether a publisher of the topic keeps its last message.
        queue: messages that may wait for one subscriber; a full queue drops its oldest message.
        queue_bytes: bytes that may wait for one subscriber.
    """

    def __init__(
        self, topic: str, type_name: str, schema: Schema, caller: str, reactor: Reactor,
        attach: Attach, latching: Callable[[], bool], queue: int, queue_bytes: int,
    ):  # fmt: skip
        self.topic, self.type, self.md5 = topic, type_name, schema.md5(type_name)
        self._text = schema.full_text(type_name)
        self._codec, self._caller, self._reactor = ros1_codec(schema), caller, reactor
        self._attach, self._latching = attach, latching
        self._queue, self._queue_bytes = queue, queue_bytes
        self._codec.prepare(type_name)
        fields = schema.definition(type_name).fields
        self._has_header = bool(fields) and field_parts(fields[0][1]) == (True, "std_msgs/Header", None)
        self._lock = threading.Lock()
        self._links: list[SubscriberLink] = []
        self._encoded: tuple[Any, bytes] | None = None
        self._seq = 0
        self._closed = False
        self.failed = 0  # messages that could not be encoded

    def links(self) -> list[SubscriberLink]:
        """Return the current connections of a published topic to its ROS 1 subscribers."""
        with self._lock:
            return list(self._links)

    def refusal(self, header: Fields) -> str | None:
        """Return why this topic rejects a ROS 1 subscriber, in the words of roscpp and rospy, or None if it
        accepts the subscriber.
        """
        md5, kind = header["md5sum"], header.get("type", self.type)
        if md5 in (ANY, self.md5):
            return None
        if kind not in (self.type, ANY):
            return f"topic types do not match: [{kind}] vs. [{self.type}]"
        return (
            f"Client [{header['callerid']}] wants topic [{self.topic}] to have datatype/md5sum "
            f"[{kind}/{md5}], but our version has [{self.type}/{self.md5}] Dropping connection."
        )

    def accept(self, sock: socket.socket, header: Fields, peer: str) -> None:
        """Accept a ROS 1 subscriber of a published topic, and start sending messages to it. The caller must
        first check the subscriber's connection header with `refusal`.
        """
        fields = {
            "callerid": self._caller, "topic": self.topic, "type": self.type, "md5sum": self.md5,
            "message_definition": self._text, "latching": "1" if self._latching() else "0",
        }  # fmt: skip
        sock.setblocking(False)
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)  # messages go out whole
        if hasattr(socket, "TCP_NOTSENT_LOWAT"):
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT, UNSENT_BYTES)
        link = SubscriberLink(
            sock, self, header["callerid"], peer, encode_header(fields), self._queue, self._queue_bytes
        )
        with self._lock:
            closed = self._closed
            if not closed:
                self._links.append(link)
        if closed:
            sock.close()
            return
        # Attach before the handshake answer: a subscriber that knows it is connected then misses no message.
        link.attachment = self._attach(lambda message: self._give(link, message))
        self._reactor.add(link)

    def _give(self, link: SubscriberLink, message: Any) -> None:
        try:
            frame = self._frame(message)
        except InputError as error:
            self.failed += 1
            if self.failed == 1:
                logger.warning("%s: %s", self.topic, error)
            return
        if link.put(frame):
            self._reactor.flush(link)

    def _frame(self, message: Any) -> bytes:
        """Encode a ROS 1 message with its length prefix.
        This happens only once for all subscribers of the published topic.

        If the message starts with a std_msgs/Header, its `seq` counts up.
        """
        have = self._encoded
        if have is not None and have[0] is message:
            return have[1]
        body = self._codec.encode(message)
        if self._has_header:
            self._seq = (self._seq + 1) & 0xFFFFFFFF
            frame = b"".join((LENGTH.pack(len(body)), LENGTH.pack(self._seq), body[4:]))
        else:
            frame = LENGTH.pack(len(body)) + bytes(body)
        self._encoded = (message, frame)
        return frame

    def forget(self, link: SubscriberLink) -> None:
        with self._lock:
            if link in self._links:
                self._links.remove(link)
            if not self._links:
                self._encoded = None

    def close(self) -> None:
        with self._lock:
            self._closed = True
            links = list(self._links)
        for link in links:
            self._reactor.drop(link)


class SubscriberLink:
    """Connection from a published topic to one ROS 1 subscriber.
    If its send queue is full, the oldest message is dropped.
    """

    _numbers = itertools.count(1)

    def __init__(
        self, sock: socket.socket, publication: Publication, caller: str, peer: str, greeting: bytes,
        most: int, most_bytes: int,
    ):  # fmt: skip
        self.sock, self.caller, self.peer = sock, caller, peer
        self.number = next(self._numbers)
        self.sent = -1  # messages sent; starts at -1 because the connection header is counted as well
        self.sent_bytes = self.dropped = 0
        self.closed = False
        self.attachment: Closable | None = None
        self._publication, self._most, self._most_bytes = publication, most, most_bytes
        self._lock = threading.Lock()
        self._waiting: deque[bytes] = deque()
        self._waiting_bytes = 0
        self._rest = memoryview(greeting)  # unsent remainder of a partly sent frame

    @property
    def waiting(self) -> bool:
        """Return whether bytes for a ROS 1 subscriber of the published topic are still unsent."""
        with self._lock:
            return bool(self._rest or self._waiting)

    def put(self, frame: bytes) -> bool:
        """Send a message to one ROS 1 subscriber of a topic, or queue the message. Return True if the reactor
        (the I/O thread) must send the rest.

        Any thread may call this method.
        """
        with self._lock:
            if self.closed:
                return False
            idle = not (self._rest or self._waiting)
            while self._waiting and (
                len(self._waiting) >= self._most or self._waiting_bytes + len(frame) > self._most_bytes
            ):
                self._waiting_bytes -= len(self._waiting.popleft())
                self.dropped += 1
            self._waiting.append(frame)
            self._waiting_bytes += len(frame)
            if not idle:
                return False  # the reactor is sending already
            with contextlib.suppress(OSError):  # the reactor gets the same error and ends the connection
                return self._send()
            return False

    def _send(self) -> bool:
        """Send the queued bytes of a published topic to a ROS 1 subscriber. Return True if bytes remain."""
        while self._rest or self._waiting:
            if not self._rest:
                frame = self._waiting.popleft()
                self._waiting_bytes -= len(frame)
                self._rest = memoryview(frame)
            try:
                count = self.sock.send(self._rest)
            except BlockingIOError:
                return True
            self.sent_bytes += count
            self._rest = self._rest[count:]
            if not self._rest:
                self.sent += 1
        return False

    def on_readable(self) -> None:
        """Detect whether a ROS 1 subscriber has closed its connection to the published topic."""
        with contextlib.suppress(BlockingIOError):
            if not self.sock.recv(4096):
                raise ConnectionError("the subscriber closed the connection")

    def on_writable(self) -> bool:
        with self._lock:
            return self._send()

    def on_closed(self, reason: str) -> None:
        with self._lock:
            self.closed = True
            self._waiting.clear()
            self._rest = memoryview(b"")
        if self.attachment is not None:
            self.attachment.close()
        self._publication.forget(self)
        logger.debug("%s: subscriber %s: %s", self._publication.topic, self.caller, reason)
