"""Connection of a program's bus to a ROS 1 graph; `Ros1Graph` is the class to use."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import Any

from armcell._interrupts import deferred, last_will
from armcell.core import InputError
from armcell.core.network_endpoints import Endpoint
from armcell.ros.bus import Bus
from armcell.ros.names import NameMap
from armcell.ros.ros1.bridge import CLOCK, USE_SIM_TIME, BusBridge
from armcell.ros.ros1.master import Ros1Master
from armcell.ros.ros1.node import Ros1Node
from armcell.ros.ros1.parameters import GraphParameters
from armcell.ros.ros1.rosout import LEVELS, RosOut
from armcell.ros.ros1.settings import Ros1Settings, is_this_machine
from armcell.ros.ros1.xmlrpc import RpcError, call_method

logger = logging.getLogger(__name__)
SETTLED = 10.0  # [s] to register everything


@dataclass(frozen=True)
class Ros1Status:
    """State of the connection between a program and a ROS 1 graph, for status lines."""

    node: str
    master: str
    own_master: bool
    reachable: bool  # whether the master answers at present
    peers: tuple[str, ...]  # names of nodes connected as publishers or subscribers
    connections: int
    dropped: int  # messages discarded because a subscriber's queue was full
    mistakes: int  # connections that this node refused or could not parse


class Ros1Graph:
    """Connection between a bus and a ROS 1 graph, which is open from `start` (or `with`) to `close`. The
    connection consists of a node and, if necessary, a master.

    Args:
        on_end: called with the reason, in a thread of the node, when another node or the master requests
            this node's shutdown.
        keep: parameters for which a value in the graph takes precedence over the value on the bus.
        bus_is_graph: the bus uses the graph's names already (`Bus.with_remapping`); the namespace and
            remappings in the settings then apply to the node's name only.

    Everything on the bus, now and later, is offered to the graph. The bus reaches the graph's topics,
    services and actions by their names. The bus uses the graph's parameters.

    Attributes:
        ended: event that is set, together with `reason`, when a shutdown of the node was requested.
    """

    def __init__(
        self,
        bus: Bus,
        settings: Ros1Settings = Ros1Settings(),
        on_end: Callable[[str], None] = lambda _: None,
        keep: Iterable[str] = (),
        bus_is_graph: bool = False,
    ):
        self._bus_is_graph = bus_is_graph
        self.bus, self.settings, self._on_end, self._keep = bus, settings, on_end, tuple(keep)
        self.master: Ros1Master | None = None  # the built-in master, if this process runs it
        self.node: Ros1Node  # `node` and `bridge` exist after `start`
        self.bridge: BusBridge
        self.ended, self.reason = threading.Event(), ""
        self.rosout: RosOut | None = None
        self._found = False  # `reserve` found a master or took the port for the built-in one
        self._stack = ExitStack()

    def reserve(self) -> None:
        """Find the master of a ROS 1 graph, or reserve the port for a built-in master.

        The reserved port accepts no connections before `start`.

        Raises:
            InputError: no master is reachable and the settings forbid the built-in one, or its port is taken.
        """
        self._find_master()
        self._found = True
        self._stack.callback(self._forget_master)

    def start(self) -> None:
        """Join the ROS 1 graph and return when the master knows all topics and services of the bus.

        Raises:
            InputError: no master is reachable and the settings forbid the built-in one, or its port is taken.
        """
        if not self._found:
            self.reserve()
        with self._stack.pop_all() as stack:
            if self.master is not None:
                self.master.start()
                logger.info("started a ROS master at %s", self.master.uri)
            settings = self.settings
            self.node = node = Ros1Node(self.bus.schema, settings, self._end)
            outside = ("/", {}) if self._bus_is_graph else (settings.namespace, settings.remap)
            names = NameMap(node.name, *outside)
            stack.callback(last_will(node.close))
            stack.callback(node.close)
            node.start()
            self._join_parameters(stack, names)
            self.rosout = rosout = RosOut(
                self.bus, names.to_bus(node.name), aggregate=self.master is not None
            )
            stack.callback(rosout.close)
            rosout.start()
            self._follow_clock(stack)
            self.bridge = BusBridge(self.bus, node, names)
            stack.callback(self.bridge.close)
            self.bridge.start()
            if not self.bridge.wait_settled(SETTLED):
                logger.warning("the master at %s does not know everything yet", settings.master)
            self._stack = stack.pop_all()

    def close(self) -> None:
        """Leave the ROS 1 graph and restore the state that the bus had before `start`."""
        with deferred():
            self._stack.close()

    def __enter__(self) -> Ros1Graph:
        self.start()
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def _end(self, reason: str) -> None:
        self.reason = reason
        self.ended.set()
        self._on_end(reason)

    def wait_settled(self, timeout: float = SETTLED) -> bool:
        """Wait until the connection to the ROS 1 graph is complete: the graph knows all topics and services
        of the bus. Return False on timeout.

        Args:
            timeout: limit [s].
        """
        return self.bridge.wait_settled(timeout)

    def say(self, level: str, text: str) -> None:
        """Publish a log line of this program to the ROS 1 graph that it has joined. A level that ROS does not
        know becomes `info`.
        """
        if self.rosout is not None:
            self.rosout.say(level if level in LEVELS else "info", text)

    def endpoints(self) -> tuple[Endpoint, ...]:
        """Return the addresses on which this program listens in the ROS 1 graph, for its node and its
        built-in master. They are valid after `start`.
        """
        return (*(self.master.endpoints() if self.master else ()), *self.node.endpoints())

    def _find_master(self) -> None:
        s = self.settings
        if s.own_master is not True:
            try:
                call_method(s.master, "getPid", f"/{s.name}", timeout=s.timeout)
                return
            except RpcError as error:
                here = is_this_machine(s.master_address[0])
                if s.own_master is False or not here:
                    where = "" if here else " on that machine"
                    raise InputError(
                        f"no ROS master: {error}", hint=f"start roscore{where}; is ROS_MASTER_URI right?"
                    ) from None
        master = Ros1Master(s)
        master.reserve()
        self.master, self.settings = master, replace(s, master=master.uri)

    def _forget_master(self) -> None:
        self._found = False
        if self.master is not None:
            self.master.close()
            self.master = None

    def _join_parameters(self, stack: ExitStack, names: NameMap) -> None:
        before = self.bus.parameters
        for name, value in self.settings.parameters.items():
            before.set(f"{names.to_bus(self.node.name)}/{name}", value)
        joined = GraphParameters(self.node.ask_master, names, before)
        for name in self._keep:
            if name in before and self.node.ask_master("hasParam", names.to_graph(name)):
                before.delete(name)
        joined.upload_all()
        self.node.registrar.on_return = joined.upload_all
        self.bus.parameters = joined

        def leave() -> None:
            self.bus.parameters = before

        stack.callback(leave)

    def _follow_clock(self, stack: ExitStack) -> None:
        """Let the bus take its time from /clock of the ROS 1 graph, if ROS uses simulated time.

        The clock stays local if the bus itself publishes /clock, or if /use_sim_time is not true.
        """
        published = any(t.name == CLOCK and t.publishers for t in self.bus.topics())
        if published or self.bus.parameters.get(USE_SIM_TIME, False) is not True:
            return
        clock: Any = self.bus.subscribe(
            CLOCK, "rosgraph_msgs/Clock", lambda message: self.bus.clock.set(message.clock.to_sec()), 1
        )
        stack.callback(clock.close)

    # --- status ---
    def status(self) -> Ros1Status:
        out = [link for p in self.node.publications() for link in p.links()]
        into = [link for s in self.node.subscriptions() for link in s.links() if link.connected]
        peers = {link.caller for link in out} | {link.publisher for link in into}
        return Ros1Status(
            self.node.name, self.node.master, self.master is not None, self.node.registrar.reachable,
            tuple(sorted(peers)), len(out) + len(into), sum(link.dropped for link in out), self.node.mistakes,
        )  # fmt: skip
