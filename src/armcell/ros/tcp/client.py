"""ROS-TCP client: connects a bus to a ROS-TCP endpoint, taking Unity's role.

The endpoint may be the reference one (ROS-TCP-Endpoint) or armcell's `RosTcpServer`.
"""

from __future__ import annotations

import json
import logging
import socket
import threading
from dataclasses import dataclass, field

from armcell.core import ArmcellError, InputError
from armcell.ros.bus import Bus
from armcell.ros.codec import CODECS
from armcell.ros.tcp.connection import OutboxLimits, RosTcpConnection
from armcell.ros.tcp.framing import KEEP_ALIVE as KEEP_ALIVE_FRAME
from armcell.ros.tcp.framing import MAX_BODY
from armcell.ros.tcp.peer import Params, Peer, required_parameter

logger = logging.getLogger(__name__)
RETRY = 1.0  # [s] between two connection attempts, as in Unity's connector
CONNECT_TIMEOUT = 2.0  # [s]
HANDSHAKE_TIMEOUT = 2.0  # [s] to wait for the handshake, which endpoints older than 0.7 do not send
KEEP_ALIVE = 1.0  # [s] of silence before a keep-alive frame, as in Unity's connector
LOGS = {"__log": logging.INFO, "__warn": logging.WARNING, "__error": logging.ERROR}


@dataclass(frozen=True)
class ForwardedNames:
    """Topics and services that a ROS-TCP client forwards between the bus and other programs,
    as dicts from name to type.
    """

    publish: dict[str, str] = field(default_factory=dict)  # topics from the bus to the endpoint
    subscribe: dict[str, str] = field(default_factory=dict)  # topics from the endpoint to the bus
    implement: dict[str, str] = field(default_factory=dict)  # services of the bus, offered at the endpoint
    use: dict[str, str] = field(default_factory=dict)  # services of the endpoint, offered on the bus

    def __post_init__(self) -> None:
        for one, other in ((self.publish, self.subscribe), (self.implement, self.use)):
            if both := set(one) & set(other):
                raise InputError(f"{sorted(both)[0]} is bridged both ways: it would echo for ever")


class RosTcpClient:
    """ROS-TCP client that runs from `start` (or `with`) to `close` and reconnects automatically.

    Args:
        bridge: topics and services to transport.
        protocol: "ROS1" or "ROS2", for an endpoint that sends no handshake; a handshake sets the protocol
            itself.
        service_timeout: limit [s] for answers from the endpoint.
        queue: messages per topic that may wait to be sent; a full queue drops its oldest.
    """

    def __init__(
        self,
        bus: Bus,
        host: str,
        port: int,
        bridge: ForwardedNames,
        protocol: str = "ROS1",
        service_timeout: float = 10.0,
        queue: int = 10,
    ):
        self.bus, self.address, self.bridge = bus, (host, port), bridge
        self._protocol, self._service_timeout, self._queue = protocol, service_timeout, queue
        self.connections = 0
        self.connection: _Connection | None = None
        self._connected = threading.Event()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="ros-tcp client", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def __enter__(self) -> RosTcpClient:
        self.start()
        return self

    def close(self) -> None:
        self._stop.set()
        if connection := self.connection:
            connection.link.close()
        self._thread.join(timeout=5.0)

    def __exit__(self, *exc: object) -> None:
        self.close()

    def wait_connected(self, timeout: float | None = None) -> bool:
        """Wait until the ROS-TCP client has registered all its topics and services at the endpoint.

        Args:
            timeout: limit [s]; None waits without limit.
        Returns:
            False on timeout.
        """
        return self._connected.wait(timeout)

    def topic_list(self, timeout: float) -> dict[str, str] | None:
        """Return the topics that the endpoint reports to the ROS-TCP client, as a dict from topic name to
        type.

        Args:
            timeout: limit [s] for the endpoint's answer.
        Returns:
            The topics, or None if the endpoint does not answer in time.
        """
        connection = self.connection
        if connection is None:
            return None
        connection.listed.clear()
        connection.command("__topic_list")
        return connection.topics if connection.listed.wait(timeout) else None

    def _run(self) -> None:
        said = ""
        while not self._stop.is_set():
            try:
                sock = socket.create_connection(self.address, timeout=CONNECT_TIMEOUT)
            except OSError as error:
                reason = error.strerror or str(error)
                if reason != said:
                    logger.warning("no endpoint at %s:%d (%s); trying on", *self.address, reason)
                said = reason
                self._stop.wait(RETRY)
                continue
            said = ""
            sock.settimeout(None)
            self._serve(sock)
            self._stop.wait(RETRY)

    def _serve(self, sock: socket.socket) -> None:
        name = f"endpoint {self.address[0]}:{self.address[1]}"
        connection = _Connection(self.bus, name, self._protocol, self._service_timeout)
        connection.link = RosTcpConnection(
            sock,
            connection.on_frame,
            connection.on_end,
            connection.on_fault,
            MAX_BODY,
            OutboxLimits(self._queue),
            KEEP_ALIVE,
        )
        self.connection = connection
        if self._stop.is_set():
            sock.close()
            return
        connection.link.put(KEEP_ALIVE_FRAME)
        connection.link.start()
        if not connection.greeted.wait(HANDSHAKE_TIMEOUT) and not connection.link.is_over:
            logger.warning("%s sent no handshake: older than 0.7? taken for %s", name, self._protocol)
        if not connection.link.is_over:
            try:
                connection.register(self.bridge)
            except ArmcellError as error:
                logger.error("%s: %s", name, error)
            self.connections += 1
            self._connected.set()
        connection.link.wait()
        self._connected.clear()
        connection.close()


class _Connection(Peer):
    """One connection of the ROS-TCP client to an endpoint. Each reconnection creates a new instance of this
    class.
    """

    def __init__(self, bus: Bus, name: str, protocol: str, service_timeout: float):
        super().__init__(
            bus, CODECS[protocol](bus.schema), name, service_timeout, terminate=protocol == "ROS2"
        )
        self.greeted, self.listed = threading.Event(), threading.Event()
        self.topics: dict[str, str] = {}
        self.commands |= {
            "__handshake": self._handshake,
            "__topic_list": self._topic_list,
            "__ping_response": lambda _: None,
            **{name: self._logger(name) for name in LOGS},
        }

    def register(self, bridge: ForwardedNames) -> None:
        """Register all topics and services of the ROS-TCP client at the endpoint.

        The endpoint runs the commands in order.
        """
        for topic, type_name in bridge.publish.items():
            self.command("__publish", topic=topic, message_name=type_name, queue_size=10, latch=False)
        for topic, type_name in bridge.subscribe.items():
            self.receive_topic(topic, type_name, latch=False)
            self.command("__subscribe", topic=topic, message_name=type_name)
        for name, type_name in bridge.implement.items():
            self.service_types[name] = type_name
            self.command("__unity_service", topic=name, message_name=type_name)
        for name, type_name in bridge.use.items():
            self.command("__ros_service", topic=name, message_name=type_name)
            self.serve_remote(name, type_name)
        for topic, type_name in bridge.publish.items():
            self.offer(topic, type_name)

    def tell_error(self, text: str) -> None:
        """Discard an error text of the ROS-TCP client instead of sending it,
        because ROS-TCP endpoints do not accept error messages.

        The reference endpoint would close the connection.
        """

    def on_end(self, reason: str) -> None:
        logger.info("%s: %s", self.address, reason)
        self.greeted.set()

    def _handshake(self, params: Params) -> None:
        version = required_parameter(params, "version", str)
        protocol = "ROS1"
        try:
            metadata = json.loads(params.get("metadata") or "{}")
            protocol = metadata.get("protocol", protocol)
        except (ValueError, TypeError, AttributeError):
            logger.warning("%s: handshake metadata %r", self.address, params.get("metadata"))
        if protocol in CODECS:
            self.codec, self.terminate = CODECS[protocol](self.bus.schema), protocol == "ROS2"
        logger.info("%s: version %s, %s", self.address, version[:20], protocol)
        self.greeted.set()

    def _topic_list(self, params: Params) -> None:
        names, types = required_parameter(params, "topics", list), required_parameter(params, "types", list)
        self.topics = {str(n): str(t) for n, t in zip(names, types)}
        self.listed.set()

    def _logger(self, command: str):
        def log(params: Params) -> None:
            logger.log(LOGS[command], "%s says: %s", self.address, str(params.get("text", ""))[:400])

        return log
