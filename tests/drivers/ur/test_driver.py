"""The UR driver against an emulated controller in a process of its own."""

import socket
import threading
import time

import numpy as np
import pytest
from tests.drivers.ur.emulated import dashboard, emulator, free_hosts
from tests.drivers.ur.rig import MOVE, one_arm, swing, two_arms
from tests.execution.ungated import execute

from armcell.core import ErrorCode, InputError
from armcell.drivers.ur.identity import identify

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def host():
    (address,) = free_hosts(1)
    with emulator("--model", "UR10", "--calibration", "5", hosts=[address]):
        yield address


@pytest.fixture
def driver(host):
    with one_arm(host) as made:
        yield made
    dashboard(host, "armcell speed 1")


def arm_joints(driver):
    return driver.arms["arm"].joint_names


def test_forwarded_trajectory_arrives_on_time(driver):
    for sign in (1, -1):
        trajectory = swing(driver, arm_joints(driver), sign * MOVE, 1.6)
        result = execute(driver, trajectory)
        assert result.ok, result.message
        assert result.finished - result.started < 1.6 + 0.5
        np.testing.assert_allclose(driver.arms["arm"].q, trajectory.positions[-1], atol=1e-3)


def test_the_robot_follows_the_trajectory_in_between(driver):
    trajectory = swing(driver, arm_joints(driver), MOVE, 1.6)
    seen = []

    def look(_):
        state = driver.arms["arm"].state
        seen.append((state.output_double_register_24, np.array(state.target_q)))

    assert execute(driver, trajectory, progress=look).ok
    inside = [(t, q) for t, q in seen if 0.1 < t < 1.5]
    assert len(inside) > 20
    worst = max(np.abs(q - trajectory.sample(t)[0]).max() for t, q in inside)
    assert worst < 0.01, worst  # one control period (8 ms) at 0.8 rad/s


def test_speed_slider_slows_the_trajectory_s_clock(driver):
    driver.arms["arm"].set_slider(0.5)
    time.sleep(0.4)
    assert driver.speed_fraction == pytest.approx(0.5)
    result = execute(driver, swing(driver, arm_joints(driver), -MOVE, 1.6))
    assert result.ok, result.message
    assert 3.1 < result.finished - result.started < 4.2
    driver.arms["arm"].set_slider(1.0)


def test_a_pause_holds_and_play_goes_on(driver, host):
    trajectory = swing(driver, arm_joints(driver), MOVE, 1.6)
    done = []
    thread = threading.Thread(target=lambda: done.append(execute(driver, trajectory)))
    thread.start()
    time.sleep(0.7)
    assert dashboard(host, "pause") == ["Pausing program"]
    time.sleep(0.5)
    q = driver.arms["arm"].q
    time.sleep(0.6)
    np.testing.assert_allclose(driver.arms["arm"].q, q, atol=1e-3)
    assert dashboard(host, "play") == ["Starting program"]
    thread.join(timeout=10)
    assert done[0].ok, done[0].message
    assert done[0].finished - done[0].started > 2.5
    np.testing.assert_allclose(driver.arms["arm"].q, trajectory.positions[-1], atol=2e-3)


def test_cancel_is_bounded_in_time_and_distance(driver):
    trajectory = swing(driver, arm_joints(driver), -MOVE, 2.0)
    cancel, at = threading.Event(), []

    def look(fraction):
        if fraction > 0.5 and not cancel.is_set():
            at.append((driver.now, driver.arms["arm"].q))
            cancel.set()

    result = execute(driver, trajectory, cancel=cancel, progress=look)
    assert result.code is ErrorCode.PREEMPTED
    ((when, q),) = at
    assert driver.now - when < 0.6
    assert np.abs(driver.arms["arm"].q - q).max() < 0.1
    assert execute(driver, swing(driver, arm_joints(driver), 0.2 * MOVE, 1.0)).ok  # and it moves again


def test_moved_by_hand_between_plan_and_execute(driver, host):
    trajectory = swing(driver, arm_joints(driver), MOVE, 2.0)
    dashboard(host, "armcell move joint 2 0.05")
    time.sleep(0.2)
    before = driver.arms["arm"].q
    result = execute(driver, trajectory)
    assert result.code is ErrorCode.CONTROL_FAILED and "elbow_joint is 0.050" in result.message
    np.testing.assert_allclose(driver.arms["arm"].q, before, atol=1e-6)


def test_streaming_follows_targets(driver):
    q = driver.arms["arm"].q
    for i in range(60):
        target = np.add(q, [0, 0, 0, 0, 0, 0.002 * i])
        driver.command(arm_joints(driver), target, np.zeros(6))
        driver.advance(0.01)
    time.sleep(0.2)
    np.testing.assert_allclose(driver.arms["arm"].q, target, atol=2e-3)


def test_outputs(driver):
    arm = driver.arms["arm"]
    arm.set_digital_output(2, True)
    arm.set_tool_output(1, True)
    time.sleep(0.2)
    assert arm.state.actual_digital_output_bits == (1 << 2) | (1 << 17)
    arm.set_digital_output(2, False)
    arm.set_tool_output(1, False)


# --- refused before anything moves ---
def refused(make, words: str) -> str:
    with pytest.raises(InputError, match=words) as caught, make:
        pass
    return str(caught.value)


def test_wrong_address():
    assert "ping" in refused(one_arm("127.0.99.99"), "no robot answers")


def test_not_a_robot_at_the_address():
    (address,) = free_hosts(1)
    with socket.create_server((address, 29999)) as server:
        threading.Thread(target=lambda: server.accept()[0].sendall(b"SSH-2.0\n"), daemon=True).start()
        refused(one_arm(address), "not a Universal Robots dashboard")


def test_wrong_model(host):
    refused(one_arm(host, {"model": "UR10e"}), "is a UR10, the cell file says UR10e")


def test_another_robot(host):
    refused(one_arm(host, {"serial": "999"}), "serial number 20260001, the cell file says 999")
    refused(one_arm(host, {"calibration": "abc"}), "has calibration")
    with one_arm(host, {"serial": "20260001", "calibration": identify(host).calibration}):
        pass


def test_protective_stop_at_the_start(host):
    dashboard(host, "armcell protective stop")
    try:
        assert "unlock" in refused(one_arm(host), "protective stop")
    finally:
        dashboard(host, "unlock protective stop")


def test_port_of_the_other_program_in_use(host):
    with one_arm(host, {"port": 50777}):
        assert "own 'port'" in refused(one_arm(host, {"port": 50777}), "port 50777 .* is not free")


def test_local_control_and_power():
    (address,) = free_hosts(1)
    with emulator("--model", "UR10e", "--local", "--off", hosts=[address]):
        assert "Remote Control" in refused(one_arm(address, {"model": "UR10e"}), "local control")
        dashboard(address, "armcell remote")
        refused(one_arm(address, {"model": "UR10e"}), "not running .mode POWER_OFF")
        dashboard(address, "power on", "brake release")
        time.sleep(1.0)
        with one_arm(address, {"model": "UR10e"}) as driver:
            assert execute(driver, swing(driver, arm_joints(driver), MOVE, 1.6)).ok


def test_arms_swapped():
    hosts = free_hosts(2)
    with emulator("--serial", "L1", "--serial", "R1", hosts=hosts):
        text = refused(two_arms(hosts, {"serial": "R1"}, {"serial": "L1"}), "swapped")
        assert "left_arm" in text and "right_arm" in text
        with two_arms(hosts, {"serial": "L1"}, {"serial": "R1"}) as driver:
            joints = [n for a in driver.arms.values() for n in a.joint_names]
            result = execute(driver, swing(driver, joints, [*MOVE, *-MOVE], 2.0))
            assert result.ok, result.message


def test_settings_are_checked():
    for arms, words in (
        ({}, "at least 1 item"),
        ({"arm": {"model": "UR10"}}, "real/arms/arm/host: Field required"),
        ({"arm": {"host": "a", "modle": "UR10"}}, "modle"),
        ({"arm": {"host": "a", "model": "UR99"}}, "unknown UR model 'UR99'"),
        ({"leg": {"host": "a"}}, "unknown arm"),
    ):
        from tests.drivers.ur.rig import load_robot, made

        with pytest.raises(InputError, match=words):
            made(load_robot("ur10"), arms)
    with pytest.raises(InputError, match="same address"):
        two_arms(["127.0.0.9", "127.0.0.9"])
    with pytest.raises(InputError, match="same port"):
        two_arms(["127.0.0.8", "127.0.0.9"], {"port": 50001}, {"port": 50001})
