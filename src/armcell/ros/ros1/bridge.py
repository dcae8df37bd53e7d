"""Bridge between an armcell bus and a ROS 1 graph, in both directions.

Publishers, subscribers and services of the bus appear in the graph; topics and services of the graph are
reachable from the bus. The bridge registers and unregisters publishers, subscribers and services as they join
and leave the bus, so no topic list is necessary. Actions (five topics each) and TF therefore work as well.
"""

from __future__ import annotations

import contextlib
import logging
import threading
from collections.abc import Callable
from typing import Any

from armcell.core import ArmcellError
from armcell.ros.bus import Bus, Handler, Publisher, TopicInfo
from armcell.ros.codec import Codec, ros1_codec
from armcell.ros.names import NameMap
from armcell.ros.ros1.node import Ros1Node
from armcell.ros.ros1.sockets import Fields
from armcell.ros.ros1.xmlrpc import RpcError

logger = logging.getLogger(__name__)
SETTLE = 0.02  # [s] to collect several bus changes into one synchronization
CLOCK, USE_SIM_TIME = "/clock", "/use_sim_time"


class BusBridge:
    """Bridge between the bus of armcell and a ROS 1 graph, active from `start` to `close`."""

    def __init__(self, bus: Bus, node: Ros1Node, names: NameMap):
        self._bus, self._node, self._names = bus, node, names
        self._codec = ros1_codec(bus.schema)
        self._published: dict[str, str] = {}  # bus topic -> message type
        self._subscribed: dict[str, str] = {}
        self._served: dict[str, str] = {}
        self._stop = threading.Event()
        self._synced = threading.Condition()
        self._seen = 0
        self._simulated = False
        self._thread = threading.Thread(target=self._run, name=f"ros1 bridge {node.name}", daemon=True)

    def start(self) -> None:
        self._bus.add_service_finder(self._find)
        self._thread.start()

    def close(self) -> None:
        self._bus.remove_service_finder(self._find)
        self._stop.set()
        if self._thread.ident is not None:
            self._thread.join(5.0)

    def wait_settled(self, timeout: float) -> bool:
        """Wait until the bridge has offered all topics and services of the bus to ROS 1 and the master knows
        them.

        Args:
            timeout: limit [s].
        Returns:
            False on timeout.
        """
        version = self._bus.wait_change(-1, 0)
        with self._synced:
            seen = self._synced.wait_for(lambda: self._seen >= version or self._stop.is_set(), timeout)
        return seen and self._node.wait_registered(timeout)

    # --- from the bus to the graph ---
    def _run(self) -> None:
        version = -1
        while not self._stop.is_set():
            now = self._bus.wait_change(version, 0.2)
            if now == version:
                continue
            self._stop.wait(SETTLE)
            version = self._bus.wait_change(-1, 0)
            try:
                self._sync()
            except Exception:
                logger.exception("what is on the bus could not be offered")
            with self._synced:
                self._seen = version
                self._synced.notify_all()

    def _sync(self) -> None:
        topics = self._bus.topics(besides=self)
        publish = {t.name: t.type for t in topics if t.publishers}
        subscribe = {t.name: t.type for t in topics if t.subscribers}
        services = self._bus.services()
        graph = self._names.to_graph
        _change(self._published, publish, lambda n: self._node.unpublish(graph(n)), self._publish)
        _change(self._subscribed, subscribe, lambda n: self._node.unsubscribe(graph(n)), self._subscribe)
        _change(self._served, services, lambda n: self._node.unserve(graph(n)), self._serve)
        if CLOCK in publish and not self._simulated:
            self._simulated = True
            self._use_sim_time()

    def _use_sim_time(self) -> None:
        """Set the ROS 1 parameter /use_sim_time if the bridge forwards /clock. Other nodes read this
        parameter when they start.
        """
        with contextlib.suppress(RpcError):
            if not self._bus.parameters.get(USE_SIM_TIME, False):
                logger.info("/use_sim_time is set: the time of this graph is that of the cell")
        self._bus.parameters.set(USE_SIM_TIME, True)

    def _publish(self, topic: str, type_name: str) -> None:
        def attach(put: Callable[[Any], None]) -> Any:
            return self._bus.attach(topic, type_name, put, owner=self)

        def latching() -> bool:
            return any(t.latched for t in self._bus.topics(besides=self) if t.name == topic)

        self._node.publish(self._names.to_graph(topic), type_name, attach, latching)

    def _subscribe(self, topic: str, type_name: str) -> None:
        self._codec.prepare(type_name)

        def open_sink(header: Fields) -> _ToBus:
            latch = header.get("latching") == "1"
            publisher = self._bus.advertise(topic, type_name, latch, owner=self)
            return _ToBus(self._codec, publisher)

        self._node.subscribe(self._names.to_graph(topic), type_name, open_sink)

    def _serve(self, name: str, type_name: str) -> None:
        def answer(request: Any) -> Any:
            return self._bus.call(name, request)

        self._node.serve(self._names.to_graph(name), type_name, answer)

    # --- from the graph to the bus ---
    def _find(self, name: str) -> Handler | None:
        there = self._names.to_graph(name)
        if self._node.find_service(there) is None:
            return None

        def call(request: Any) -> Any:
            return self._node.call_service(there, request._type.removesuffix("Request"), request)

        return call

    def topics(self) -> list[TopicInfo]:
        """Return the topics of the bus that the bridge should offer in ROS 1.
        Topics that only the bridge itself uses are not included.
        """
        return self._bus.topics(besides=self)


class _ToBus:
    """Receiver that forwards the messages of one ROS 1 publisher to the bus of armcell.

    Each ROS 1 publisher has its own instance, so that the bus keeps the latched message of every publisher.
    """

    def __init__(self, codec: Codec, publisher: Publisher):
        self._codec, self._publisher = codec, publisher

    def on_message(self, body: bytes) -> None:
        message = self._codec.decode(self._publisher.type, body)
        if not self._publisher.closed:
            self._publisher.publish(message)

    def close(self) -> None:
        self._publisher.close()


def _change(
    have: dict[str, str], want: dict[str, str], leave: Callable[[str], None], join: Callable[[str, str], None]
) -> None:
    """Add and remove publishers, subscribers or services of the bridge in ROS 1 until their names and types
    match the wanted ones.

    Args:
        have: dict from offered name to type; changed in place.
        want: dict from wanted name to type.
        leave: withdraws a name that is no longer wanted, or whose type changed.
        join: offers a new name with its type.
    """
    for name in [n for n, kind in have.items() if want.get(n) != kind]:
        del have[name]
        leave(name)
    for name, kind in want.items():
        if name not in have:
            have[name] = kind
            try:
                join(name, kind)
            except ArmcellError as error:
                logger.error("%s is not offered: %s", name, error)
