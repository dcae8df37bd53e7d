"""ROS 1 node: slave API, TCPROS port and registrations, independent of a bus.

Source: wiki.ros.org/ROS/Slave_API, wiki.ros.org/ROS/TCPROS.
"""

from __future__ import annotations

import logging
import os
import re
import socket
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from armcell.core import InputError
from armcell.core.network_endpoints import Endpoint
from armcell.ros.bus import ServiceError
from armcell.ros.codec import WireError
from armcell.ros.faults import FaultCounter
from armcell.ros.names import resolve
from armcell.ros.ros1 import xmlrpc
from armcell.ros.ros1.publication import ANY, Attach, Publication
from armcell.ros.ros1.registrar import Kind, Registrar
from armcell.ros.ros1.services import Answerer, ServedService, ServiceClient
from armcell.ros.ros1.settings import Ros1Settings, is_this_machine
from armcell.ros.ros1.sockets import Fields, Listener, Reactor, encode_header, receive
from armcell.ros.ros1.subscription import Sink, Subscription
from armcell.ros.ros1.xmlrpc import Answer, Method, RpcError, RpcServer, call_method
from armcell.ros.schema import Schema

logger = logging.getLogger(__name__)
CONNECTORS = 16  # connections that the node establishes in parallel
MAX_SUBSCRIBERS = 2048  # subscriber connections over all topics


class Ros1Node:
    """ROS 1 node with a slave API and a TCPROS port. It is part of a ROS graph from `start` (or `with`) to
    `close`.

    All names in its methods are full graph names.

    Args:
        on_shutdown: called with the reason when the master (because another node took the name) or
            `rosnode kill` requests a shutdown. The node stays open until its owner calls `close`.
    """

    def __init__(
        self, schema: Schema, settings: Ros1Settings, on_shutdown: Callable[[str], None] = lambda _: None
    ):
        self.schema, self.settings = schema, settings
        self.name = resolve(settings.name, settings.namespace)
        self.master = settings.master
        self._on_shutdown = on_shutdown
        self._lock = threading.Lock()
        self._publications: dict[str, Publication] = {}
        self._subscriptions: dict[str, Subscription] = {}
        self._services: dict[str, ServedService] = {}
        self._complaints = FaultCounter()
        self._reactor = Reactor(f"ros1 {self.name}")
        self._executor = ThreadPoolExecutor(CONNECTORS, f"ros1 connect {self.name}")
        self._caller = ServiceClient(self.name, schema, settings.timeout, settings.max_message)
        self._rpc = RpcServer(settings.bind, 0, self._methods(), f"ros1 xml-rpc {self.name}")
        self._tcpros = Listener(settings.bind, 0, self._connected, f"ros1 tcpros {self.name}")
        self.registrar = Registrar(
            self.master, self.name, lambda: self.uri, settings.timeout, self._publishers_are, self._end
        )
        self._closed = False

    # --- start and close ---
    def start(self) -> None:
        """Start the servers of the ROS 1 node and its registration with the master.

        Raises:
            InputError: no master answers, or the address cannot be listened on.
        """
        try:
            call_method(self.master, "getPid", self.name, timeout=self.settings.timeout)
        except RpcError as error:
            raise InputError(
                f"no ROS master: {error}",
                hint="start one (roscore), set ROS_MASTER_URI, or let armcell start its own (--own-master)",
            ) from None
        if self.settings.is_local and not is_this_machine(self.settings.master_address[0]):
            logger.warning(
                "the master is on another machine, but this node only listens on loopback: no node there can "
                "connect to it; set ROS_IP to this machine's address"
            )
        self._rpc.start()
        self._tcpros.start()
        self._reactor.start()
        self.registrar.start()

    def close(self) -> None:
        """Unregister the ROS 1 node and end all its connections and threads."""
        with self._lock:
            if self._closed:
                return
            self._closed = True
        self.registrar.close()
        self._caller.close()
        self._rpc.close()
        self._tcpros.close()
        with self._lock:
            members = [*self._publications.values(), *self._subscriptions.values()]
        for member in members:
            member.close()
        self._reactor.close()
        self._executor.shutdown(wait=True, cancel_futures=True)

    def __enter__(self) -> Ros1Node:
        self.start()
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    @property
    def mistakes(self) -> int:
        """Return the number of connections that the ROS 1 node refused or could not parse."""
        return self._complaints.total

    @property
    def uri(self) -> str:
        return f"http://{self.settings.host}:{self._rpc.port}/"

    @property
    def service_uri(self) -> str:
        return f"rosrpc://{self.settings.host}:{self._tcpros.address[1]}"

    def endpoints(self) -> tuple[Endpoint, ...]:
        """Return the addresses on which the ROS 1 node listens. They are valid after `start`."""
        return self._rpc.endpoint("ROS 1 node"), self._tcpros.endpoint("ROS 1 topics and services")

    def wait_registered(self, timeout: float | None = None) -> bool:
        """Wait until the node is registered at the ROS 1 master with all its topics and services.
        Return False on timeout.

        Args:
            timeout: limit [s]; None waits without limit.
        """
        return self.registrar.wait(timeout)

    def ask_master(self, method: str, *arguments: Any) -> Any:
        """Call a method of the ROS 1 master on behalf of the node and return the value of the answer.

        Raises:
            RpcError: the master does not answer, or answers with a failure.
        """
        return call_method(self.master, method, self.name, *arguments, timeout=self.settings.timeout)

    # --- topics ---
    def publish(self, topic: str, type_name: str, attach: Attach, latching: Callable[[], bool]) -> None:
        """Let the ROS 1 node publish a topic, and advertise the topic at the master."""
        s = self.settings
        made = Publication(
            topic, type_name, self.schema, self.name, self._reactor, attach, latching, s.queue, s.queue_bytes
        )
        with self._lock:
            if topic in self._publications:
                raise InputError(f"{self.name} publishes {topic} already")
            self._publications[topic] = made
        self.registrar.register(Kind.PUBLISHER, topic, type_name)

    def unpublish(self, topic: str) -> None:
        with self._lock:
            gone = self._publications.pop(topic, None)
        if gone is not None:
            self.registrar.unregister(Kind.PUBLISHER, topic)
            gone.close()

    def subscribe(self, topic: str, type_name: str, open_sink: Callable[[Fields], Sink]) -> None:
        """Subscribe the ROS 1 node to a topic.

        Args:
            type_name: message type; `*` accepts any.
            open_sink: called with the connection header of each publisher; returns the sink for its messages.
        """
        any_type = type_name == ANY
        md5 = ANY if any_type else self.schema.md5(type_name)
        text = "" if any_type else self.schema.full_text(type_name)
        made = Subscription(
            topic, type_name, md5, text, self.name, self.uri, self._reactor, self._executor, open_sink,
            self.settings.timeout, self.settings.max_message,
        )  # fmt: skip
        with self._lock:
            if topic in self._subscriptions:
                raise InputError(f"{self.name} subscribes to {topic} already")
            self._subscriptions[topic] = made
        self.registrar.register(Kind.SUBSCRIBER, topic, type_name)

    def unsubscribe(self, topic: str) -> None:
        with self._lock:
            gone = self._subscriptions.pop(topic, None)
        if gone is not None:
            self.registrar.unregister(Kind.SUBSCRIBER, topic)
            gone.close()

    def publications(self) -> list[Publication]:
        with self._lock:
            return list(self._publications.values())

    def subscriptions(self) -> list[Subscription]:
        with self._lock:
            return list(self._subscriptions.values())

    # --- services ---
    def serve(self, name: str, type_name: str, answer: Answerer) -> None:
        """Let the ROS 1 node serve a service, and advertise the service at the master."""
        made = ServedService(name, type_name, self.schema, self.name, answer, self.settings.max_message)
        with self._lock:
            self._services[name] = made
        self.registrar.register(Kind.SERVICE, name, self.service_uri)

    def unserve(self, name: str) -> None:
        with self._lock:
            gone = self._services.pop(name, None)
        if gone is not None:
            self.registrar.unregister(Kind.SERVICE, name)

    def find_service(self, name: str) -> str | None:
        """Return the address at which another ROS 1 node serves a service, or None if there is no such
        node.
        """
        try:
            uri = self.ask_master("lookupService", name)
        except RpcError:
            return None
        return uri if isinstance(uri, str) and uri and uri != self.service_uri else None

    def call_service(self, name: str, type_name: str, request: Any) -> Any:
        """Let the ROS 1 node call a service of another node and return the response. The call waits without a
        time limit.

        Raises:
            ServiceError: no node serves it, its type differs, or it reports a failure.
        """
        uri = self.find_service(name)
        if uri is None:
            raise ServiceError(f"service {name} is not served by any node")
        with self._caller.connect(name, uri, type_name) as connection:
            return connection.call(request)

    def service(self, name: str, type_name: str) -> Any:
        """Open a persistent connection from the ROS 1 node to a service of another node.

        Returns:
            A `Connection` with `call(request)` and `close()`.
        Raises:
            ServiceError: no node serves it, or its type differs.
        """
        uri = self.find_service(name)
        if uri is None:
            raise ServiceError(f"service {name} is not served by any node")
        return self._caller.connect(name, uri, type_name, persistent=True)

    def service_type(self, name: str) -> str:
        """Let the ROS 1 node ask another node for the type of a service, and return the type.

        Raises:
            ServiceError: no node serves it, or its node does not answer.
        """
        uri = self.find_service(name)
        if uri is None:
            raise ServiceError(f"service {name} is not served by any node")
        return self._caller.probe(name, uri)

    # --- slave API ---
    def _methods(self) -> dict[str, Method]:
        topic, key = xmlrpc.graph_name("topic"), xmlrpc.graph_name("parameter_key")
        publishers = xmlrpc.list_of("publishers", xmlrpc.address("publishers"))
        return {
            "getBusStats": Method(self._bus_stats, empty=[]),
            "getBusInfo": Method(self._bus_info, empty=[]),
            "getMasterUri": Method(lambda _: (1, self.master, self.master), empty=""),
            "getUri": Method(lambda _: (1, "", self.uri), empty=""),
            "getName": Method(lambda _: (1, "", self.name), empty=""),
            "getPid": Method(lambda _: (1, "", os.getpid()), empty=-1),
            "shutdown": Method(self._shutdown, (xmlrpc.text("msg"),), optional=1),
            "getSubscriptions": Method(
                lambda _: (1, "subscriptions", [[s.topic, s.type] for s in self.subscriptions()]), empty=[]
            ),
            "getPublications": Method(
                lambda _: (1, "publications", [[p.topic, p.type] for p in self.publications()]), empty=[]
            ),
            "paramUpdate": Method(lambda *_: (-1, "not subscribed", 0), (key, xmlrpc.anything), -1),
            "publisherUpdate": Method(self._publisher_update, (topic, publishers), -1),
            "requestTopic": Method(self._request_topic, (topic, xmlrpc.anything), []),
        }

    def _bus_stats(self, caller: str) -> Answer:
        published = [
            [
                p.topic,
                sum(x.sent_bytes for x in p.links()),
                [[x.number, x.sent_bytes, x.sent, 1] for x in p.links()],
            ]
            for p in self.publications()
        ]
        received = [
            [s.topic, [[x.number, x.received_bytes, -1, int(x.connected)] for x in s.links()]]
            for s in self.subscriptions()
        ]
        return 1, "", [published, received, []]

    def _bus_info(self, caller: str) -> Answer:
        out = [
            [x.number, x.caller, "o", "TCPROS", p.topic, 1, f"TCPROS connection to [{x.peer}]"]
            for p in self.publications() for x in p.links()
        ]  # fmt: skip
        into = [
            [x.number, x.uri, "i", "TCPROS", s.topic, int(x.connected), f"TCPROS connection to [{x.uri}]"]
            for s in self.subscriptions() for x in s.links()
        ]  # fmt: skip
        return 1, "bus info", out + into

    def _shutdown(self, caller: str, message: str = "") -> Answer:
        self._end(f"shut down by {caller}: {message}")
        return 1, "shutdown", 0

    def _end(self, reason: str) -> None:
        logger.warning("%s: %s", self.name, reason[:300])
        self._on_shutdown(reason)

    def _publisher_update(self, caller: str, topic: str, publishers: list[str]) -> Answer:
        self.registrar.update_publishers(topic, publishers)
        return 1, "", 0

    def _publishers_are(self, topic: str, uris: list[str]) -> None:
        with self._lock:
            subscription = self._subscriptions.get(topic)
        if subscription is not None:
            subscription.update(uris)

    def _request_topic(self, caller: str, topic: str, protocols: Any) -> Answer:
        with self._lock:
            known = topic in self._publications
        if not known:
            return -1, f"Not a publisher of [{topic}]", []
        if not isinstance(protocols, list) or not any(
            isinstance(p, list) and p[:1] == ["TCPROS"] for p in protocols
        ):
            return 0, "no supported protocol implementations", []
        host, port = self.settings.host, self._tcpros.address[1]
        return 1, f"ready on {host}:{port}", ["TCPROS", host, port]

    # --- connections to the TCPROS port ---
    def _connected(self, sock: socket.socket, peer: str) -> bool:
        sock.settimeout(self.settings.timeout)
        try:
            header = receive(sock)
        except WireError as error:
            self._complain(peer, str(error))
            return False
        if "topic" in header:
            return self._subscriber(sock, header, peer)
        if "service" in header:
            self._client(sock, header, peer)
        else:
            self._refuse(sock, peer, "no topic or service name detected")
        return False

    def _subscriber(self, sock: socket.socket, header: Fields, peer: str) -> bool:
        missing = next((f for f in ("topic", "md5sum", "callerid") if f not in header), None)
        if missing:
            self._refuse(sock, peer, f"Missing required '{missing}' field")
            return False
        with self._lock:
            publication = self._publications.get(header["topic"])
            known = [[p.topic, p.type] for p in self._publications.values()]
        if sum(len(p.links()) for p in self.publications()) >= MAX_SUBSCRIBERS:
            text = f"[{self.name}] has {MAX_SUBSCRIBERS} subscribers already"
        elif publication is None:
            text = f"[{self.name}] is not a publisher of [{header['topic']}]. Topics are {known}"
        else:
            text = publication.refusal(header)
        if publication is None or text:
            self._refuse(sock, peer, text or "")
            return False
        publication.accept(sock, header, peer)
        return True

    def _client(self, sock: socket.socket, header: Fields, peer: str) -> None:
        missing = next((f for f in ("service", "md5sum", "callerid") if f not in header), None)
        if missing:
            self._refuse(sock, peer, f"Missing required '{missing}' field")
            return
        with self._lock:
            service = self._services.get(header["service"])
        if service is None:
            self._refuse(sock, peer, f"[{self.name}] is not a provider of  [{header['service']}]")
        elif text := service.refusal(header):
            self._refuse(sock, peer, text)
        else:
            service.handle(sock, header)

    def _refuse(self, sock: socket.socket, peer: str, text: str) -> None:
        self._complain(peer, text)
        sock.sendall(encode_header({"error": text}))

    def _complain(self, peer: str, text: str) -> None:
        """Count a connection error of the ROS 1 node. Only the first error of each kind is logged."""
        if self._complaints.count(re.sub(r"[0-9]+", "", text[:200])):
            logger.warning("TCPROS: %s: %s", peer, " ".join(text[:400].split()))
