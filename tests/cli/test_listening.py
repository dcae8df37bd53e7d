"""What every server says of its addresses is what the system says; nothing is open before it can answer."""

from __future__ import annotations

import importlib.util
import os
import re
import signal
import socket
import subprocess
import threading
import time
from contextlib import contextmanager

import pytest
from tests.cell.test_setup import small_arm
from tests.cli.helpers import NOD, call, cell_file, start
from tests.drivers.franka.emulated import free_host
from tests.drivers.ur.emulated import free_hosts

from armcell.cli.main import main
from armcell.core.network_endpoints import open_sockets
from armcell.emulators.ur import ControllerSettings, UrRack
from armcell.ros.ros1.xmlrpc import call_method

pytestmark = pytest.mark.slow
LINE = re.compile(r"^listening on (.*)$", re.MULTILINE)
ADDRESS = re.compile(r"(tcp|udp) (\S+):(\d+)(?: \(|,|$)")


@pytest.fixture(autouse=True)
def master(monkeypatch):
    with socket.create_server(("127.0.0.1", 0)) as free:
        uri = f"http://127.0.0.1:{free.getsockname()[1]}"
    monkeypatch.setenv("ROS_MASTER_URI", uri)
    monkeypatch.setenv("ROS_DOMAIN_ID", str(100 + os.getpid() % 100))
    for name in (
        "ROS_IP",
        "ROS_HOSTNAME",
        "ROS_NAMESPACE",
        "ROS_AUTOMATIC_DISCOVERY_RANGE",
        "CYCLONEDDS_URI",
    ):
        monkeypatch.delenv(name, raising=False)
    return uri


@contextmanager
def running(*arguments):
    """A command as a process, and all that it prints, line by line as it comes."""
    process, lines = start(*arguments), []
    assert process.stdout is not None and process.stderr is not None
    readers = [
        threading.Thread(target=lambda s=stream: lines.extend(iter(s.readline, "")), daemon=True)
        for stream in (process.stdout, process.stderr)
    ]
    for reader in readers:
        reader.start()
    try:
        yield process, lines
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
            try:
                process.wait(timeout=30)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        for reader in readers:
            reader.join(5)


def until(condition, process, lines, timeout=120.0):
    end = time.monotonic() + timeout
    while not (found := condition()):
        assert process.poll() is None, "".join(lines)
        assert time.monotonic() < end, "".join(lines)
        time.sleep(0.02)
    return found


def listening(lines) -> set[tuple[str, str, int]]:
    return {
        (protocol, host.strip("[]"), int(port))
        for line in LINE.findall("".join(lines))
        for protocol, host, port in ADDRESS.findall(line)
    }


def real(process) -> set[tuple[str, str, int]]:
    return {(e.protocol, e.host, e.port) for e in open_sockets([process.pid])}


def replayed(tmp_path):
    runs = tmp_path / "runs"
    assert main(["run", str(cell_file(tmp_path, NOD)), "--runs", str(runs), "--mode", "fake"]) == 0
    return ["replay", next(runs.iterdir()), "--port", "0"]


SERVERS = {
    "sim": (1, lambda tmp_path: ["sim", "panda_table", "--ros1", "--mode", "fake"]),
    "view": (1, lambda tmp_path: ["view", "panda_table", "--port", "0"]),
    "run --view": (
        1,
        lambda tmp_path: ["run", cell_file(tmp_path, NOD), "--view", "--port", "0", "--time-scale", "0.02",
                          "--runs", tmp_path / "r"],
    ),
    "replay": (1, replayed),
    "setup --web": (
        1, lambda tmp_path: ["setup", small_arm(tmp_path), "-o", tmp_path / "o", "--web", "--port", "0",
                             "--samples", "200"],
    ),
    "ur-controller": (
        2, lambda tmp_path: ["ur-controller", *(w for h in free_hosts(2) for w in ("--host", h))]
    ),
    "franka-controller": (1, lambda tmp_path: ["franka-controller", "--host", free_host()]),
    "emulate": (
        2,
        lambda tmp_path: ["emulate", "panda_ur10e_handover",
                          "--set", f"real.arms.franka_arm.host={free_host()}",
                          "--set", f"real.arms.ur_arm.host={free_hosts(1)[0]}"],
    ),
}  # fmt: skip


@pytest.mark.cases("setup --web", "emulate", "*-controller")
@pytest.mark.parametrize(("count", "command"), SERVERS.values(), ids=SERVERS)
def test_what_a_server_prints_is_what_it_listens_on(count, command, tmp_path):
    with running(*command(tmp_path)) as (process, lines):
        until(lambda: len(LINE.findall("".join(lines))) >= count, process, lines)
        told = listening(lines)
        assert told and told == real(process), "".join(lines)
        assert all(port for _, _, port in told)


@pytest.mark.long
def test_serve_opens_all_its_wires_when_the_cell_is_ready_and_prints_them(master):
    """ROS 2 is left out where cyclonedds is not installed."""
    dds = importlib.util.find_spec("cyclonedds") is not None
    wires = ["--unity", "--port", "0", "--ros1", "--own-master", *(["--ros2"] if dds else [])]
    began = time.monotonic()
    with running("serve", "panda_table", *wires, "--mode", "fake") as (process, lines):
        until(lambda: real(process), process, lines)
        opened = time.monotonic() - began
        until(lambda: LINE.findall("".join(lines)), process, lines)
        told_of = time.monotonic() - began
        until(lambda: len(LINE.findall("".join(lines))) == 2 + dds, process, lines)
        told, text = listening(lines), "".join(lines)
        assert told == real(process), text
        assert {protocol for protocol, _, _ in told} == ({"tcp", "udp"} if dds else {"tcp"})
        assert f"{master.rpartition(':')[2]} (ROS 1 master)" in text
        if dds:
            assert f"domain {os.environ['ROS_DOMAIN_ID']}, LOCALHOST" in text
        if any(protocol == "udp" and not host.startswith("127.") for protocol, host, _ in told):
            assert "it listens on the network, too" in text
        assert call_method(master, "lookupService", "/test", "/compute_fk").startswith("rosrpc://")
    late = told_of - opened  # the first wire opens when the cell is ready, and is printed at once
    assert late < 0.25 * told_of, f"printed after {told_of:.1f} s, open {late:.1f} s before"


# --- nothing is open before it can answer ---
def test_unity_is_answered_as_soon_as_the_port_is_open(capsys):
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    taken = False

    def connects() -> bool:
        nonlocal taken
        try:
            socket.create_connection(("127.0.0.1", port), timeout=1).close()
            return True
        except OSError:
            pass
        try:
            socket.create_server(("127.0.0.1", port)).close()
        except OSError:
            taken = True  # not open, but nobody else gets it
        return False

    with running("serve", "panda_table", "--unity", "--port", port, "--mode", "fake") as (process, lines):
        until(connects, process, lines)
        assert taken
        fk = ("service", "call", "/compute_fk", "moveit_msgs/GetPositionFK", "{fk_link_names: [panda_hand]}")
        said = call(capsys, *fk, "--connect", f"127.0.0.1:{port}")
        assert said.status == 0 and "val: 1\n" in said.out, said
        said = call(capsys, "topic", "echo", "/joint_states", "-n", "1", "--connect", f"127.0.0.1:{port}")
        assert said.status == 0 and "panda_joint1" in said.out


def test_a_controller_that_does_not_run_yet_refuses():
    """A driver that connects early waits for a controller that answers, not in a queue that nobody reads."""
    (host,) = free_hosts(1)
    rack = UrRack([ControllerSettings("UR10", host)])
    ports = [e.port for e in rack.controllers[0].network.endpoints]
    assert sorted(ports) == [29999, 30001, 30002, 30003, 30004, 30011, 30012, 30013, 63352]
    for port in ports:
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection((host, port), timeout=1)
    with rack:
        for port, asked, answer in (
            (29999, b"", b"Connected"),
            (63352, b"GET POS\n", b"POS"),
            (30004, b"\x00\x05V\x00\x02", b"\x00\x04V"),
            (30001, b"", b"\x00"),
            (30003, b"", b"\x00"),
        ):
            with socket.create_connection((host, port), timeout=5) as link:
                link.sendall(asked)
                assert link.recv(4096).startswith(answer), port
