"""Non-blocking sockets of an emulated controller, in one thread, with fault injection."""

from __future__ import annotations

import contextlib
import selectors
import socket
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from armcell.core import ArmcellError
from armcell.core.network_endpoints import Endpoint, listen, reserve

BACKLOG = 8  # largest number of connections waiting to be accepted
MAX_BEHIND = 1 << 15  # unsent bytes per client above which state messages are skipped
MAX_WAITING = 1 << 20  # unsent bytes per client above which the client is disconnected


@dataclass
class NetworkFaults:
    """Faults injected into the network of an emulated controller. All times are on the monotonic clock."""

    frozen_until: float = 0.0  # no data is sent or received
    refused_until: float = 0.0  # new connections are closed
    delay: float = 0.0  # [s] delay of all sent data
    garbage: int = 0  # number of coming messages to replace by random bytes
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(0))

    @property
    def frozen(self) -> bool:
        return time.monotonic() < self.frozen_until

    @property
    def refusing(self) -> bool:
        return time.monotonic() < self.refused_until


class TcpConnection:
    """TCP connection in the network of an emulated controller, with buffers for received and unsent data."""

    def __init__(self, sock: socket.socket, network: Network):
        sock.setblocking(False)
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.socket, self._network, self.open = sock, network, True
        self.received = bytearray()
        self._out: list[tuple[float, bytes]] = []
        self._waiting = 0

    @property
    def is_lagging(self) -> bool:
        """Return whether a client in an emulated controller's network
        reads too slowly to receive every state.
        """
        return self._waiting > MAX_BEHIND

    def send(self, data: bytes) -> None:
        if self.open:
            if self._network.faults.garbage > 0:
                self._network.faults.garbage -= 1
                data = self._network.faults.rng.bytes(len(data))
            self._out.append((time.monotonic() + self._network.faults.delay, data))
            self._waiting += len(data)
            if self._waiting > MAX_WAITING:
                self.close()
            self.flush()

    def flush(self) -> None:
        if not self._out or self._network.faults.frozen:
            return
        now = time.monotonic()
        while self._out and self._out[0][0] <= now:
            due, data = self._out[0]
            try:
                sent = self.socket.send(data)
            except BlockingIOError:
                return
            except OSError:
                self.close()
                return
            self._waiting -= sent
            if sent < len(data):
                self._out[0] = (due, data[sent:])
                return
            self._out.pop(0)

    def read(self) -> None:
        """Read data from a network connection of an emulated controller.
        Close the connection if the client has closed it.
        """
        try:
            data = self.socket.recv(65536)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if data:
            self.received += data
        else:
            self.close()

    def close(self) -> None:
        if self.open:
            self.open = False
            self._network.forget(self)
            self.socket.close()


class Datagrams:
    """UDP socket of an emulated controller, which is read by polling and obeys the injected network faults.

    Attributes:
        loss: fraction of the datagrams, in both directions, that the fault "loss" drops.
    """

    def __init__(self, host: str, network: Network):
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind((host, 0))
        self.socket.setblocking(False)
        self._network, self.loss = network, 0.0
        self._out: list[tuple[float, bytes, tuple[str, int]]] = []

    def send(self, data: bytes, to: tuple[str, int]) -> None:
        faults = self._network.faults
        if faults.frozen or self._lost():
            return
        if faults.garbage > 0:
            faults.garbage -= 1
            data = faults.rng.bytes(len(data))
        if faults.delay:
            self._out.append((time.monotonic() + faults.delay, data, to))
        else:
            self._send(data, to)
        while self._out and self._out[0][0] <= time.monotonic():
            _, data, to = self._out.pop(0)
            self._send(data, to)

    def _send(self, data: bytes, to: tuple[str, int]) -> None:
        with contextlib.suppress(OSError):  # the client's socket is gone, or its buffer is full
            self.socket.sendto(data, to)

    def _lost(self) -> bool:
        return self.loss > 0.0 and bool(self._network.faults.rng.random() < self.loss)

    def receive(self, size: int) -> list[bytes]:
        """Return the UDP datagrams, of at most `size` bytes each, that an emulated controller has received
        from the network.
        """
        found = []
        while True:
            try:
                data = self.socket.recv(size)
            except OSError:
                return found
            if not self._network.faults.frozen and not self._lost():
                found.append(data)

    def close(self) -> None:
        self.socket.close()


class Network:
    """Network of one emulated controller: its listening ports and connections.

    Attributes:
        endpoints: endpoints of the listening ports.
    """

    def __init__(self, selector: selectors.BaseSelector):
        self.faults = NetworkFaults()
        self._selector = selector
        self._ports: dict[socket.socket, Callable[[], None]] = {}  # port -> accepting function
        self.endpoints: list[Endpoint] = []
        self.links: dict[TcpConnection, Callable[[TcpConnection], None] | None] = {}
        self._datagrams: list[Datagrams] = []

    def listen(
        self,
        host: str,
        port: int,
        begin: Callable[[TcpConnection], None],
        on_data: Callable[[TcpConnection], None],
        service: str,
    ) -> int:
        """Reserve a network port of an emulated controller and return its number.
        Connections are accepted once `open` is called.

        Args:
            begin: called with each new connection.
            on_data: called after data has arrived on a connection.
            service: name of the service, for messages.
        Raises:
            ArmcellError: the port is in use, or the address does not belong to this machine.
        """
        try:
            sock = reserve(host, port)
        except OSError as error:
            raise ArmcellError(
                f"{host}:{port} cannot be served: {error.strerror} (another emulator or robot program "
                "uses it, or the address is not this machine's: choose another --host, such as 127.0.0.3)"
            ) from None
        sock.setblocking(False)

        def accept() -> None:
            try:
                connection, _ = sock.accept()
            except OSError:
                return
            if self.faults.refusing:
                connection.close()
                return
            link = TcpConnection(connection, self)
            self._add(link, on_data)
            begin(link)

        self._ports[sock] = accept
        self.endpoints.append(Endpoint.of(sock, service))
        return self.endpoints[-1].port

    def datagrams(self, host: str, service: str) -> Datagrams:
        """Open a UDP socket in the network of an emulated controller. `service`
        is the name of the socket in messages to the user.
        """
        self._datagrams.append(Datagrams(host, self))
        self.endpoints.append(Endpoint.of(self._datagrams[-1].socket, service))
        return self._datagrams[-1]

    def open(self) -> None:
        """Start accepting network connections on all ports that the emulated controller has reserved."""
        for sock, accept in self._ports.items():
            listen(sock, BACKLOG)
            self._selector.register(sock, selectors.EVENT_READ, accept)

    def connect(self, host: str, port: int) -> TcpConnection | None:
        """Open an outgoing TCP connection in the network of an emulated controller. Return None if the host
        does not answer.
        """
        try:
            sock = socket.create_connection((host, port), timeout=0.05)
        except OSError:
            return None
        link = TcpConnection(sock, self)
        self._add(link, None)
        return link

    def _add(self, link: TcpConnection, on_data: Callable[[TcpConnection], None] | None) -> None:
        self.links[link] = on_data

        def ready() -> None:
            if self.faults.frozen:
                return
            link.read()
            if on_data is not None and link.received:
                on_data(link)

        self._selector.register(link.socket, selectors.EVENT_READ, ready)

    def forget(self, link: TcpConnection) -> None:
        if self.links.pop(link, "gone") != "gone":
            self._selector.unregister(link.socket)

    def flush(self) -> None:
        for link in list(self.links):
            link.flush()

    def drop(self, seconds: float) -> None:
        """Close all network connections of the emulated controller, and refuse new ones for a time [s]."""
        self.faults.refused_until = time.monotonic() + seconds
        for link in list(self.links):
            link.close()

    def close(self) -> None:
        for link in list(self.links):
            link.close()
        for sock in self._ports:
            with contextlib.suppress(KeyError):  # never opened
                self._selector.unregister(sock)
            sock.close()
        for port in self._datagrams:
            port.close()
        self._ports.clear()
