"""Endpoints, services and nodes of other participants in the domain, from DDS discovery."""

from __future__ import annotations

import logging
import threading
from dataclasses import dataclass
from typing import Any

from armcell.core import ArmcellError
from armcell.ros.ros2 import names
from armcell.ros.ros2.codec import Ros2Codec
from armcell.ros.ros2.dds import Participant, Sample
from armcell.ros.ros2.qos import DISCOVERY, DISCOVERY_READER, QosProfile, profile_of, user_values

logger = logging.getLogger(__name__)
ALIVE = 16  # DDS_ALIVE_INSTANCE_STATE
MAX_ENDPOINTS = 20_000  # limits the memory that a flood of endpoints can use


@dataclass(frozen=True)
class Endpoint:
    """DDS writer or reader of another participant in the ROS 2 graph."""

    topic: str
    type: str
    profile: QosProfile
    user: tuple[tuple[str, str], ...]
    participant: bytes
    writes: bool


class Graph:
    """Thread-safe record of the other participants in a ROS 2 graph (a DDS domain).
    The attribute `version` counts the changes.
    """

    def __init__(self, participant: Participant, codec: Ros2Codec):
        self._participant, self._codec = participant, codec
        self._own = participant.guid
        self._lock = threading.Lock()
        self._endpoints: dict[bytes, Endpoint] = {}
        self._nodes: dict[bytes, list[str]] = {}
        self.version = 0
        self._readers = [
            participant.watch_endpoints(True, lambda e: self._on_endpoint(e, True)),
            participant.watch_endpoints(False, lambda e: self._on_endpoint(e, False)),
        ]
        self._readers.append(participant.reader(names.DISCOVERY, DISCOVERY_READER, self._on_nodes))

    # --- queries ---
    def endpoints(self, dds_topic: str, writes: bool) -> list[Endpoint]:
        """Return the writers or the readers of a DDS topic that belong
        to other participants in the ROS 2 graph.
        """
        with self._lock:
            return [e for e in self._endpoints.values() if e.topic == dds_topic and e.writes == writes]

    def topics(self) -> dict[str, str]:
        """Return the topics of other participants in the ROS 2 graph, as a dict from name to type.

        If endpoints of a topic have different types, the first endpoint counts.
        """
        with self._lock:
            endpoints = list(self._endpoints.values())
        found: dict[str, str] = {}
        for endpoint in endpoints:
            name, type_name = names.ros_topic(endpoint.topic), names.ros_type(endpoint.type)
            if name and type_name:
                found.setdefault(name, type_name)
        return found

    def services(self) -> dict[str, str]:
        """Return the services that other participants in the ROS 2 graph serve, as a dict from name to type.

        A service counts if its server reads requests and writes replies.
        """
        with self._lock:
            endpoints = list(self._endpoints.values())
        replies = {e.topic for e in endpoints if e.writes}
        found = {}
        for e in endpoints:
            name = names.ros_service(e.topic)
            type_name = names.ros_type(e.type)
            if name and type_name and not e.writes and f"rr{name}Reply" in replies:
                found[name] = type_name.removesuffix("_Request")
        return found

    def nodes(self) -> list[str]:
        """Return the full names of the other nodes in the ROS 2 graph."""
        with self._lock:
            return sorted(name for nodes in self._nodes.values() for name in nodes)

    # --- discovery, in the participant's thread ---
    def _on_endpoint(self, found: Any, writes: bool) -> None:
        key, alive = found.key.bytes, found.sample_info.instance_state == ALIVE
        with self._lock:
            if not alive:
                gone = self._endpoints.pop(key, None)
                if gone is not None and not any(
                    e.participant == gone.participant for e in self._endpoints.values()
                ):
                    self._nodes.pop(gone.participant, None)
            elif found.participant_key.bytes != self._own and len(self._endpoints) < MAX_ENDPOINTS:
                self._endpoints[key] = Endpoint(
                    found.topic_name,
                    found.type_name,
                    profile_of(found.qos),
                    tuple(user_values(found.qos).items()),
                    found.participant_key.bytes,
                    writes,
                )
            self.version += 1

    def _on_nodes(self, sample: Sample) -> None:
        try:
            info = self._codec.decode(names.DISCOVERY.message, sample.data)
        except ArmcellError as error:
            logger.warning("ros_discovery_info: %s", error)
            return
        nodes = [f"{n.node_namespace.rstrip('/')}/{n.node_name}" for n in info.node_entities_info_seq]
        with self._lock:
            self._nodes[bytes(info.gid.data[:16])] = nodes
            self.version += 1


class Announcer:
    """Publisher that announces the DDS endpoints of this node to the ROS 2 graph, so that `ros2 node list`
    shows the node.
    """

    def __init__(self, participant: Participant, codec: Ros2Codec, node: str):
        self._participant, self._codec = participant, codec
        namespace, _, self._name = node.rpartition("/")
        self._namespace = namespace or "/"
        self._lock = threading.Lock()
        self._gids: dict[bytes, bool] = {}
        self._told: dict[bytes, bool] | None = None
        self._writer = participant.writer(names.DISCOVERY, DISCOVERY)

    def add(self, guid: bytes, writes: bool) -> None:
        with self._lock:
            self._gids[guid] = writes

    def remove(self, guid: bytes) -> None:
        with self._lock:
            self._gids.pop(guid, None)

    def announce(self) -> None:
        """Announce the endpoints of this node to the ROS 2 graph if they have changed since the last call."""
        with self._lock:
            gids = dict(self._gids)
        if gids == self._told:
            return
        self._told = gids
        new = self._codec.new
        node = new(
            "rmw_dds_common/NodeEntitiesInfo",
            node_namespace=self._namespace,
            node_name=self._name,
            reader_gid_seq=[self._gid(g) for g, writes in gids.items() if not writes],
            writer_gid_seq=[self._gid(g) for g, writes in gids.items() if writes],
        )
        info = new(
            names.DISCOVERY.message, gid=self._gid(self._participant.guid), node_entities_info_seq=[node]
        )
        self._writer.write(self._codec.encode(info))

    def _gid(self, guid: bytes) -> Any:
        gid = self._codec.new("rmw_dds_common/Gid")
        gid.data[:16] = list(guid)  # in Humble, eight zeros follow
        return gid
