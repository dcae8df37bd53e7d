"""Emulated Franka arms for tests: in a process of their own, as a robot is."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from contextlib import contextmanager, suppress

from tests.programs import Program

from armcell.emulators.franka.operator_server import PORT as OPERATOR

SRC = os.path.join(os.path.dirname(__file__), "..", "..", "..", "src")
PORTS = (1337, 1338, OPERATOR)


def free_host() -> str:
    """A loopback address whose Franka ports are free; tests of other workers use some as well."""
    last = 10 + os.getpid() % 200
    for third in range(60, 120):
        host = f"127.0.{third}.{last}"
        with suppress(OSError):
            for port in PORTS:
                with socket.socket() as probe:
                    probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                    probe.bind((host, port))
            return host
    raise RuntimeError("no free loopback address")


@contextmanager
def emulator(*options: str):
    """`armcell franka-controller` at a free address, which it yields."""
    host = free_host()
    with emulators("franka-controller", "--host", host, *options, host=host):
        yield host


@contextmanager
def emulators(*words: str, host: str):
    """A command of armcell that emulates robots, from when the Franka arm at `host` answers."""
    command = [sys.executable, "-m", "armcell", *words]
    process = Program(
        command, env={**os.environ, "PYTHONPATH": os.path.abspath(SRC)}, stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT, text=True,
    )  # fmt: skip
    try:
        end = time.monotonic() + 120
        while True:
            if process.poll() is not None:
                raise RuntimeError(process.communicate()[0])
            with suppress(OSError):
                operate(host, "state")
                break
            assert time.monotonic() < end, "the emulator did not come up"
            time.sleep(0.1)
        yield
    finally:
        process.kill()
        process.communicate()


def operate(host: str, command: str) -> str:
    """Answer of the emulator's operator port."""
    with (
        socket.create_connection((host, OPERATOR), 5.0) as sock,
        sock.makefile("rw", errors="replace") as file,
    ):
        file.write(command + "\n")
        file.flush()
        return file.readline().strip()
