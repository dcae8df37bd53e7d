"""The kind `franka` of mode real, against an emulated arm in its own process."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import closing, suppress

import numpy as np
import pytest
from tests.drivers.franka.emulated import emulator, operate

from armcell.core import ArmcellError, InputError, JointTrajectory
from armcell.drivers import DriverOptions
from armcell.drivers.execution_handle import ExecutionHandle
from armcell.drivers.franka.arm import REALTIME, FrankaArm
from armcell.drivers.franka.client import FciClient
from armcell.drivers.franka.wire import commands as wire
from armcell.drivers.real import RealDriver
from armcell.emulators.franka import scene_without_cell

pytestmark = pytest.mark.slow
AMPLITUDE = np.array([0.3, 0.1, -0.2, 0.2, 0.2, -0.2, 0.3])


@pytest.fixture(scope="module")
def host() -> Iterator[str]:
    with emulator() as address:
        yield address


@pytest.fixture(autouse=True)
def _fresh(host: str) -> Iterator[None]:
    yield
    for command in ("user stop off", "brakes unlock", "fci on", "hand homed", "hand present", "fault none"):
        assert operate(host, command) == "done"
    operate(host, "reset")


def driver(host: str, **arm) -> RealDriver:
    block = {"host": host, "gripper": {"kind": "hand"}, **arm}
    # a busy machine delays this process; how old a state may be is not under test
    real = {"kind": "franka", "twin": False, "max_state_age": 1.0, "watchdog": 0.5, "arms": {"arm": block}}
    return RealDriver(scene_without_cell(), DriverOptions(extra={"real": real}))


def swing(arm: FrankaArm, duration: float = 1.5) -> JointTrajectory:
    t = np.linspace(0.0, duration, 151)
    w = np.pi / duration
    s, v, a = 0.5 * (1 - np.cos(w * t)), 0.5 * w * np.sin(w * t), 0.5 * w**2 * np.cos(w * t)
    q = arm.setpoint()[0]
    rows = (q + s[:, None] * AMPLITUDE, v[:, None] * AMPLITUDE, a[:, None] * AMPLITUDE)
    return JointTrajectory(arm.joint_names, t, *rows)


def wait(following, states=("running",), seconds: float = 30.0) -> str:
    end = time.monotonic() + seconds
    while following.state() in states and time.monotonic() < end:
        time.sleep(0.01)
    return following.state()


def moving(live: RealDriver, arm: FrankaArm) -> ExecutionHandle:
    """A motion of 6 s that has begun; a busy machine may stop the arm before it moves."""
    for _ in range(3):
        following = live.follow(swing(arm, 6.0))
        while following.state() == "running":
            if np.abs(arm.state["dq"]).max() > 0.02:
                return following
            time.sleep(0.01)
        live.resume()
    raise AssertionError(f"the arm does not begin to move: {live.safety_events}")


def followed(live: RealDriver, arm: FrankaArm) -> tuple[ExecutionHandle, np.ndarray]:
    """A swing to its end, and where it ends; a busy machine may miss 20 commands, which stops the arm."""
    for _ in range(3):
        goal = arm.setpoint()[0] + AMPLITUDE
        following = live.follow(swing(arm))
        if wait(following) == "done" or REALTIME not in str(live.fault()):
            break
        live.resume()
    return following, goal


def franka(live: RealDriver) -> FrankaArm:
    arm = live.arms["arm"]
    assert isinstance(arm, FrankaArm)
    return arm


def measured(host: str) -> np.ndarray:
    return np.array([float(x) for x in operate(host, "state").split()[2:]])


def test_a_trajectory_moves_the_arm_and_the_hand_grasps(host):
    with driver(host) as live:
        arm = franka(live)
        following, goal = followed(live, arm)
        assert following.state() == "done", live.fault()
        assert following.trajectory_time() == pytest.approx(1.5)
        assert np.abs(measured(host) - goal).max() < 1e-3
        assert np.abs(live.joint_state().positions[:7] - goal).max() < 1e-3
        assert np.abs(live.wrench("hand")).max() < 1.0
        live.command_gripper("hand", 0.03, 20.0)
        end = time.monotonic() + 20
        while abs(live.gripper("hand").width - 0.03) > 2e-3 and time.monotonic() < end:
            time.sleep(0.05)
        assert abs(live.gripper("hand").width - 0.03) < 2e-3


@pytest.mark.realtime
def test_a_panda_moves_stops_and_resumes_over_protocol_5():
    with emulator("--model", "panda") as address, driver(address, model="panda") as live:
        arm = franka(live)
        assert (arm.identity.version, arm.identity.model) == (5, "panda")
        goal = arm.setpoint()[0] + AMPLITUDE
        assert wait(live.follow(swing(arm))) == "done", live.fault()
        assert np.abs(measured(address) - goal).max() < 1e-3
        following = moving(live, arm)
        operate(address, "reflex")
        assert wait(following) not in ("done", "running")
        time.sleep(0.5)
        stopped, fault = measured(address), live.fault()
        assert fault is not None and fault.kind == "protective stop"
        live.resume()
        assert live.fault() is None and np.abs(measured(address) - stopped).max() < 2e-3
        assert wait(live.follow(swing(arm))) == "done", live.fault()


@pytest.mark.realtime
def test_a_library_that_hangs_on_damaged_messages_is_replaced(host):
    """libfranka waits for the 3.5 GB that a damaged message announces, and holds a lock meanwhile."""
    pytest.importorskip("franky")
    with driver(host, backend="franky") as live:
        arm = franka(live)
        following = moving(live, arm)
        with suppress(OSError):  # its answer is garbled too
            operate(host, "fault garbage 100")
        assert wait(following) not in ("done", "running")
        end = time.monotonic() + 20
        while live.fault() is not None and time.monotonic() < end:
            time.sleep(0.5)
            with suppress(ArmcellError):  # the hand reconnects after a while
                live.resume()
        assert live.fault() is None
        assert wait(live.follow(swing(arm))) == "done", live.fault()


@pytest.mark.realtime
@pytest.mark.parametrize(
    ("command", "kind"),
    [("reflex", "protective stop"), ("user stop on", "emergency stop"), ("fault drop 0.5", "link lost")],
)
def test_nothing_moves_after_a_stop_before_resume(host, command, kind):
    with driver(host) as live:
        arm = franka(live)
        following = moving(live, arm)
        operate(host, command)
        assert wait(following) != "done"
        end = time.monotonic() + 10
        while live.fault() is None and time.monotonic() < end:
            time.sleep(0.01)
        fault = live.fault()
        # Where the machine is busy, the driver may miss the states before it sees that the link is closed.
        kinds = {kind, "stale state"} if kind == "link lost" else {kind}
        assert fault is not None and fault.kind in kinds
        time.sleep(0.5)
        rests = measured(host)
        with pytest.raises(InputError, match="no motion after a stop"):
            live.follow(swing(arm))
        assert np.abs(measured(host) - rests).max() < 1e-4
        if command == "user stop on":
            with pytest.raises(ArmcellError, match="user stop is pressed"):
                live.resume()
            operate(host, "user stop off")
        end = time.monotonic() + 10
        while True:  # a dropped link refuses connections for a while
            try:
                live.resume()
                break
            except ArmcellError:
                assert time.monotonic() < end
                time.sleep(0.2)
        assert live.fault() is None
        assert np.abs(measured(host) - rests).max() < 1e-3
        assert wait(live.follow(swing(arm))) == "done"


@pytest.mark.long
def test_cancelling_stops_the_arm_and_the_next_motion_runs(host):
    with driver(host) as live:
        arm = franka(live)
        following = moving(live, arm)
        following.cancel()
        assert wait(following) == "cancelled"
        assert live.fault() is None
        assert wait(live.follow(swing(arm))) == "done"


@pytest.mark.parametrize(
    ("command", "arm", "cause"),
    [
        ("brakes lock", {}, r"brakes are locked.*unlock the brakes in Desk"),
        ("user stop on", {}, r"user stop is pressed.*release the user stop"),
        ("fci off", {}, r"(closed the connection|connection to .* broke).*FCI is not active in Desk"),
        ("hand unhomed", {}, r"is not homed.*home it in Desk"),
        ("hand absent", {}, r"no Franka Hand answers.*mount the hand"),
        (
            "displace 0 -0.78 0 -3.06 0 1.57 0.78",
            {},
            r"joint 4 is at -3.06.*outside its limits.*guide the arm",
        ),
        ("state", {"model": "panda"}, r"is a fr3, the cell file says panda"),
        ("state", {"payload": 2.9}, r"payload and hand weigh 3.63 kg, the arm carries 3 kg"),
        ("state", {"payload": 30.0}, r"payload: .*less than or equal to 3"),
        ("state", {"serial": "123"}, r"reports no serial number"),
    ],
)
def test_bad_input_is_rejected_before_anything_moves(host, command, arm, cause):
    operate(host, command)
    before = measured(host)
    with pytest.raises(InputError, match=cause), driver(host, **arm):
        pass
    assert np.abs(measured(host) - before).max() < 1e-4


def test_a_second_client_is_rejected(host):
    with (
        closing(FciClient(host)),
        pytest.raises(InputError, match="another client is connected"),
        driver(host),
    ):
        pass


def _serve(answer: bytes | None, port: int, host: str) -> socket.socket:
    server = socket.create_server((host, port))

    def run() -> None:
        while True:
            try:
                connection, _ = server.accept()
            except OSError:
                return
            if answer is not None:
                connection.recv(100)
                connection.sendall(answer)
            time.sleep(0.2)
            connection.close()

    threading.Thread(target=run, daemon=True).start()
    return server


def test_another_protocol_version_is_named():
    answer = wire.message(0, 1, wire.CONNECTED.pack(1, 7))
    said = r"speaks version 7 .* armcell speaks versions 10 and 5.*system 4.2 on a Panda"
    with _serve(answer, wire.PORT, "127.0.121.7"), pytest.raises(InputError, match=said):
        driver("127.0.121.7").__enter__()


def test_the_address_of_a_ur_is_recognized():
    said = "a Universal Robots controller answers at this address"
    ur = _serve(None, 29999, "127.0.121.8"), _serve(None, 30002, "127.0.121.8")
    with ur[0], ur[1], pytest.raises(InputError, match=said):
        driver("127.0.121.8").__enter__()


@pytest.mark.realtime
def test_streamed_targets_take_over_from_a_trajectory(host):
    with driver(host) as live:
        arm = franka(live)
        following = moving(live, arm)
        target, end = arm.setpoint()[0], live.now + 2.0
        while live.now < end:
            live.command(arm.joint_names, target, np.zeros(7))
            live.advance(live.period)
        assert live.fault() is None and following.state() == "cancelled"
        assert np.abs(measured(host) - target).max() < 1e-3


def test_the_end_of_the_connection_during_a_motion_is_no_reflex(host):
    with driver(host) as live:
        moving(live, franka(live))
    assert operate(host, "state").split()[:2] == ["IDLE", "-"]
    with driver(host) as live:
        assert live.fault() is None
