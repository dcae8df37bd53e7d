"""ROS-TCP server: connects any number of Unity programs to one bus.

Each client has its own registrations, which end with its connection. Intended differences from the reference
endpoint: the server listens on 127.0.0.1 by default; frames have a maximum size; types come from the schema
and are never imported; a repeated registration keeps the latched message; every service call gets an answer;
a client's error is answered with `__error` and affects no other client.
"""

from __future__ import annotations

import contextlib
import json
import logging
import socket
import threading
import time
from dataclasses import dataclass
from typing import Any

from armcell.core import InputError
from armcell.core.checks import require
from armcell.core.network_endpoints import Endpoint, listen, reserve
from armcell.ros.bus import Bus
from armcell.ros.codec import CODECS, Codec
from armcell.ros.definitions import plain_name
from armcell.ros.names import resolve
from armcell.ros.tcp.connection import OutboxLimits, RosTcpConnection
from armcell.ros.tcp.framing import MAX_BODY, Frame, command
from armcell.ros.tcp.peer import Params, Peer, required_parameter

logger = logging.getLogger(__name__)
VERSION = "v0.7.0"  # version that Unity's connector 0.7 expects; 0.6 ignores the handshake
PORT = 10000
BACKLOG = 128  # connections that may wait for `accept`


@dataclass(frozen=True)
class ServerSettings:
    """Address and limits of a ROS-TCP server."""

    host: str = "127.0.0.1"
    port: int = PORT  # 0 selects a free port
    protocol: str = "auto"  # "ROS1", "ROS2", or "auto" to follow each client
    max_clients: int = 64
    max_body: int = MAX_BODY  # [bytes] maximum of one message
    queue: int = 10  # messages per topic and client; a full queue drops its oldest
    service_timeout: float = 10.0  # [s] within which a client must answer a service that it implements
    guess_after: float = 0.5  # [s] after which a silent client is assumed to use ROS 1

    def __post_init__(self) -> None:
        require(self.protocol in ("auto", *CODECS), f"protocol is {self.protocol!r}, need auto, ROS1 or ROS2")
        require(0 <= self.port <= 65535, f"port is {self.port}, need 0 to 65535")
        require(self.queue > 0 and self.max_clients > 0, "queue and max_clients must be at least 1")


@dataclass(frozen=True)
class ClientStatus:
    """State of a client that is connected to the ROS-TCP server, for status lines."""

    address: str
    protocol: str
    connected_for: float  # [s]
    topics_in: dict[str, int]  # messages received, by topic
    topics_out: dict[str, int]  # messages queued for sending, by topic
    dropped: int
    waiting_bytes: int
    errors: int


class RosTcpServer:
    """Server that connects ROS-TCP clients such as Unity to a bus, from `start` (or `with`) to `close`.

    Raises (reserve, start):
        InputError: the address cannot be listened on.
    """

    def __init__(self, bus: Bus, settings: ServerSettings = ServerSettings()):
        self.bus, self.settings = bus, settings
        self.address: tuple[str, int] = (settings.host, settings.port)
        self.total_clients = 0
        self._closing = False
        self._socket: socket.socket | None = None
        self._sessions: list[_Session] = []
        self._lock = threading.Lock()
        self._encoded: dict[tuple[str, str], tuple[Any, memoryview]] = {}
        self._thread = threading.Thread(target=self._accept, name="ros-tcp accept", daemon=True)

    def reserve(self) -> None:
        """Bind the port of the ROS-TCP server, but accept no connections before `start`.

        This allows `start` to wait until the cell is ready.
        """
        try:
            self._socket = reserve(*self.address)
        except OSError as error:
            reason = str(error.strerror).split(" (while")[0]  # Python appends the address; we state it below
            raise InputError(
                f"cannot listen on {self.address[0]}:{self.address[1]} ({reason})",
                hint="another program has the port? choose one with --port",
            ) from None
        self.address = self._socket.getsockname()[:2]

    def start(self) -> None:
        if self._socket is None:
            self.reserve()
        assert self._socket is not None
        listen(self._socket, BACKLOG)
        self._thread.start()

    def __enter__(self) -> RosTcpServer:
        self.start()
        return self

    def close(self) -> None:
        """Stop the ROS-TCP server and close the connections of all clients."""
        self._closing = True
        if self._socket is not None:
            with contextlib.suppress(OSError):
                self._socket.shutdown(socket.SHUT_RDWR)
            self._socket.close()
            if self._thread.ident is not None:
                self._thread.join(timeout=2.0)
        with self._lock:
            sessions = list(self._sessions)
        for session in sessions:
            session.link.close()

    def __exit__(self, *exc: object) -> None:
        self.close()

    def endpoints(self) -> tuple[Endpoint, ...]:
        """Return the address of the ROS-TCP server; the result is empty before `reserve` or `start`."""
        return () if self._socket is None else (Endpoint.of(self._socket, "ROS-TCP"),)

    def clients(self) -> list[ClientStatus]:
        """Return the states of all clients that are connected to the ROS-TCP server."""
        with self._lock:
            sessions = list(self._sessions)
        return [session.status() for session in sessions]

    # --- for sessions ---
    def encode(self, topic: str, codec: Codec, message: Any) -> memoryview:
        """Serialize a message only once for all clients of the ROS-TCP server that use the same encoding."""
        key = (resolve(topic), codec.name)
        have = self._encoded.get(key)
        if have is None or have[0] is not message:
            have = self._encoded[key] = (message, codec.encode(message))
        return have[1]

    def take_over(self, name: str, by: _Session) -> None:
        """Transfer a service from an older ROS-TCP client to a newer one, e.g. after Unity has restarted.

        If two clients implement the same service, the newer one takes over.
        """
        with self._lock:
            others = [s for s in self._sessions if s is not by]
        for other in others:
            for spelled in [n for n in other.remote if resolve(n) == resolve(name)]:
                other.stop_serving(spelled)
                other.command("__warn", text=f"service {name} is now served by {by.address}")

    def leave(self, session: _Session) -> None:
        with self._lock:
            if session in self._sessions:
                self._sessions.remove(session)
            if not self._sessions:
                self._encoded.clear()

    # --- accepting ---
    def _accept(self) -> None:
        assert self._socket is not None
        while True:
            try:
                sock, address = self._socket.accept()
            except OSError as error:
                if self._closing:
                    return
                logger.warning("accept failed: %s", error)
                time.sleep(0.1)  # if file descriptors ran out, an immediate retry would fail as well
                continue
            with self._lock:
                self.total_clients += 1
                full = len(self._sessions) >= self.settings.max_clients
            if full:
                logger.warning("%s:%d turned away: %d clients", *address[:2], self.settings.max_clients)
                _turn_away(sock, f"{self.settings.max_clients} clients are connected, that is the most")
                continue
            try:
                session = _Session(self, sock, f"{address[0]}:{address[1]}")
            except OSError:  # the client disconnected before its session was set up
                sock.close()
                continue
            with self._lock:
                self._sessions.append(session)
            try:
                session.start()
            except RuntimeError as error:  # the system cannot create more threads
                logger.warning("%s turned away: %s", session.address, error)
                session.link.close()
                sock.close()


class _Session(Peer):
    """Connection between the ROS-TCP server and one client such as Unity.
    It handles the client's registrations and commands.
    """

    def __init__(self, server: RosTcpServer, sock: socket.socket, address: str):
        settings = server.settings
        protocol = "ROS1" if settings.protocol == "auto" else settings.protocol
        super().__init__(server.bus, CODECS[protocol](server.bus.schema), address, settings.service_timeout)
        self._server, self._protocol = server, protocol
        self._decided = settings.protocol != "auto"
        self._greeting, self._greeted = threading.Lock(), ""
        self.link = RosTcpConnection(
            sock,
            self.on_frame,
            self._on_end,
            self.on_fault,
            settings.max_body,
            OutboxLimits(messages=settings.queue),
        )
        self.commands |= {
            "__subscribe": self._subscribe,
            "__publish": self._publish,
            "__ros_service": self._ros_service,
            "__unity_service": self._unity_service,
            "__remove_subscriber": lambda p: self.withdraw(required_parameter(p, "topic", str)),
            "__remove_publisher": lambda p: self.drop(required_parameter(p, "topic", str)),
            "__remove_ros_service": lambda p: self._forget_service(required_parameter(p, "topic", str)),
            "__remove_unity_service": lambda p: self.stop_serving(required_parameter(p, "topic", str)),
            "__topic_list": self._topic_list,
            "__ping": lambda p: self.command("__ping_response", request_time=p.get("request_time", 0)),
        }

    def start(self) -> None:
        logger.info("%s connected", self.address)
        if self._decided:
            self._greet()
        else:
            self._guess = threading.Timer(self._server.settings.guess_after, self._greet)
            self._guess.daemon = True
            self._guess.start()
        self.link.start()

    def encode(self, topic: str, message: Any) -> memoryview:
        return self._server.encode(topic, self.codec, message)

    def status(self) -> ClientStatus:
        return ClientStatus(
            self.address,
            self._protocol,
            time.monotonic() - self.link.opened,
            dict(self.received),
            dict(self.sent),
            sum(self.link.outbox.dropped.values()),
            self.link.outbox.waiting_bytes,
            self.complaints.total,
        )

    # --- handshake: the first frame to a client names the encoding of all later messages ---
    def _greet(self) -> None:
        with self._greeting:
            if self._greeted != self._protocol:  # a second handshake is necessary only after a wrong guess
                self._greeted = self._protocol
                metadata = json.dumps({"protocol": self._protocol})
                self.command("__handshake", version=VERSION, metadata=metadata)

    def on_frame(self, frame: Frame) -> None:
        speaks = "ROS2" if frame.terminated else "ROS1"
        if not self._decided and frame.is_command:
            self._decided = True
            self._guess.cancel()
            self._protocol, self.codec = speaks, CODECS[speaks](self.bus.schema)
            self._greet()
        elif frame.is_command and speaks != self._protocol:
            self.complain(
                "protocol",
                f"Unity is in {speaks} mode, the server in {self._protocol} mode: change it in Unity under "
                f"Robotics > ROS Settings, or start the server with --protocol {speaks}",
            )
        super().on_frame(frame)

    # --- commands ---
    def _subscribe(self, params: Params) -> None:
        self.offer(*self._registration(params))

    def _publish(self, params: Params) -> None:
        topic, type_name = self._registration(params)
        self.receive_topic(topic, type_name, bool(params.get("latch", False)))

    def _ros_service(self, params: Params) -> None:
        name, type_name = self._registration(params)
        self.bus.schema.service(type_name)
        served = self.bus.services().get(resolve(name))
        if served not in (None, type_name):
            raise InputError(f"service {name} is of type {served}, not {type_name}")
        self._check_room()
        self.service_types[name] = type_name

    def _unity_service(self, params: Params) -> None:
        name, type_name = self._registration(params)
        have = self.remote.get(name)
        if have is None or have.type != type_name:
            self._check_room()
            self._server.take_over(name, self)
            self.serve_remote(name, type_name)

    def _registration(self, params: Params) -> tuple[str, str]:
        return required_parameter(params, "topic", str), plain_name(
            required_parameter(params, "message_name", str)
        )

    def _forget_service(self, name: str) -> None:
        self.service_types.pop(name, None)

    def _topic_list(self, _: Params) -> None:
        topics = self.bus.topics()
        self.command("__topic_list", topics=[t.name for t in topics], types=[t.type for t in topics])

    # --- end of the connection ---
    def _on_end(self, reason: str) -> None:
        logger.info("%s disconnected: %s", self.address, reason)
        if hasattr(self, "_guess"):
            self._guess.cancel()
        self._server.leave(self)
        self.close()


def _turn_away(sock: socket.socket, text: str) -> None:
    with contextlib.suppress(OSError), sock:
        sock.settimeout(1.0)
        sock.sendall(command("__error", {"text": text}))
