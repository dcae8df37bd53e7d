"""Bridge between an armcell bus and a ROS 2 domain.

The bridge offers all topics, services and actions of the bus in the domain. It subscribes in the domain to
the topics that the bus subscribes to, and forwards calls and goals to services and actions that only the
domain serves. It follows the bus: whenever a publisher, subscriber or server joins or leaves, it updates.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from armcell._interrupts import deferred, last_will
from armcell.core import ArmcellError, InputError
from armcell.core.network_endpoints import Endpoint
from armcell.ros.bus import Bus, Handler, TopicInfo
from armcell.ros.distros import distro_from_environment
from armcell.ros.names import resolve
from armcell.ros.robot_description import RobotDescriptionPublisher
from armcell.ros.ros2 import names
from armcell.ros.ros2.actions import Ros2ActionClient, Ros2ActionServer
from armcell.ros.ros2.codec import ros2_codec
from armcell.ros.ros2.context import Context
from armcell.ros.ros2.domain_scope import DomainScope, from_environment
from armcell.ros.ros2.parameters import ParameterServices
from armcell.ros.ros2.qos import QosProfile
from armcell.ros.ros2.services import Client, RequestId, Server
from armcell.ros.ros2.topics import IncomingTopic, OutgoingTopic

logger = logging.getLogger(__name__)
LOOK = 0.1  # [s] longest time between two checks of discovery
PERIOD = 1.0  # [s] between two full updates without a change, and between two checks for incompatible peers
SHUT_DOWN = 5.0  # [s]
ACTION_TOPICS = {
    "/goal": "ActionGoal", "/result": "ActionResult", "/feedback": "ActionFeedback",
}  # fmt: skip


@dataclass(frozen=True)
class Ros2Settings:
    """Settings of the bridge between the bus and a ROS 2 domain."""

    reach: DomainScope = field(default_factory=from_environment)
    node: str = "/armcell"  # node name in `ros2 node list`
    distro: str = field(default_factory=distro_from_environment)  # distribution of the message definitions
    qos: Mapping[str, QosProfile] = field(default_factory=dict)  # by topic; others get ROS 2's usual profile
    service_timeout: float = 60.0  # [s] within which a service in the domain must answer

    def __post_init__(self) -> None:
        object.__setattr__(self, "node", resolve(self.node))


@dataclass(frozen=True)
class Ros2Status:
    """State of the bridge to ROS 2, for status lines."""

    domain: int
    nodes: tuple[str, ...]  # full names of the other nodes
    topics_out: int
    topics_in: int
    services: int
    actions: int
    dropped: int
    errors: int


class Ros2Bridge:
    """Bridge between the bus and a ROS 2 domain, active from `start` (or `with`) to `close`.

    Raises (start):
        MissingExtraError: cyclonedds is not installed.
        UnknownNameError: the distribution does not exist.
        InputError, DdsError: the bridge cannot join the domain.
    """

    def __init__(self, bus: Bus, settings: Ros2Settings | None = None):
        self.bus, self.settings = bus, settings or Ros2Settings()
        self._context: Context | None = None
        self._out: dict[str, OutgoingTopic] = {}
        self._in: dict[str, IncomingTopic] = {}
        self._servers: dict[str, tuple[str, Server]] = {}
        self._actions: dict[str, Ros2ActionServer] = {}
        self._reaching: dict[str, Ros2ActionClient] = {}
        self._clients: dict[str, Client] = {}
        self._refused: set[tuple[str, str]] = set()
        self._parameters: ParameterServices | None = None
        self._descriptions = RobotDescriptionPublisher(bus)
        self._lock = threading.Lock()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="ros2 bridge", daemon=True)

    def start(self) -> None:
        codec = ros2_codec(self.bus.schema, self.settings.distro)
        context = Context(self.bus, codec, self.settings.reach, self.settings.node)
        try:
            self._parameters = ParameterServices(context, self.settings.node)
        except ArmcellError:
            context.close()
            raise
        self._context = context
        self._revoke = last_will(self.close)
        self.bus.add_service_finder(self._find)
        self._look(context)
        self._thread.start()

    def __enter__(self) -> Ros2Bridge:
        self.start()
        return self

    def close(self) -> None:
        """Close the bridge and leave the ROS 2 domain and the bus. Further calls have no effect."""
        context = self._context
        if context is None or self._stop.is_set():
            return
        self._stop.set()
        with deferred():
            self._leave(context)
        self._revoke()

    def _leave(self, context: Context) -> None:
        self._thread.join(SHUT_DOWN)
        self.bus.remove_service_finder(self._find)
        parts: list[Any] = [
            self._descriptions,
            self._parameters,
            *self._actions.values(),
            *self._reaching.values(),
        ]
        parts += [*self._out.values(), *self._in.values(), *self._clients.values()]
        parts += [server for _, server in self._servers.values()]
        for part in parts:
            try:
                part.close()
            except ArmcellError as error:
                logger.warning("closing: %s", error)
        context.close()

    def __exit__(self, *exc: object) -> None:
        self.close()

    def endpoints(self) -> tuple[Endpoint, ...]:
        """Return the sockets that DDS opened for the bridge to ROS 2. They are valid after `start`."""
        return self._joined().participant.endpoints

    # --- status and discovery ---
    def status(self) -> Ros2Status:
        """Return the current state of the bridge to ROS 2."""
        context = self._joined()
        return Ros2Status(
            self.settings.reach.domain,
            tuple(context.graph.nodes()),
            len(self._out),
            len(self._in),
            len(self._servers),
            len(self._actions),
            context.dropped,
            context.complaints.total,
        )

    def topics(self) -> dict[str, str]:
        """Return the topics of other ROS 2 nodes that the bridge has discovered,
        as a dict from name to type.
        """
        return self._joined().graph.topics()

    def services(self) -> dict[str, str]:
        """Return the services of other ROS 2 nodes that the bridge has discovered,
        as a dict from name to type.
        """
        return self._joined().graph.services()

    def nodes(self) -> list[str]:
        """Return the full names of the other nodes in the ROS 2 domain that the bridge has joined."""
        return self._joined().graph.nodes()

    def wait_for_node(self, name: str, timeout: float) -> bool:
        """Wait until the bridge discovers another node in the ROS 2 domain. Return False on timeout.

        Args:
            name: full name of the node.
            timeout: limit [s].
        """
        give_up = time.monotonic() + timeout
        while resolve(name) not in self.nodes():
            if time.monotonic() > give_up:
                return False
            time.sleep(LOOK)
        return True

    def _joined(self) -> Context:
        if self._context is None:
            raise InputError("the bridge has not been started")
        return self._context

    # --- services in the domain ---
    def _find(self, name: str) -> Handler | None:
        """Return a function with which the bridge calls a service in the ROS 2 domain,
        or None if no node serves it.
        """
        context = self._joined()
        type_name = context.graph.services().get(name)
        if type_name is None or type_name not in self.bus.schema.services or self._stop.is_set():
            return None
        with self._lock:
            client = self._clients.get(name)
            if client is None or client.type != type_name:
                client = self._clients[name] = Client(context, name, type_name)

        def ask(request: Any) -> Any:
            if request._type != f"{type_name}Request":
                raise InputError(f"service {name} takes {type_name}Request, not {request._type}")
            return client.call(request, self.settings.service_timeout)

        return ask

    # --- following the bus ---
    def _run(self) -> None:
        context = self._joined()
        seen, next_look = (-1, -1), 0.0
        while not self._stop.is_set():
            version = self.bus.wait_change(seen[0], LOOK)
            now, due = (version, context.graph.version), time.monotonic() >= next_look
            if now != seen or due:
                seen = now
                self._look(context)
            for outgoing in self._out.values():
                outgoing.update_subscription()
            if due:
                next_look = time.monotonic() + PERIOD
                for part in (*self._out.values(), *self._in.values()):
                    part.check_qos()

    def _look(self, context: Context) -> None:
        """Create and remove endpoints of the ROS 2 bridge so that they match the topics, services and actions
        of the bus.
        """
        self._descriptions.publish_changes()
        infos = {info.name: info for info in self.bus.topics(besides=self)}
        acting = self._action_names(infos)
        self._look_actions(context, infos, acting)
        topics = [i for i in infos.values() if not _is_of_action(i, acting)]
        latched = {i.name: (i.type, i.latched) for i in topics if i.publishers}
        wanted = {i.name: i.type for i in topics if i.subscribers}
        for name, outgoing in list(self._out.items()):
            if latched.get(name) != (outgoing.type, outgoing.latched):
                self._out.pop(name).close()
        for name, incoming in list(self._in.items()):
            if wanted.get(name) != incoming.type:
                self._in.pop(name).close()
        for name, (type_name, keep) in latched.items():
            if name not in self._out:
                self._try(name, self._out, OutgoingTopic, type_name, keep)
        for name, type_name in wanted.items():
            if name not in self._in:
                self._try(name, self._in, IncomingTopic, type_name)
        for incoming in self._in.values():
            incoming.check_qos()
        self._look_services(context)
        context.announcer.announce()

    def _try(self, name: str, table: dict[str, Any], make: Any, type_name: str, *more: Any) -> None:
        """Let the bridge start forwarding a topic between the bus and ROS 2. If this fails, the bridge
        reports the reason only once.
        """
        if (name, type_name) in self._refused:
            return
        profile = self.settings.qos.get(name)
        try:
            table[name] = make(self._joined(), self, name, type_name, *more, profile=profile)
        except ArmcellError as error:
            self._refused.add((name, type_name))
            self._joined().complain(f"join {name}", f"{name}: {error}")

    def _look_services(self, context: Context) -> None:
        served = self.bus.services()
        for name, (type_name, server) in list(self._servers.items()):
            if served.get(name) != type_name:
                del self._servers[name]
                server.close()
        for name, type_name in served.items():
            if name not in self._servers:
                self._servers[name] = (type_name, self._serve(context, name, type_name))

    def _serve(self, context: Context, name: str, type_name: str) -> Server:
        def on_request(server: Server, request: Any, asked: RequestId) -> None:
            server.reply(asked, self.bus.call(name, request))

        return Server(context, name, type_name, on_request)

    # --- actions, which are ROS 1's five topics on the bus ---
    def _action_names(self, infos: Mapping[str, TopicInfo]) -> dict[str, str]:
        """Return the actions of the bus that the bridge offers in ROS 2, as a dict from action name to type.

        An action is every name with a topic `<name>/goal` whose message is an action goal.
        """
        found = {}
        for info in infos.values():
            action = info.type.removesuffix("ActionGoal")
            if info.name.endswith("/goal") and action != info.type and action in self.bus.schema.actions:
                found[info.name.removesuffix("/goal")] = action
        return found

    def _look_actions(
        self, context: Context, infos: Mapping[str, TopicInfo], acting: Mapping[str, str]
    ) -> None:
        outside = context.graph.services()
        served = {n: t for n, t in acting.items() if infos[f"{n}/goal"].subscribers}
        reached = {
            n: t for n, t in acting.items()
            if n not in served and outside.get(names.action_name(n, t) + names.SEND_GOAL) == f"{t}_SendGoal"
        }  # fmt: skip
        for wanted, table, make in (
            (served, self._actions, Ros2ActionServer),
            (reached, self._reaching, Ros2ActionClient),
        ):
            parts: dict[str, Any] = table  # type: ignore[assignment]
            for name, part in list(parts.items()):
                if wanted.get(name) != part.type and not part.busy:
                    parts.pop(name).close()
            for name, type_name in wanted.items():
                if name not in parts:
                    parts[name] = make(context, self, name, type_name)


def _is_of_action(info: TopicInfo, acting: Mapping[str, str]) -> bool:
    """Return whether a topic of the bus belongs to an action, so that the bridge must not forward the topic
    to ROS 2.

    On the bus, as in ROS 1, an action has five topics. ROS 2 transports actions differently.
    """
    base, _, part = info.name.rpartition("/")
    if base not in acting:
        return False
    return part in ("cancel", "status") or info.type == acting[base] + ACTION_TOPICS.get(f"/{part}", "-")
