"""Emulated controllers for tests: in a process of their own, as a robot is."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from contextlib import contextmanager, suppress

import pytest
from tests.programs import Program

SRC = os.path.join(os.path.dirname(__file__), "..", "..", "..", "src")
PORTS = (29999, 30001, 30002, 30003, 30004)


def free_hosts(count: int) -> list[str]:
    """Loopback addresses whose UR ports are free; tests of other workers and worktrees use some as well."""
    found: list[str] = []
    start = 10 + os.getpid() % 200
    for third in range(20, 60):
        host = f"127.0.{third}.{start}"
        try:
            for port in PORTS:
                with socket.socket() as probe:
                    probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                    probe.bind((host, port))
        except OSError:
            continue
        found.append(host)
        if len(found) == count:
            return found
    raise RuntimeError("no free loopback addresses")


def free_port() -> int:
    """A port of this computer for a robot to connect to: the default one may be another test's."""
    with socket.socket() as probe:
        probe.bind(("", 0))
        return probe.getsockname()[1]


@contextmanager
def emulator(*options: str, hosts: list[str]):
    """`armcell ur-controller` at these addresses."""
    command = [sys.executable, "-m", "armcell", "ur-controller", *options]
    for host in hosts:
        command += ["--host", host]
    environment = {**os.environ, "PYTHONPATH": os.path.abspath(SRC)}
    process = Program(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    try:
        with before_others(process.pid):
            for host in hosts:
                _wait(process, host)
            yield process
    finally:
        process.kill()
        process.communicate()


@contextmanager
def before_others(*processes: int):
    """This process and others, such as its emulator, before the machine's other programs, where allowed."""
    usual = os.getpriority(os.PRIO_PROCESS, 0)
    with suppress(PermissionError):  # a busy machine must make neither the driver nor the robot late
        for process in (0, *processes):
            os.setpriority(os.PRIO_PROCESS, process, -10)
    try:
        yield
    finally:
        with suppress(PermissionError):
            os.setpriority(os.PRIO_PROCESS, 0, usual)


@contextmanager
def in_real_time():
    """This thread, and those it starts, before all others of the machine: as `chrt -f 10 armcell run`.

    Skips the test where that is not allowed and the machine has other things to do.
    """
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(10))
    except PermissionError:
        if os.getloadavg()[0] > 0.5 * (os.cpu_count() or 1):
            pytest.skip("no real-time priority here, and the machine is busy")
        yield
        return
    try:
        yield
    finally:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


def _wait(process: subprocess.Popen, host: str) -> None:
    end = time.monotonic() + 120  # the first start on a machine may compile
    while time.monotonic() < end:
        if process.poll() is not None:
            raise RuntimeError(process.communicate()[0])
        try:
            socket.create_connection((host, 29999), 1.0).close()
            return
        except OSError:
            time.sleep(0.1)
    raise RuntimeError("the emulator did not come up")


def dashboard(host: str, *commands: str) -> list[str]:
    """Answers of the dashboard, by a plain socket."""
    with socket.create_connection((host, 29999), 5.0) as sock, sock.makefile("rw", newline="\n") as file:
        file.readline()
        answers = []
        for command in commands:
            file.write(command + "\n")
            file.flush()
            answers.append(file.readline().strip())
        return answers
