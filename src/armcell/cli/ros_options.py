"""ROS options of a command: namespace, remappings, and the connection to a ROS 1 graph or a ROS 2 domain."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import typer

from armcell.cli.console import err
from armcell.core import InputError
from armcell.core.network_endpoints import Endpoint

if TYPE_CHECKING:
    from armcell.ros.names import NameMap
    from armcell.ros.transports import Transport


NAMESPACE = typer.Option(
    "", "--ns", metavar="NAMESPACE", show_default=False,
    help="Put all names into a namespace, on every wire: --ns arm_left gives /arm_left/joint_states.",
)  # fmt: skip

REMAP = typer.Option(
    None, "--remap", metavar="FROM:=TO", show_default=False,
    help="Rename a topic, service or action on every wire; repeat it for several.",
)  # fmt: skip

ARGUMENTS = typer.Argument(
    None, metavar="[FROM:=TO]...", show_default=False,
    help="As for a ROS program: remappings, __ns:= and, with --ros1, __name:= and private parameters.",
)  # fmt: skip


@dataclass(frozen=True)
class RosNameOptions:
    """Command-line options for ROS names: the namespace and the remappings.

    Attributes:
        namespace: the namespace for all names; empty for none.
        remap: remappings FROM:=TO.
        special: ROS 1 arguments that begin with an underscore.
    """

    namespace: str
    remap: tuple[str, ...]
    special: tuple[str, ...]

    @property
    def command_line(self) -> list[str]:
        """Return the ROS namespace and the remappings in the form of
        command line options, for the record of a run.
        """
        space = ["--ns", self.namespace] if self.namespace else []
        return space + [word for pair in self.remap for word in ("--remap", pair)]

    def map_for(self, cell: Any) -> NameMap | None:
        """Return the map from a cell's ROS names to the names on the bus, or None if they are equal.
        Command-line options override the cell file.

        Raises:
            InputError: a name is invalid, or two names become equal.
        """
        from armcell.ros.names import name_map

        spec = cell.spec.ros
        pairs = (*(f"{before}:={after}" for before, after in spec.remap.items()), *self.remap)
        return name_map("armcell", self.namespace or spec.namespace, pairs)


def parse_ros_names(
    namespace: str, remap: list[str] | None, arguments: list[str] | None, ros1: bool
) -> RosNameOptions:
    """Parse the command line options for ROS names.
    With ROS 1, the environment variable ROS_NAMESPACE is the default namespace.

    Raises:
        InputError: the namespace is invalid, an argument is not a remapping, or an argument applies to ROS 1
            only.
    """
    from armcell.ros.names import name_map

    special = [a for a in arguments or () if a.startswith("_")]
    spaces = [a for a in special if a.startswith("__ns:=")]
    rest = tuple(a for a in special if a not in spaces)
    if rest and not ros1:
        raise InputError(f"argument {rest[0]!r} applies to ROS 1 alone", hint="add --ros1")
    namespace = namespace or "".join(a.partition(":=")[2] for a in spaces[-1:])
    namespace = (namespace or (os.environ.get("ROS_NAMESPACE", "") if ros1 else "")).strip("/")
    pairs = (*(a for a in arguments or () if not a.startswith("_")), *(remap or ()))
    name_map("armcell", namespace, pairs)
    return RosNameOptions(namespace, pairs, rest)


def unused_remappings_warning(bus: Any) -> str:
    """Return the warning that a command with ROS options prints if a remapped name matches no topic, service
    or action of the cell. The text is empty otherwise.
    """
    if bus.names is None:
        return ""
    have = {t.name for t in bus.topics()} | set(bus.services())
    have |= {name.rpartition("/")[0] for name in have if name.endswith("/goal")}
    odd = [name for name in bus.names.remappings if name not in have]
    return f"the cell has no topic, service or action {', '.join(odd)}: nothing is remapped" if odd else ""


ROS1 = typer.Option(
    False, "--ros1", help="Join the ROS 1 graph at ROS_MASTER_URI; start a master where there is none."
)

OWN_MASTER = typer.Option(
    None, "--own-master/--no-own-master", show_default=False,
    help="With --ros1: always start an own master, or never.",
)  # fmt: skip


class OpenTransport(NamedTuple):
    """Transport that an armcell command has opened between its message bus and ROS or another program.

    Attributes:
        ready: the message to print when the cell is ready.
        status: returns the text for the status line.
        endpoints: the sockets that listen.
    """

    ready: str
    status: Callable[[], str]
    endpoints: Iterable[Endpoint]


Join = Callable[[], OpenTransport]

"""Connects the bus. The connection was checked and its port reserved before the cell was loaded.

Call it when the cell is ready: afterwards, other programs can reach the cell.
"""


def join_ros1(
    stack: ExitStack, bus: Any, name: str, own_master: bool | None, naming: RosNameOptions, bind: str | None
) -> Join:
    """Find a ROS 1 master or, if allowed, start the built-in master. Return a function that connects a
    command's message bus to the ROS 1 graph of this master.

    Args:
        own_master: True starts a built-in master, False never does, None does if no master is reachable.
        bind: address to listen on.
    Raises:
        InputError: there is no master, or the address cannot be used.
    """
    from armcell.ros.robot_description import NAME
    from armcell.ros.ros1 import from_environment
    from armcell.ros.transports import Ros1Transport

    found = from_environment(name, naming.special, bind, own_master=own_master)
    settings = replace(found, namespace=f"/{naming.namespace}")
    description = NAME if not naming.namespace else f"/{naming.namespace}{NAME}"
    connect = reserve_transport(stack, Ros1Transport(bus, "", settings, keep=(description,)))
    if not settings.is_local:
        err(f"{settings.bind}: every machine in the network can move the cell (no password, no encryption)")
    return connect


def reserve_transport(stack: ExitStack, transport: Transport) -> Join:
    """Reserve the port of a transport (ROS 1, Unity) that the options of a command request, and return a
    function that opens the transport.

    Raises:
        InputError: the port is in use.
    """
    stack.callback(transport.close)
    transport.reserve()

    def joined() -> OpenTransport:
        transport.start()
        return OpenTransport(transport.ready_message(), transport.status_text, transport.endpoints())

    return joined


def check_own_master(ros1: bool, own_master: bool | None) -> None:
    """Check that the ROS 1 option --own-master is used only with --ros1.

    Raises:
        InputError: --own-master without --ros1.
    """
    if not ros1 and own_master is not None:
        raise InputError("--own-master means nothing here", hint="it goes with --ros1")


ROS2 = typer.Option(
    False, "--ros2", help="Join a ROS 2 domain (extra ros2): ROS_DISTRO, ROS_AUTOMATIC_DISCOVERY_RANGE, ..."
)

DOMAIN = typer.Option(
    None, "--domain", min=0, max=232, show_default=False,
    help="With --ros2: the domain, instead of ROS_DOMAIN_ID.",
)  # fmt: skip


def join_ros2(
    stack: ExitStack, bus: Any, node: str, domain: int | None, bind: str | None = None, namespace: str = ""
) -> Join:
    """Read the ROS 2 options of a command, and return a function that joins the domain.

    The exit stack leaves the domain when it closes.

    Args:
        bind: an address that is not this machine's own allows other machines to connect.
    Raises:
        MissingExtraError: cyclonedds is not installed.
        InputError: an environment variable is wrong, or the domain cannot be joined.
    """
    from armcell.ros import Ros2Settings
    from armcell.ros.ros2 import from_environment
    from armcell.ros.transports import Ros2Transport

    reach = from_environment(domain, network=bind not in (None, "127.0.0.1", "localhost"))
    settings = Ros2Settings(reach, f"/{namespace}/{node}" if namespace else f"/{node}")
    connect = reserve_transport(stack, Ros2Transport(bus, "", settings))
    if reach.is_open:
        err("ROS 2: every machine in the network can move the cell (no password, no encryption)")

    def joined() -> OpenTransport:
        wire = connect()
        if not reach.is_open and not all(endpoint.is_local for endpoint in wire.endpoints):
            err(
                "ROS 2: DDS looks for nodes on this machine alone, but it listens on the network, too: "
                "a machine that names this one as its peer can move the cell; hint: a firewall"
            )
        return wire

    return joined


def check_domain(ros2: bool, domain: int | None) -> None:
    """Check that the ROS 2 option --domain is used only with --ros2.

    Raises:
        InputError: --domain without --ros2.
    """
    if domain is not None and not ros2:
        raise InputError("--domain means nothing here", hint="it goes with --ros2")
