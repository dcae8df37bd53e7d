"""The emulated robot driven in the manner of UR's external control, by a peer of the published protocol."""

import socket
import struct
import time

import numpy as np
import pytest
from tests.drivers.ur import external_control_peer as peers
from tests.drivers.ur.emulated import dashboard, emulator, free_hosts
from tests.drivers.ur.external_control_peer import ExternalControlPeer

from armcell.drivers.ur.rtde_client import RtdeClient

pytestmark = [pytest.mark.slow, pytest.mark.realtime]
MOVE = np.array([0.4, -0.2, 0.2, 0.1, 0.2, 0.3])
ZERO = np.zeros(6)


class Robot:
    """An emulated arm whose program comes from a peer, and its state over RTDE."""

    def __init__(self, host: str, peer: ExternalControlPeer, unserved: str):
        self.host, self.peer, self.unserved = host, peer, unserved
        self._rtde = RtdeClient(host, 125)
        self._rtde.connect()

    @property
    def state(self):
        return self._rtde.latest

    @property
    def q(self):
        return np.array(self.state.actual_q)

    def play(self) -> None:
        dashboard(self.host, "stop")
        assert dashboard(self.host, "play") == ["Starting program"]
        self.peer.wait()

    def ended(self, within: float) -> bool:
        end = time.monotonic() + within
        while time.monotonic() < end and self.state.runtime_state != 1:
            time.sleep(0.02)
        return self.state.runtime_state == 1


def payload_of(host: str) -> float:
    """What RTDE says, by bare frames."""
    with socket.create_connection((host, 30004), 5.0) as sock, sock.makefile("rb") as file:
        sock.sendall(
            b"\x00\x05V\x00\x02" + b"\x00\x12O" + struct.pack(">d", 125.0) + b"payload" + b"\x00\x03S"
        )
        while True:
            size, kind = struct.unpack(">HB", file.read(3))
            body = file.read(size - 3)
            if kind == ord("U"):
                return struct.unpack(">d", body[1:])[0]


@pytest.fixture(scope="module")
def robot():
    host, unserved = hosts = free_hosts(2)
    with ExternalControlPeer() as peer:
        senders = [
            "--external-control",
            f"127.0.0.1:{peer.ports['sender']}",
            "--external-control",
            "127.0.0.1:1",
        ]
        with emulator(*senders, hosts=hosts):
            assert dashboard(host, "play") == ["Failed to execute: play"]  # nothing is loaded
            assert dashboard(host, "load another.urp")[0].startswith("Error while loading")
            loading, loaded = dashboard(host, "load external_control.urp", "get loaded program")
            assert loading == "Loading program: external_control.urp" and loaded.endswith(
                "/external_control.urp"
            )
            yield Robot(host, peer, unserved)


def test_servo_follows_and_the_receive_timeout_ends_it(robot):
    robot.play()
    assert dashboard(robot.host, "programState") == ["PLAYING external_control.urp"]
    goal = robot.q + 0.1 * MOVE
    robot.peer.keep(peers.SERVOJ, goal, 0.6)
    np.testing.assert_allclose(robot.q, goal, atol=1e-3)
    robot.peer.keep(peers.IDLE, ZERO, 0.3)
    assert robot.state.runtime_state == 2
    robot.peer.write(peers.SPEEDJ, [0.2, 0, 0, 0, 0, 0], timeout_ms=100)
    assert robot.ended(1.0)  # no further message came within its 100 ms
    time.sleep(0.2)
    assert np.abs(robot.state.actual_qd).max() < 1e-6


def test_speeds_of_joints_and_of_the_tool(robot):
    robot.play()
    robot.peer.keep(peers.SPEEDJ, [0, 0, 0, 0, 0, 0.3], 0.5)
    assert robot.state.actual_qd[5] == pytest.approx(0.3, abs=0.01)
    robot.peer.keep(peers.IDLE, ZERO, 0.3)
    robot.peer.keep(peers.SPEEDL, [0, 0, 0.05, 0, 0, 0], 0.2)
    first = robot.state
    robot.peer.keep(peers.SPEEDL, [0, 0, 0.05, 0, 0, 0], 0.4)
    way = np.subtract(robot.state.actual_TCP_pose[:3], first.actual_TCP_pose[:3])
    np.testing.assert_allclose(way / (robot.state.timestamp - first.timestamp), [0, 0, 0.05], atol=2e-3)
    robot.peer.write(peers.STOPPED)
    assert robot.ended(1.0)


@pytest.mark.parametrize("kind", [peers.CUBIC, peers.QUINTIC], ids=["cubic", "quintic"])
def test_splines_are_followed_in_between(robot, kind):
    """Against the cosine they were made from."""
    robot.play()
    robot.peer.write(peers.IDLE)
    time.sleep(0.1)
    T, q0 = 1.6, robot.q
    t = np.linspace(0, T, 9)[1:, None]
    w = np.pi / T
    q, v, a = (
        q0 + (1 - np.cos(w * t)) / 2 * MOVE,
        w / 2 * np.sin(w * t) * MOVE,
        w * w / 2 * np.cos(w * t) * MOVE,
    )
    stretch = [(*row, T / 8, kind, peers.SPLINE) for row in zip(q, v, a, strict=True)]
    robot.peer.forward(stretch)
    seen = []
    began = time.monotonic()
    while time.monotonic() - began < 1.3:
        seen.append((robot.state.timestamp, np.array(robot.state.target_q)))
        time.sleep(0.01)
    assert robot.peer.result(5.0) == peers.SUCCESS
    np.testing.assert_allclose(robot.q, q[-1], atol=1e-3)
    stamps, path = np.array([s for s, _ in seen]), np.array([p for _, p in seen])
    share = (path[:, 0] - q0[0]) / MOVE[0]  # where it is tells when it was, up to when it began
    inside = (share > 0.05) & (share < 0.95)
    assert inside.sum() > 20
    begun = stamps[inside] - np.arccos(1 - 2 * share[inside]) / w
    assert np.ptp(begun) < (0.03 if kind == peers.CUBIC else 0.015)
    np.testing.assert_allclose(path, q0 + share[:, None] * MOVE, atol=1e-3)
    robot.peer.write(peers.STOPPED)
    assert robot.ended(1.0)


def test_moves_of_joints_and_straight_lines_cancel_and_bad_points(robot):
    robot.play()
    robot.peer.write(peers.IDLE)
    how = ([0] * 6, [0.8, 1.5, 0, 0, 0, 0])  # speed and acceleration stand where splines have accelerations
    goal = robot.q - 0.5 * MOVE
    robot.peer.forward([(goal, *how, 0.0, 0.0, peers.MOVEJ)])
    assert robot.peer.result(10.0) == peers.SUCCESS
    np.testing.assert_allclose(robot.q, goal, atol=1e-3)
    pose = np.add(robot.state.actual_TCP_pose, [0, 0, 0.05, 0, 0, 0])
    robot.peer.forward([(pose, *how, 2.0, 0.0, peers.MOVEL)])
    assert robot.peer.result(10.0) == peers.SUCCESS
    np.testing.assert_allclose(robot.state.actual_TCP_pose, pose, atol=1e-3)
    robot.peer.forward([(robot.q + MOVE, ZERO, ZERO, 4.0, peers.CUBIC, peers.SPLINE)])
    time.sleep(0.5)
    robot.peer.cancel()
    assert robot.peer.result(2.0) == peers.CANCELLED
    rest = robot.q
    time.sleep(0.2)
    np.testing.assert_allclose(robot.q, rest, atol=1e-4)
    robot.peer.forward([(robot.q, ZERO, ZERO, 1.0, 7, peers.SPLINE)])
    assert robot.peer.result(2.0) == peers.FAILURE
    robot.peer.payload(1.5)
    robot.peer.keep(peers.IDLE, ZERO, 0.2)
    assert payload_of(robot.host) == pytest.approx(1.5)
    robot.peer.write(peers.STOPPED)
    assert robot.ended(1.0)


def test_a_client_that_sends_its_program_itself(robot):
    """Headless, as UR's driver calls it: the same text as a function, to the primary port."""
    dashboard(robot.host, "stop")
    with socket.create_connection((robot.host, 30001), 5.0) as primary:
        primary.sendall(f"def externalControl():\n{robot.peer.program}\nend\n".encode())
        robot.peer.wait()
        assert dashboard(robot.host, "programState") == ["PLAYING externalControl"]
        goal = robot.q + 0.1 * MOVE
        robot.peer.keep(peers.SERVOJ, goal, 0.6)
        np.testing.assert_allclose(robot.q, goal, atol=1e-3)
    robot.peer.write(peers.STOPPED)
    assert robot.ended(1.0)


def test_nobody_sends_a_program(robot):
    answers = dashboard(robot.unserved, "load external_control.urp", "play", "armcell messages")
    assert answers[1] == "Failed to execute: play" and "no host at 127.0.0.1:1" in answers[2]
