"""Listening TCP socket with one thread per connection; `close` ends all of these threads."""

from __future__ import annotations

import contextlib
import errno
import logging
import socket
import threading
import time
from collections.abc import Callable

from armcell.core import InputError
from armcell.core.network_endpoints import Endpoint, listen, reserve

logger = logging.getLogger(__name__)
MAX_CONNECTIONS = 512
BACKLOG = 128  # connections that may wait for `accept`
JOIN_TIMEOUT = 3.0  # [s] for a thread to notice that its socket is closed

Handle = Callable[[socket.socket, str], bool]
"""Handles a connection in its own thread; returns True to keep the socket open."""


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
                logger.warning("%s: accept failed: %s", self._name, error)
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
                    logger.warning(
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
            logger.debug("%s: %s: %s", self._name, address, error)
        except Exception:
            logger.exception("%s: %s", self._name, address)
        finally:
            with self._lock:
                self._open.pop(threading.current_thread(), None)
            if not given_on:
                sock.close()


def shut_down_socket(sock: socket.socket) -> None:
    """Shut down a socket that another thread of a ROS 1 node reads. That thread then closes the socket."""
    with contextlib.suppress(OSError):
        sock.shutdown(socket.SHUT_RDWR)
