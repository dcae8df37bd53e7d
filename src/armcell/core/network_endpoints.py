"""Listening sockets: reserve and open ports, and list the sockets of processes (Linux)."""

from __future__ import annotations

import contextlib
import ipaddress
import os
import re
import socket
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from armcell.core.errors import InputError

PROC = Path("/proc")
_TABLES = {"tcp": "0A", "tcp6": "0A", "udp": "", "udp6": ""}
"""Socket tables in /proc/net with the required state of a row: 0A is LISTEN, empty is any."""


@dataclass(frozen=True, order=True)
class Endpoint:
    """Network endpoint: an address at which a socket accepts TCP connections or receives UDP datagrams.

    Attributes:
        host: numeric address as bound; 0.0.0.0 and :: mean every interface.
        service: human-readable name of the service behind the socket.
    """

    protocol: str
    host: str
    port: int
    service: str = ""

    @classmethod
    def of(cls, sock: socket.socket, service: str = "") -> Endpoint:
        """Create an `Endpoint` that describes the network address of a bound or listening socket."""
        host, port = sock.getsockname()[:2]
        return cls("udp" if sock.type == socket.SOCK_DGRAM else "tcp", host, port, service)

    @property
    def is_local(self) -> bool:
        """Return whether a network address (endpoint) can be reached only by processes on this machine."""
        return ipaddress.ip_address(self.host.partition("%")[0]).is_loopback

    def __str__(self) -> str:
        return f"{self.protocol} {host_in_url(self.host)}:{self.port}" + (
            f" ({self.service})" if self.service else ""
        )


def reserve(host: str, port: int) -> socket.socket:
    """Reserve a TCP port (network endpoint) without opening it: connections are refused until `listen` is
    called.

    A server reserves its port before it loads anything, so that a port in use is an early error, and listens
    when the service behind the port is ready.

    Args:
        port: 0 selects any free port.
    Raises:
        OSError: the port is in use, or the host is not an address of this machine.
    """
    sock = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    try:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # despite connections in TIME_WAIT
        sock.bind((host, port))
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 0)  # no other program may bind it from now on
    except BaseException:
        sock.close()
        raise
    return sock


def listen(sock: socket.socket, backlog: int) -> None:
    """Start accepting connections at a network endpoint: a TCP port that `reserve` has reserved.

    Args:
        backlog: number of connections that may wait to be accepted.
    Raises:
        InputError: another program has taken the port since `reserve`.
    """
    # Allows a port with the last server's connections in TIME_WAIT; accepted connections inherit the option.
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        sock.listen(backlog)
    except OSError as error:
        host, port = sock.getsockname()[:2]
        raise InputError(f"cannot listen on {host}:{port} ({error.strerror})") from None


def host_in_url(host: str) -> str:
    """Format the host of an endpoint for use in a URL; IPv6 addresses are put into brackets."""
    return f"[{host}]" if ":" in host else host


def open_sockets(pids: Iterable[int] | None = None) -> set[Endpoint]:
    """List the network endpoints of the given processes, that is, their listening TCP sockets and bound UDP
    sockets. The data come from /proc.

    Args:
        pids: process IDs; this process by default. Ended processes have no sockets.
    Returns:
        Endpoints without a service name; empty on systems without /proc.
    """
    found: set[Endpoint] = set()
    for pid in [os.getpid()] if pids is None else pids:
        inodes = set()
        for entry in _entries(PROC / str(pid) / "fd"):
            with contextlib.suppress(OSError):  # the socket has closed
                link = os.readlink(entry)
                if link.startswith("socket:["):
                    inodes.add(link.removeprefix("socket:[").removesuffix("]"))
        for table, state in _TABLES.items():
            found |= _rows(PROC / str(pid) / "net" / table, state, inodes)
    return found


def descendants(pid: int) -> list[int]:
    """List the IDs of a process and of all its descendants, whose open sockets (endpoints) can then be
    listed.

    Systems without /proc yield only the process itself.
    """
    children: dict[int, list[int]] = {}
    for entry in _entries(PROC):
        if entry.name.isdigit():
            try:
                stat = (entry / "stat").read_text()
            except OSError:
                continue
            parent = int(stat.rpartition(")")[2].split()[1])
            children.setdefault(parent, []).append(int(entry.name))
    found, rest = [], [pid]
    while rest:
        found.append(rest.pop())
        rest += children.get(found[-1], [])
    return found


def _entries(folder: Path) -> list[Path]:
    try:
        return list(folder.iterdir())
    except OSError:
        return []


def _rows(file: Path, state: str, inodes: set[str]) -> set[Endpoint]:
    """Return the sockets listed in a /proc/net table that belong to the given inodes.
    They are the network endpoints of a process.
    """
    try:
        lines = file.read_text().splitlines()[1:]
    except OSError:  # the process has ended, or the kernel has no IPv6
        return set()
    found = set()
    for line in lines:
        fields = re.split(r"\s+", line.strip())
        if fields[9] in inodes and (not state or fields[3] == state):
            address, _, port = fields[1].partition(":")
            found.add(Endpoint(file.name[:3], _numeric(address), int(port, 16)))
    return found


def _numeric(text: str) -> str:
    """Decode the IP address of a network endpoint from /proc/net, where it is stored as hexadecimal 32-bit
    words in machine byte order.
    """
    words = [int(text[i : i + 8], 16) for i in range(0, len(text), 8)]
    raw = b"".join(word.to_bytes(4, sys.byteorder) for word in words)
    return str(ipaddress.ip_address(raw))
