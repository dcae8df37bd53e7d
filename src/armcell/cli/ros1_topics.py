"""Connection of `armcell topic` and `service` to a ROS 1 graph instead of an endpoint."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from armcell import _interrupts

WAIT = 3.0  # [s] for subscribers to connect and to receive the messages


class GraphClient:
    """Client of a ROS 1 graph for the commands `topic` and `service`,
    with the methods of a ROS-TCP client.
    """

    def __init__(self, bus: Any, graph: Any):
        self._bus, self._graph = bus, graph

    def topic_list(self, timeout: float) -> dict[str, str]:
        """Return the topics of a ROS 1 graph for `armcell topic`, as types by name."""
        node = self._graph.node
        publishers, subscribers, _ = node.ask_master("getSystemState")
        others = {name for name, nodes in (*publishers, *subscribers) if set(nodes) - {node.name}}
        return {name: kind for name, kind in node.ask_master("getTopicTypes") if name in others}

    def wait_for_subscribers(self, topic: str) -> None:
        """Wait, for `armcell topic`, until all ROS 1 subscribers of a
        topic are connected, at most `WAIT` seconds.
        """
        node = self._graph.node
        self._graph.wait_settled(WAIT)
        subscribers = dict(node.ask_master("getSystemState")[1]).get(topic, [])
        count = len(set(subscribers) - {node.name})
        self._wait(lambda: sum(len(p.links()) for p in node.publications() if p.topic == topic) >= count)

    def flush(self) -> None:
        """Wait until `armcell topic pub` has sent all its messages to ROS 1, at most `WAIT` seconds."""
        node = self._graph.node
        self._wait(lambda: not any(x.waiting for p in node.publications() for x in p.links()))

    @staticmethod
    def _wait(what: Any) -> None:
        end = time.monotonic() + WAIT
        while not what() and time.monotonic() < end:
            _interrupts.sleep(0.01)


@contextmanager
def graph_connection() -> Iterator[tuple[Any, GraphClient]]:
    """Connect a new bus for `armcell topic` to the ROS 1 graph at ROS_MASTER_URI. Yield the bus and a client
    of the graph.

    Raises:
        InputError: no master answers.
    """
    from armcell.ros import Bus
    from armcell.ros.ros1 import Ros1Graph, from_environment

    bus = Bus()
    with Ros1Graph(bus, from_environment(f"armcell_topic_{os.getpid()}", own_master=False)) as graph:
        yield bus, GraphClient(bus, graph)
