"""Joining a ROS 1 graph with a bus: the one class that a program needs."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import Any

from armcell._interrupts import deferred, last_will
from armcell.core import InputError
from armcell.core.endpoints import Endpoint
from armcell.ros.bus import Bus
from armcell.ros.ros1.bridge import CLOCK, USE_SIM_TIME, BusBridge
from armcell.ros.ros1.graph_names import GraphNames
from armcell.ros.ros1.graph_parameters import GraphParameters
from armcell.ros.ros1.master import Ros1Master
from armcell.ros.ros1.node import Ros1Node
from armcell.ros.ros1.rosout import LEVELS, RosOut
from armcell.ros.ros1.rpc import RpcError, ask
from armcell.ros.ros1.settings import Ros1Settings, is_this_machine

logger = logging.getLogger(__name__)
SETTLED = 10.0  # [s] to register everything


@dataclass(frozen=True)
class Ros1Status:
    """A joined graph, for status lines."""

    node: str
    master: str
    own_master: bool
    reachable: bool  # the master, now
    peers: tuple[str, ...]  # nodes that are connected, either way
    connections: int
    dropped: int  # messages that subscribers did not take in time
    mistakes: int  # connections that were refused or made no sense


class Ros1Graph:
    """A bus in a ROS 1 graph, from `start` (or `with`) to `close`.

    Args:
        on_end: told why, when somebody asks the node to end; from a thread of the node's.
        keep: parameters that stay as they are in the graph where it has them.

    Everything on the bus is offered to the graph, now and later; the graph's topics, services and actions
    are used through the bus by their names; the bus's parameters are the graph's.

    Attributes:
        ended: set, with `reason`, when somebody asked the node to end.
    """

    def __init__(
        self,
        bus: Bus,
        settings: Ros1Settings = Ros1Settings(),
        on_end: Callable[[str], None] = lambda _: None,
        keep: Iterable[str] = (),
    ):
        self.bus, self.settings, self._on_end, self._keep = bus, settings, on_end, tuple(keep)
        self.master: Ros1Master | None = None  # our own
        self.node: Ros1Node  # this and the next from `start` on
        self.bridge: BusBridge
        self.ended, self.reason = threading.Event(), ""
        self.rosout: RosOut | None = None
        self._found = False  # a master, or the port for our own
        self._stack = ExitStack()

    def reserve(self) -> None:
        """Find the master, or take the port for our own; nothing is opened before `start`.

        Raises:
            InputError: there is no master and none may be started, or a port is taken.
        """
        self._find_master()
        self._found = True
        self._stack.callback(self._forget_master)

    def start(self) -> None:
        """Join, and return when the master knows what is on the bus.

        Raises:
            InputError: there is no master and none may be started, or a port is taken.
        """
        if not self._found:
            self.reserve()
        with self._stack.pop_all() as stack:
            if self.master is not None:
                self.master.start()
                logger.info("started a ROS master at %s", self.master.uri)
            settings = self.settings
            self.node = node = Ros1Node(self.bus.schema, settings, self._end)
            names = GraphNames(node.name, settings.namespace, settings.remap)
            stack.callback(last_will(node.close))
            stack.callback(node.close)
            node.start()
            self._join_parameters(stack, names)
            # The bus's own names are without the namespace, that of the node, too.
            self.rosout = rosout = RosOut(self.bus, f"/{settings.name}", aggregate=self.master is not None)
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
        """Leave the graph; the bus is as it was before."""
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
        """Whether the graph knows all that is on the bus now, after waiting for that [s]."""
        return self.bridge.wait_settled(timeout)

    def say(self, level: str, text: str) -> None:
        """A line on /rosout; a level that ROS does not have is info."""
        if self.rosout is not None:
            self.rosout.say(level if level in LEVELS else "info", text)

    def endpoints(self) -> tuple[Endpoint, ...]:
        """Where we listen, once it has started."""
        return (*(self.master.endpoints() if self.master else ()), *self.node.endpoints())

    def _find_master(self) -> None:
        s = self.settings
        if s.own_master is not True:
            try:
                ask(s.master, "getPid", f"/{s.name}", timeout=s.timeout)
                return
            except RpcError as error:
                here = is_this_machine(s.master_address[0])
                if s.own_master is False or not here:
                    where = "" if here else " on that machine"
                    raise InputError(
                        f"no ROS master: {error}", cure=f"start roscore{where}; is ROS_MASTER_URI right?"
                    ) from None
        master = Ros1Master(s)
        master.reserve()
        self.master, self.settings = master, replace(s, master=master.uri)

    def _forget_master(self) -> None:
        self._found = False
        if self.master is not None:
            self.master.close()
            self.master = None

    def _join_parameters(self, stack: ExitStack, names: GraphNames) -> None:
        before = self.bus.parameters
        for name, value in self.settings.parameters.items():
            before.set(f"/{self.settings.name}/{name}", value)
        joined = GraphParameters(self.node.ask_master, names, before)
        for name in self._keep:
            if name in before and self.node.ask_master("hasParam", names.to_graph(name)):
                before.delete(name)
        joined.tell_all()
        self.node.registrar.on_return = joined.tell_all
        self.bus.parameters = joined

        def leave() -> None:
            self.bus.parameters = before

        stack.callback(leave)

    def _follow_clock(self, stack: ExitStack) -> None:
        """Where the graph has a clock of its own and nobody on the bus makes one, the bus goes by it."""
        published = any(t.name == CLOCK and t.publishers for t in self.bus.topics())
        if published or self.bus.parameters.get(USE_SIM_TIME, False) is not True:
            return
        clock: Any = self.bus.subscribe(
            CLOCK, "rosgraph_msgs/Clock", lambda message: self.bus.clock.set(message.clock.to_sec()), 1
        )
        stack.callback(clock.close)

    # --- what is told of it ---
    def status(self) -> Ros1Status:
        out = [link for p in self.node.publications() for link in p.links()]
        into = [link for s in self.node.subscriptions() for link in s.links() if link.connected]
        peers = {link.caller for link in out} | {link.publisher for link in into}
        return Ros1Status(
            self.node.name, self.node.master, self.master is not None, self.node.registrar.reachable,
            tuple(sorted(peers)), len(out) + len(into), sum(link.dropped for link in out), self.node.mistakes,
        )  # fmt: skip
