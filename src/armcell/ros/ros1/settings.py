"""Names, addresses and remappings of a ROS 1 node, from arguments and environment variables.

Source: wiki.ros.org/ROS/EnvironmentVariables and wiki.ros.org/Remapping%20Arguments. One intended difference:
without ROS_IP, ROS_HOSTNAME or a bind address, the node listens on loopback only, not on every interface.
"""

from __future__ import annotations

import os
import re
import socket
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any
from urllib.parse import urlsplit

import yaml

from armcell.core import InputError

MASTER = "http://localhost:11311"
PORT = 11311
_NODE = re.compile(r"^[A-Za-z][A-Za-z0-9_]*$")


@dataclass(frozen=True)
class Ros1Settings:
    """Settings of a ROS 1 node: its name and addresses. `from_environment` fills in missing values."""

    name: str = "armcell"  # node name without namespace
    namespace: str = "/"
    master: str = MASTER  # XML-RPC address of the master
    own_master: bool | None = None  # built-in master: True always, False never, None if no other is reachable
    host: str = "127.0.0.1"  # address that other nodes connect to
    bind: str = "127.0.0.1"  # address to listen on
    remap: Mapping[str, str] = field(default_factory=dict)  # remappings before resolution: from -> to
    parameters: Mapping[str, Any] = field(default_factory=dict)  # private parameters, names without ~
    queue: int = 100  # messages that may wait for one subscriber; a full queue drops its oldest
    queue_bytes: int = 16 << 20  # bytes that may wait for one subscriber; one message is always kept
    max_message: int = 256 << 20  # [bytes] maximum of a message or request; a longer one ends the connection
    timeout: float = 5.0  # [s] for a peer to connect and to send its header

    def __post_init__(self) -> None:
        if not _NODE.match(self.name):
            raise InputError(f"{self.name!r} is no node name", hint="letters, digits and _, a letter first")
        host_and_port(self.master)

    @property
    def master_address(self) -> tuple[str, int]:
        return host_and_port(self.master)

    @property
    def is_local(self) -> bool:
        """Return whether only programs on this machine can connect to a ROS 1 node with these settings."""
        return is_loopback(self.bind)


def from_environment(
    name: str, arguments: Iterable[str] = (), bind: str | None = None,
    environment: Mapping[str, str] | None = None, **changes: Any,
) -> Ros1Settings:  # fmt: skip
    """Return the settings of a ROS 1 node from command-line arguments and environment variables.

    Args:
        arguments: remappings, each `from:=to`, `_private:=value`, `__name:=`, `__ns:=`, `__ip:=`,
            `__hostname:=` or `__master:=`.
        bind: address to listen on; by default loopback, or all interfaces if ROS_HOSTNAME or ROS_IP name an
            address that is not loopback.
        environment: environment variables; None reads those of this process.
        changes: fields of `Ros1Settings` to override.
    Raises:
        InputError: an argument is not a remapping, or an address is invalid.
    """
    env = os.environ if environment is None else environment
    remap, special = split_arguments(arguments)
    host = special.pop("__hostname", "") or special.pop("__ip", "")
    host = host or env.get("ROS_HOSTNAME", "") or env.get("ROS_IP", "")
    if "://" in host:
        raise InputError(
            f"ROS_HOSTNAME or ROS_IP is {host!r}", hint="the bare name or address of this machine"
        )
    if bind is None:
        bind = "127.0.0.1" if not host or is_loopback(host) else "0.0.0.0"
    if not host:
        host = bind if bind not in ("0.0.0.0", "") else own_address()
    settings = Ros1Settings(
        name=special.pop("__name", name),
        namespace="/" + (special.pop("__ns", "") or env.get("ROS_NAMESPACE", "")).strip("/"),
        master=special.pop("__master", "") or env.get("ROS_MASTER_URI", "") or MASTER,
        host=host,
        bind=bind,
        remap=remap,
        parameters={k[1:]: _value(v) for k, v in special.items() if not k.startswith("__")},
    )
    return replace(settings, **changes)


def split_arguments(arguments: Iterable[str]) -> tuple[dict[str, str], dict[str, str]]:
    """Split the arguments of a ROS 1 node into remappings and special arguments such as `__name:=...`.

    Raises:
        InputError: an argument is not of the form from:=to.
    """
    remap: dict[str, str] = {}
    special: dict[str, str] = {}
    for argument in arguments:
        before, colon, after = argument.partition(":=")
        if not (colon and before and (after or before.startswith("_"))):
            raise InputError(f"{argument!r} is no remapping", hint="write from:=to, as for a ROS program")
        (special if before.startswith("_") else remap)[before.strip()] = after.strip()
    return remap, special


def _value(text: str) -> Any:
    """Parse the value of a private parameter on the command line of a ROS 1 node as YAML, like rosrun."""
    try:
        return yaml.safe_load(text)
    except yaml.YAMLError:
        return text


def host_and_port(uri: str, scheme: str = "http") -> tuple[str, int]:
    """Return the host and port in an address (`http://host:port/`) from the settings of a ROS 1 node. The
    default port is 11311.

    Raises:
        InputError: the address is invalid.
    """
    try:
        parts = urlsplit(uri)
        if parts.scheme == scheme and parts.hostname:
            return parts.hostname, PORT if parts.port is None else parts.port
    except ValueError:
        pass
    raise InputError(f"{uri[:100]!r} is no address", hint=f"write {scheme}://HOST:PORT")


def is_loopback(host: str) -> bool:
    return host in ("localhost", "::1") or host.startswith("127.")


def is_this_machine(host: str) -> bool:
    """Return whether an address or host name in a ROS 1 node's settings belongs to this machine."""
    if is_loopback(host) or host in (socket.gethostname(), "0.0.0.0"):
        return True
    try:
        address = socket.gethostbyname(host)
        with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
            probe.bind((address, 0))  # succeeds only for an address of this machine
        return True
    except OSError:
        return False


def own_address() -> str:
    """Return this machine's address for the settings of a ROS 1 node: the address on the default route, under
    which other machines reach the node.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))  # documentation address (RFC 5737); UDP sends nothing here
            return str(probe.getsockname()[0])
        except OSError:
            return "127.0.0.1"
