"""Transports by name: connections of the bus to Unity, ROS 1, ROS 2 or installed packages.

`armcell serve CELL --wire NAME=ADDRESS` opens any registered transport. A package adds one with

    @transports.register("my_wire")
    class MyWire: ...

and the entry point group `armcell.transports`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, Protocol

from armcell.core import InputError, Registry
from armcell.core.network_endpoints import Endpoint
from armcell.ros.bus import Bus
from armcell.ros.ros1 import Ros1Graph, Ros1Settings
from armcell.ros.tcp import RosTcpServer, ServerSettings

LOCAL = "127.0.0.1"


class Transport(Protocol):
    """Transport that carries messages in both directions between the bus and other programs, such as Unity or
    ROS nodes.

    The constructor checks the address and opens nothing. After `close`, no thread runs and no socket listens.
    """

    def reserve(self) -> None:
        """Bind the port on which a transport to Unity or ROS listens, without accepting connections yet.

        Raises:
            InputError: the port is in use, or a required peer does not exist.
        """
        ...

    def start(self) -> None:
        """Start the transport, which then accepts connections.
        The cell on the bus must already be able to answer.
        """
        ...

    def close(self) -> None:
        """Close all connections of a transport to Unity or ROS. The method may be called at any time and
        repeatedly.
        """
        ...

    def ready_message(self) -> str:
        """Return the line to print after the transport has started. It contains the address to which other
        programs connect.
        """
        ...

    def status_text(self) -> str:
        """Return the connected programs and the number of lost messages
        of a transport as text for the status line.

        Raises:
            InputError: the transport has ended.
        """
        ...

    def endpoints(self) -> Iterable[Endpoint]:
        """Return the sockets on which a transport to Unity or ROS listens."""
        ...


TransportFactory = Callable[[Bus, str], Transport]
"""Creates a transport for a bus and an address; an empty address selects the default."""

transports: Registry[TransportFactory] = Registry("transport", "armcell.transports")
"""Transports by name."""


def split_address(address: str, port: int) -> tuple[str, int]:
    """Split the address of a transport, "HOST:PORT" or "HOST", into host and port.

    The defaults are the host 127.0.0.1 and the given port.

    Raises:
        InputError: the port is not a number from 0 to 65535.
    """
    host, _, text = address.partition(":")
    if text and not (text.isdigit() and int(text) < 65536):
        raise InputError(f"address {address!r} has no valid port", hint=f"for example {LOCAL}:{port}")
    return host or LOCAL, int(text) if text else port


def losses(dropped: int, mistakes: int) -> str:
    """Format the numbers of lost and malformed messages of a transport for a status line.
    Zeros are omitted.
    """
    return (f"  dropped {dropped}" if dropped else "") + (f"  mistakes {mistakes}" if mistakes else "")


@transports.register("tcp")
class TcpTransport:
    """Transport to Unity: a server to which Unity's ROS-TCP-Connector connects.

    Args:
        address: HOST:PORT to listen on; port 0 selects a free port.
        protocol: "auto" (follows each client), "ROS1" or "ROS2".
    """

    def __init__(self, bus: Bus, address: str = "", protocol: str = "auto"):
        host, port = split_address(address, 10000)
        self._server = RosTcpServer(bus, ServerSettings(host=host, port=port, protocol=protocol))
        self.reserve, self.start, self.close = self._server.reserve, self._server.start, self._server.close
        self.endpoints = self._server.endpoints

    def ready_message(self) -> str:
        return f"Unity can connect to {self._where()}"

    def status_text(self) -> str:
        clients = self._server.clients()
        names = ", ".join(f"{c.address} {c.protocol}" for c in clients[:3]) or "no client"
        dropped, wrong = sum(c.dropped for c in clients), sum(c.errors for c in clients)
        return f"{self._where()}  {names}" + losses(dropped, wrong)

    def _where(self) -> str:
        host, port = self._server.address
        return f"{host}:{port}"


@transports.register("ros1")
class Ros1Transport:
    """Transport to ROS 1, which joins a ROS 1 graph as a node. If no master is reachable, it starts one.

    Args:
        address: address to listen on; default: loopback, or all interfaces if ROS_IP or ROS_HOSTNAME name a
            network address.
        settings: replaces the settings from the environment and the address.
        keep: topics that keep their last message for new subscribers.
    """

    def __init__(
        self, bus: Bus, address: str = "", settings: Ros1Settings | None = None, keep: tuple[str, ...] = ()
    ):
        from armcell.ros.robot_description import NAME
        from armcell.ros.ros1 import from_environment

        settings = settings or from_environment("armcell", bind=address or None)
        self._graph = Ros1Graph(bus, settings, keep=keep or (NAME,), bus_is_graph=True)
        self.reserve, self.start, self.close = self._graph.reserve, self._graph.start, self._graph.close
        self.endpoints = self._graph.endpoints

    def ready_message(self) -> str:
        own = "its own master" if self._graph.master else "the master"
        return f"ROS 1: node {self._graph.node.name} at {own}, {self._graph.node.master}"

    def status_text(self) -> str:
        if self._graph.ended.is_set():
            raise InputError(f"the ROS 1 node has to end: {self._graph.reason}")
        now = self._graph.status()
        peers = ", ".join(now.peers[:3]) + (" ..." if len(now.peers) > 3 else "")
        words = [
            f"ROS 1 {now.node}  {peers or 'no other node'}",
            "" if now.reachable else "master gone",
            f"dropped {now.dropped}" if now.dropped else "",
            f"mistakes {now.mistakes}" if now.mistakes else "",
        ]
        return "  ".join(word for word in words if word)


@transports.register("ros2")
class Ros2Transport:
    """Transport to ROS 2, which joins a ROS 2 domain as a node.

    Args:
        address: number of the domain; by default ROS_DOMAIN_ID.
        settings: replaces the settings from the environment and the address.
    Raises:
        MissingExtraError: cyclonedds is not installed.
    """

    def __init__(self, bus: Bus, address: str = "", settings: Any = None):
        from armcell.ros.ros2 import Ros2Bridge, Ros2Settings, from_environment
        from armcell.ros.ros2.dds import library

        if address and not address.isdigit():
            raise InputError(f"ROS 2 domain is {address!r}, it must be a number")
        self._settings = settings or Ros2Settings(
            from_environment(int(address) if address else None), "/armcell"
        )
        library()  # report a missing extra before the cell is loaded
        self._bridge = Ros2Bridge(bus, self._settings)
        self.start, self.close, self.endpoints = (
            self._bridge.start,
            self._bridge.close,
            self._bridge.endpoints,
        )

    def reserve(self) -> None:
        """Do nothing, because the ROS 2 transport has no fixed port to reserve.
        DDS chooses its ports when it starts.
        """

    def ready_message(self) -> str:
        reach = self._settings.reach
        peers = f", peers {' '.join(reach.peers)}" if reach.peers else ""
        where = f"domain {reach.domain}, {reach.range}{peers}, {self._settings.distro}"
        return f"ROS 2: node {self._settings.node} ({where})"

    def status_text(self) -> str:
        now = self._bridge.status()
        peers = ", ".join(now.nodes[:3]) + (" ..." if len(now.nodes) > 3 else "")
        words = [
            f"ROS 2 domain {now.domain}  {peers or 'no other node'}",
            f"dropped {now.dropped}" if now.dropped else "",
            f"mistakes {now.errors}" if now.errors else "",
        ]
        return "  ".join(word for word in words if word)
