"""Addresses as the system has them, and ports that are taken before they are opened."""

from __future__ import annotations

import os
import socket
import subprocess
import sys

import pytest

from armcell.core.network_endpoints import Endpoint, descendants, listen, open_sockets, reserve


def test_open_sockets_are_those_of_the_process():
    before = open_sockets()
    with (
        socket.create_server(("127.0.0.1", 0)) as tcp,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp,
        socket.create_connection(tcp.getsockname()),  # a connection is nothing that listens
    ):
        udp.bind(("127.0.0.3", 0))
        assert open_sockets() - before == {Endpoint.of(tcp), Endpoint.of(udp)}
        assert [str(Endpoint.of(s, "x")) for s in (tcp, udp)] == [
            f"tcp 127.0.0.1:{tcp.getsockname()[1]} (x)", f"udp 127.0.0.3:{udp.getsockname()[1]} (x)"
        ]  # fmt: skip
    assert open_sockets() == before
    assert open_sockets([2**22 + 1]) == set()  # no such process


@pytest.mark.skipif(not socket.has_ipv6, reason="no IPv6 here")
def test_ipv6():
    before = open_sockets()
    try:
        server = socket.create_server(("::1", 0), family=socket.AF_INET6)
    except OSError:
        pytest.skip("no IPv6 loopback here")
    with server:
        (found,) = open_sockets() - before
        assert found == Endpoint.of(server) and str(found) == f"tcp [::1]:{found.port}" and found.is_local


def test_who_can_reach_it():
    assert Endpoint("tcp", "127.0.0.2", 1).is_local
    assert not Endpoint("tcp", "0.0.0.0", 1).is_local and not Endpoint("udp", "::", 1).is_local


def test_sockets_of_what_a_process_has_started():
    code = """
import socket, subprocess, sys
if len(sys.argv) > 1:
    subprocess.run([sys.executable, "-c", sys.argv[1]])
else:
    s = socket.create_server(("127.0.0.1", 0)); print(s.getsockname()[1], flush=True); input()
"""
    process = subprocess.Popen(
        [sys.executable, "-c", code, code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    port = int(process.stdout.readline())
    assert process.pid in descendants(os.getpid()) and len(descendants(process.pid)) == 2
    assert open_sockets(descendants(process.pid)) == {Endpoint("tcp", "127.0.0.1", port)}
    assert open_sockets([process.pid]) == set()
    process.communicate("\n", timeout=10)


def test_a_reserved_port_refuses_until_it_listens_and_nobody_else_gets_it():
    port = 0
    for _ in range(3):  # what is left of the connections before does not keep the port
        sock = reserve("127.0.0.1", port)
        port = sock.getsockname()[1]
        with sock:
            for host in ("127.0.0.1", "0.0.0.0"):
                with pytest.raises(OSError, match="in use"):
                    socket.create_server((host, port))
            with pytest.raises(OSError, match="in use"):
                reserve("127.0.0.1", port)
            with pytest.raises(ConnectionRefusedError):
                socket.create_connection(("127.0.0.1", port))
            listen(sock, 8)
            with socket.create_connection(("127.0.0.1", port)) as client:
                accepted, _ = sock.accept()
                accepted.shutdown(socket.SHUT_RDWR)
                accepted.close()
                client.recv(1)
