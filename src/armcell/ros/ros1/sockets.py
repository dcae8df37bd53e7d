"""Sockets of a ROS 1 node: a listener, one thread for all topics, and TCPROS connection headers.

Format: `u32 length`, then fields `u32 length | key=value`, all little-endian. Source: wiki.ros.org/ROS/TCPROS
and wiki.ros.org/ROS/Connection%20Header.

`close` of the listener ends all of its threads. The thread for topic connections (reactor) receives,
sends and runs timers.
"""

from __future__ import annotations

import contextlib
import errno
import heapq
import itertools
import logging
import selectors
import socket
import struct
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from typing import Protocol

from armcell.core import InputError
from armcell.core.network_endpoints import Endpoint, listen, reserve
from armcell.ros.codec import WireError

LENGTH = struct.Struct("<I")

MAX_HEADER = 1 << 20  # [bytes] headers contain the full text of a message definition

MAX_FIELDS = 64

Fields = dict[str, str]


def encode_header(fields: Mapping[str, str]) -> bytes:
    """Encode a TCPROS connection header as the bytes to send over a ROS 1 socket. The result includes the
    length prefix.
    """
    lines = [f"{key}={value}".encode() for key, value in sorted(fields.items())]
    body = b"".join(LENGTH.pack(len(line)) + line for line in lines)
    return LENGTH.pack(len(body)) + body


def decode_header(body: bytes) -> Fields:
    """Parse a TCPROS connection header that was read from a ROS 1 socket, without its length prefix, and
    return its fields.

    Raises:
        WireError: the bytes are not a valid header.
    """
    fields: Fields = {}
    at = count = 0
    while at < len(body):
        count += 1
        if at + 4 > len(body) or count > MAX_FIELDS:
            raise WireError("a connection header ends in the middle of a field, or has too many")
        (size,) = LENGTH.unpack_from(body, at)
        at += 4
        if size == 0 or at + size > len(body):
            raise WireError("a field of a connection header is longer than the header")
        try:
            key, equals, value = body[at : at + size].decode().partition("=")
        except UnicodeDecodeError:
            raise WireError("a connection header is no text") from None
        if not equals:
            raise WireError(f"a field of a connection header has no '=': {key[:60]!r}")
        fields[key.strip()] = value
        at += size
    return fields


def receive(sock: socket.socket) -> Fields:
    """Read a TCPROS connection header from a socket. The timeout of the socket applies to each read.

    Raises:
        WireError: the received bytes are not a valid header.
        OSError: the connection broke, or the timeout ran out.
    """
    (size,) = LENGTH.unpack(read_exactly(sock, 4))
    if size > MAX_HEADER:
        raise WireError(f"a connection header of {size} bytes")
    return decode_header(read_exactly(sock, size))


def read_exactly(sock: socket.socket, count: int) -> bytes:
    """Read exactly `count` bytes from a socket, for the header or the body of a TCPROS message.

    Raises:
        ConnectionError: the peer closed the connection before `count` bytes arrived.
    """
    parts = []
    while count > 0:
        part = sock.recv(min(count, 1 << 20))
        if not part:
            raise ConnectionError("the other side closed the connection")
        parts.append(part)
        count -= len(part)
    return b"".join(parts)


log = logging.getLogger(__name__)

MAX_CONNECTIONS = 512

BACKLOG = 128  # connections that may wait for `accept`

JOIN_TIMEOUT = 3.0  # [s] for a thread to notice that its socket is closed

Handle = Callable[[socket.socket, str], bool]

"""Handles a connection in its own thread; returns True to keep the socket open."""

Task = Callable[[], None]


class Listener:
    """Listening TCP socket for ROS 1 peers, which passes each connection to a handler.

    Args:
        port: port to listen on; 0 selects a free port.
        handle: called with each connected socket and the peer's address (`host:port`).
    """

    def __init__(
        self, host: str, port: int, handle: Handle, name: str, max_connections: int = MAX_CONNECTIONS
    ):
        self.address: tuple[str, int] = (host, port)
        self._handle, self._name, self._most = handle, name, max_connections
        self._socket: socket.socket | None = None
        self._lock = threading.Lock()
        self._open: dict[threading.Thread, socket.socket] = {}
        self._closing = False
        self._thread = threading.Thread(target=self._accept, name=f"{name} accept", daemon=True)
        self.refused = 0  # connections closed because `max_connections` were open

    def reserve(self) -> None:
        """Bind the port on which a ROS 1 node listens, without accepting connections yet.

        Raises:
            InputError: the address cannot be listened on.
        """
        try:
            self._socket = reserve(*self.address)
        except OSError as error:
            taken, reason = error.errno == errno.EADDRINUSE, str(error.strerror).split(" (")[0]
            raise InputError(
                f"cannot listen on {self.address[0]}:{self.address[1]} ({reason})",
                hint="another program has the port" if taken else "is it an address of this machine?",
            ) from None
        self.address = self._socket.getsockname()[:2]

    def start(self) -> None:
        """Start accepting connections on the listening TCP socket of a ROS 1 node.

        Raises:
            InputError: the address cannot be listened on.
        """
        if self._socket is None:
            self.reserve()
        assert self._socket is not None
        listen(self._socket, BACKLOG)
        self._thread.start()

    def close(self) -> None:
        """Stop listening for ROS 1 peers and close all accepted connections."""
        self._closing = True
        if self._socket is None:
            return
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()
        if self._thread is not threading.current_thread() and self._thread.ident is not None:
            self._thread.join(JOIN_TIMEOUT)
        with self._lock:
            threads = dict(self._open)
        for sock in threads.values():
            shut_down_socket(sock)
        for thread in threads:
            if thread is not threading.current_thread():
                thread.join(JOIN_TIMEOUT)

    def endpoint(self, service: str) -> Endpoint:
        """Return the address on which the ROS 1 listener accepts connections. It is valid after `start`."""
        assert self._socket is not None
        return Endpoint.of(self._socket, service)

    def _accept(self) -> None:
        assert self._socket is not None
        while not self._closing:
            try:
                sock, address = self._socket.accept()
            except OSError as error:
                if self._closing:
                    return
                log.warning("%s: accept failed: %s", self._name, error)
                time.sleep(0.1)  # if file descriptors ran out, an immediate retry would fail as well
                continue
            thread = threading.Thread(
                target=self._serve, args=(sock, f"{address[0]}:{address[1]}"),
                name=f"{self._name} connection", daemon=True,
            )  # fmt: skip
            with self._lock:
                full = len(self._open) >= self._most or self._closing
                if not full:
                    self._open[thread] = sock
            if full:
                self.refused += 1
                if self.refused == 1:
                    log.warning(
                        "%s: more than %d connections; further ones are closed", self._name, self._most
                    )
                sock.close()
            else:
                thread.start()

    def _serve(self, sock: socket.socket, address: str) -> None:
        given_on = False
        try:
            given_on = self._handle(sock, address)
        except OSError as error:
            log.debug("%s: %s: %s", self._name, address, error)
        except Exception:
            log.exception("%s: %s", self._name, address)
        finally:
            with self._lock:
                self._open.pop(threading.current_thread(), None)
            if not given_on:
                sock.close()


def shut_down_socket(sock: socket.socket) -> None:
    """Shut down a socket that another thread of a ROS 1 node reads. That thread then closes the socket."""
    with contextlib.suppress(OSError):
        sock.shutdown(socket.SHUT_RDWR)


class Channel(Protocol):
    """Non-blocking socket of a ROS 1 node, with handlers for the
    events that the event loop (reactor) reports.
    """

    sock: socket.socket

    def on_readable(self) -> None:
        """Read the data that has arrived at a socket of the reactor. Raise OSError when the connection is
        over.
        """
        ...

    def on_writable(self) -> bool:
        """Send the data that is queued for a socket of the reactor. Return True if unsent data remains.

        Raises:
            OSError: the connection is over.
        """
        ...

    def on_closed(self, reason: str) -> None:
        """Handle the end of a connection after the reactor has closed its socket."""
        ...


class Reactor:
    """Event loop for the sockets of a ROS 1 node. Any thread may add and drop sockets.

    Runs from `start` to `close`.
    """

    def __init__(self, name: str):
        self._selector = selectors.DefaultSelector()
        self._ear, self._bell = socket.socketpair()
        for end in (self._ear, self._bell):
            end.setblocking(False)
        self._selector.register(self._ear, selectors.EVENT_READ, None)
        self._tasks: deque[Task] = deque()
        self._timers: list[tuple[float, int, Task]] = []
        self._numbers = itertools.count()
        self._lock = threading.Lock()
        self._closing = False
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def start(self) -> None:
        self._thread.start()

    def close(self) -> None:
        """Close every connection of the reactor and end its thread."""
        with self._lock:
            self._closing = True
        self._ring()
        if self._thread.ident is not None:
            self._thread.join(5.0)

    # --- from any thread ---
    def add(self, channel: Channel) -> None:
        self._soon(lambda: self._register(channel))

    def drop(self, channel: Channel, reason: str = "closed") -> None:
        self._soon(lambda: self._end(channel, reason))

    def flush(self, channel: Channel) -> None:
        """Let the reactor call `writable` of a channel as soon as the channel's socket can send data."""
        self._soon(lambda: self._watch(channel, True))

    def later(self, delay: float, task: Task) -> None:
        """Let the reactor (the event loop of a ROS 1 node's sockets) run a task after a delay [s]."""
        at = time.monotonic() + delay
        self._soon(lambda: heapq.heappush(self._timers, (at, next(self._numbers), task)))

    def _soon(self, task: Task) -> None:
        with self._lock:
            self._tasks.append(task)
        self._ring()

    def _ring(self) -> None:
        with contextlib.suppress(BlockingIOError, OSError):  # a wake-up is pending, or the reactor is closed
            self._bell.send(b"\0")

    # --- in the reactor's thread ---
    def _run(self) -> None:
        while True:
            wait = max(self._timers[0][0] - time.monotonic(), 0.0) if self._timers else None
            for key, events in self._selector.select(wait):
                if key.data is None:
                    with contextlib.suppress(BlockingIOError):
                        self._ear.recv(4096)
                else:
                    self._serve(key.data, events)
            self._run_tasks()
            if self._closing:
                break
        for key in list(self._selector.get_map().values()):
            if key.data is not None:
                self._end(key.data, "closed")
        self._run_tasks()  # closes channels that were added in the meantime
        self._selector.close()
        self._ear.close()
        self._bell.close()

    def _run_tasks(self) -> None:
        while self._timers and self._timers[0][0] <= time.monotonic() and not self._closing:
            self._safely(heapq.heappop(self._timers)[2])
        while True:
            with self._lock:
                if not self._tasks:
                    return
                task = self._tasks.popleft()
            self._safely(task)

    def _safely(self, task: Task) -> None:
        try:
            task()
        except Exception:
            log.exception("a task failed")

    def _serve(self, channel: Channel, events: int) -> None:
        try:
            if events & selectors.EVENT_READ:
                channel.on_readable()
            if events & selectors.EVENT_WRITE and not channel.on_writable():
                self._watch(channel, False)
        except OSError as error:
            self._end(channel, error.strerror or str(error))
        except Exception as error:
            log.exception("a connection failed")
            self._end(channel, repr(error))

    def _register(self, channel: Channel) -> None:
        if self._closing:
            self._end(channel, "closed")
            return
        self._selector.register(channel.sock, selectors.EVENT_READ, channel)
        self._watch(channel, True)  # send messages that were queued before the registration

    def _watch(self, channel: Channel, write: bool) -> None:
        if channel.sock.fileno() >= 0 and channel.sock in self._selector.get_map():
            events = selectors.EVENT_READ | (selectors.EVENT_WRITE if write else 0)
            self._selector.modify(channel.sock, events, channel)

    def _end(self, channel: Channel, reason: str) -> None:
        if channel.sock.fileno() < 0:
            return  # ended already
        with contextlib.suppress(KeyError, ValueError):
            self._selector.unregister(channel.sock)
        channel.sock.close()
        channel.on_closed(reason)
