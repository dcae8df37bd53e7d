"""`Endpoint`: a socket that others can reach, and the sockets that processes have open (Linux)."""

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
"""Files of /proc/net, and the state that a row must have: 0A is LISTEN; a UDP socket receives in any."""


@dataclass(frozen=True, order=True)
class Endpoint:
    """An address that accepts connections (tcp) or datagrams (udp).

    Attributes:
        host: numeric address as bound; 0.0.0.0 and :: mean every interface.
        service: what answers there; for people.
    """

    protocol: str
    host: str
    port: int
    service: str = ""

    @classmethod
    def of(cls, sock: socket.socket, service: str = "") -> Endpoint:
        """The endpoint of a bound socket."""
        host, port = sock.getsockname()[:2]
        return cls("udp" if sock.type == socket.SOCK_DGRAM else "tcp", host, port, service)

    @property
    def is_local(self) -> bool:
        """Whether only this machine can reach it."""
        return ipaddress.ip_address(self.host.partition("%")[0]).is_loopback

    def __str__(self) -> str:
        return f"{self.protocol} {host_in_url(self.host)}:{self.port}" + (
            f" ({self.service})" if self.service else ""
        )


def reserve(host: str, port: int) -> socket.socket:
    """Take a TCP port without opening it: connections are refused until `listen`.

    A server reserves its port first, so that a port in use is an error before anything is loaded, and listens
    when the service behind the port exists.

    Args:
        port: 0 is any free one.
    Raises:
        OSError: the port is taken, or the host is not an address of this machine.
    """
    sock = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    try:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # despite connections that have just ended
        sock.bind((host, port))
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 0)  # and from now on nobody else may bind it
    except BaseException:
        sock.close()
        raise
    return sock


def listen(sock: socket.socket, backlog: int) -> None:
    """Open a reserved port.

    Args:
        backlog: connections that may wait to be accepted.
    Raises:
        InputError: another program has taken the port in this very moment.
    """
    # Needed despite connections of the last server that have just ended; ours inherit it for the next one.
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        sock.listen(backlog)
    except OSError as error:
        host, port = sock.getsockname()[:2]
        raise InputError(f"cannot listen on {host}:{port} ({error.strerror})") from None


def host_in_url(host: str) -> str:
    """A host as URLs write it: an IPv6 address in brackets."""
    return f"[{host}]" if ":" in host else host


def open_sockets(pids: Iterable[int] | None = None) -> set[Endpoint]:
    """The listening TCP sockets and the bound UDP sockets of processes, read from /proc.

    Args:
        pids: of the processes; this one by default. Those that have ended count as without sockets.
    Returns:
        Endpoints without a service; empty where the system has no /proc.
    """
    found: set[Endpoint] = set()
    for pid in [os.getpid()] if pids is None else pids:
        inodes = set()
        for entry in _entries(PROC / str(pid) / "fd"):
            with contextlib.suppress(OSError):  # closed meanwhile
                link = os.readlink(entry)
                if link.startswith("socket:["):
                    inodes.add(link.removeprefix("socket:[").removesuffix("]"))
        for table, state in _TABLES.items():
            found |= _rows(PROC / str(pid) / "net" / table, state, inodes)
    return found


def descendants(pid: int) -> list[int]:
    """A process and all that it started, directly or not; only itself where the system has no /proc."""
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
    """Rows of a table of /proc/net that belong to some of the inodes."""
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
    """An address of /proc/net: 32-bit words in the byte order of this machine, in hexadecimal."""
    words = [int(text[i : i + 8], 16) for i in range(0, len(text), 8)]
    raw = b"".join(word.to_bytes(4, sys.byteorder) for word in words)
    return str(ipaddress.ip_address(raw))
