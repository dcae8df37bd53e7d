"""The emulator taken for a robot by ur_rtde, a client we did not write (PyPI; no wheel for Python 3.13)."""

import time

import numpy as np
import pytest
from tests.drivers.ur.emulated import dashboard, emulator, free_hosts

rtde_control = pytest.importorskip(
    "rtde_control", reason="ur_rtde is not installed (it has no wheel for 3.13)"
)
rtde_receive = pytest.importorskip("rtde_receive")
rtde_io = pytest.importorskip("rtde_io")
dashboard_client = pytest.importorskip("dashboard_client")

pytestmark = [pytest.mark.slow, pytest.mark.realtime]


@pytest.fixture(scope="module", params=["UR10", "UR10e"])
def robot(request):
    (host,) = free_hosts(1)
    with emulator("--model", request.param, hosts=[host]):
        receive = rtde_receive.RTDEReceiveInterface(host)
        control = rtde_control.RTDEControlInterface(host)
        yield host, receive, control
        control.stopScript()
        control.disconnect()
        receive.disconnect()


def settle(receive) -> None:
    end = time.monotonic() + 3.0
    while time.monotonic() < end and np.abs(receive.getActualQd()).max() > 1e-3:
        time.sleep(0.02)


def wait(receive, seconds: float) -> None:
    """Wait by the robot's clock, which is slower than the wall's on a busy machine."""
    start, end = receive.getTimestamp(), time.monotonic() + 30.0
    while receive.getTimestamp() < start + seconds and time.monotonic() < end:
        time.sleep(0.01)


def test_receive(robot):
    _, receive, _ = robot
    assert receive.isConnected() and receive.getRobotMode() == 7 and receive.getSafetyMode() == 1
    before = receive.getTimestamp()
    wait(receive, 0.1)
    assert receive.getTimestamp() > before + 0.09
    assert len(receive.getActualTCPPose()) == 6 and receive.getSpeedScaling() == 1.0


def test_move_j_and_l(robot):
    _, receive, control = robot
    goal = np.add(receive.getActualQ(), [0.2, -0.1, 0.1, 0.0, 0.1, 0.3])
    assert control.moveJ(list(goal), 1.0, 2.0)
    settle(receive)
    np.testing.assert_allclose(receive.getActualQ(), goal, atol=1e-3)
    pose = receive.getActualTCPPose()
    pose[2] += 0.06
    assert control.moveL(pose, 0.25, 1.2)
    settle(receive)
    np.testing.assert_allclose(receive.getActualTCPPose()[:3], pose[:3], atol=1e-3)


def test_servo_and_speed_j(robot):
    _, receive, control = robot
    start = np.array(receive.getActualQ())
    q = start.copy()
    for _ in range(150):
        period = control.initPeriod()
        q[1] -= 0.0008
        control.servoJ(list(q), 0.0, 0.0, 0.008, 0.05, 600)
        control.waitPeriod(period)
    wait(receive, 0.2)
    np.testing.assert_allclose(receive.getActualQ(), q, atol=2e-3)
    control.servoStop()
    before = receive.getActualQ()[0]
    control.speedJ([0.2, 0, 0, 0, 0, 0], 1.0, 0.5)
    wait(receive, 0.4)
    assert receive.getActualQd()[0] == pytest.approx(0.2, abs=0.02)
    control.speedStop()
    settle(receive)
    assert 0.02 < receive.getActualQ()[0] - before < 0.3


def test_stop_j_cuts_a_move_short(robot):
    _, receive, control = robot
    start = receive.getActualQ()
    goal = list(start)
    goal[0] += 1.0
    control.moveJ(goal, 0.5, 1.0, True)
    wait(receive, 0.6)
    control.stopJ(3.0)
    settle(receive)
    assert 0.02 < receive.getActualQ()[0] - start[0] < 0.9


def test_io_and_speed_slider(robot):
    host, receive, control = robot
    io = rtde_io.RTDEIOInterface(host)
    assert io.setStandardDigitalOut(3, True) and io.setToolDigitalOut(1, True)
    assert io.setSpeedSlider(0.5)
    wait(receive, 0.5)
    assert receive.getDigitalOutState(3) and not receive.getDigitalOutState(2)
    assert receive.getTargetSpeedFraction() == pytest.approx(0.5) == receive.getSpeedScaling()
    goal = receive.getActualQ()
    goal[5] += 0.5
    began = time.monotonic()
    assert control.moveJ(goal, 1.0, 10.0)
    assert time.monotonic() - began > 1.0  # 0.6 s at full speed
    assert io.setSpeedSlider(1.0)
    io.disconnect()


def test_inverse_kinematics_of_the_robot(robot):
    _, receive, control = robot
    q = control.getInverseKinematics(receive.getActualTCPPose())
    np.testing.assert_allclose(q, receive.getActualQ(), atol=1e-4)
    assert control.setPayload(1.5, [0.0, 0.0, 0.05])


def test_dashboard(robot):
    host, receive, _ = robot
    client = dashboard_client.DashboardClient(host)
    client.connect()
    assert client.isConnected() and client.robotmode() == "Robotmode: RUNNING"
    assert client.safetystatus().endswith("NORMAL") and client.running()
    assert dashboard(host, "armcell protective stop") == ["done"]
    wait(receive, 0.3)
    assert receive.isProtectiveStopped() and client.safetystatus().endswith("PROTECTIVE_STOP")
    client.unlockProtectiveStop()
    wait(receive, 0.3)
    assert not receive.isProtectiveStopped()
    client.play()
    wait(receive, 0.3)
    assert client.running()
    client.disconnect()
