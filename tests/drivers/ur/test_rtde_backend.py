"""`backend: ur_rtde`: the same driver and the same stops, moved by that library in a process per arm."""

import importlib.util
import os
import signal
import time

import numpy as np
import pytest
from tests.drivers.ur.emulated import dashboard, emulator, free_hosts
from tests.drivers.ur.rig import MOVE, one_arm, swing, two_arms
from tests.execution.ungated import execute

from armcell.core import ErrorCode, InputError, JointTrajectory
from armcell.drivers.ur.ur_rtde_arm import UrRtdeConnection
from armcell.drivers.ur.ur_rtde_worker import interpolate

installed = importlib.util.find_spec("rtde_control") is not None
needs_ur_rtde = pytest.mark.skipif(not installed, reason="ur_rtde is not installed (no wheel for 3.13)")


@pytest.mark.skipif(installed, reason="ur_rtde is installed")
def test_without_the_library_it_says_what_to_install():
    with pytest.raises(InputError, match=r"armcell\[ur-rtde\]"), one_arm("127.0.0.9", backend="ur_rtde"):
        pass


def test_streamed_points_are_met_by_cubics():
    """Against the trajectory's own Hermite cubics."""
    t, q, v = np.array([0.0, 0.3, 0.5]), np.array([[0.0], [1.0], [0.4]]), np.array([[0.0], [0.5], [-1.0]])
    points = [(float(a), list(b), list(c)) for a, b, c in zip(t, q, v, strict=True)]
    reference = JointTrajectory(("a",), t, q, v)
    for now in np.linspace(0.0, 0.5, 23):
        assert interpolate(points, float(now))[0] == pytest.approx(
            reference.sample(float(now))[0][0], abs=1e-12
        )
    assert interpolate(points, 9.0) == [0.4] and interpolate(points, -1.0) == [0.0]


@pytest.mark.slow
@needs_ur_rtde
@pytest.mark.realtime
def test_moves_streams_stops_and_resumes():
    hosts = free_hosts(2)
    with emulator(hosts=hosts), two_arms(hosts, backend="ur_rtde") as driver:
        left, right = driver.arms.values()
        for arm in (left, right):
            plan = swing(driver, arm.joint_names, 0.5 * MOVE, 1.6)
            result = execute(driver, plan)
            assert result.ok, result.message
            np.testing.assert_allclose(arm.q, plan.positions[-1], atol=2e-3)
        joints = [*left.joint_names, *right.joint_names]
        plan = swing(driver, joints, [*MOVE, *-MOVE], 2.0)
        result = execute(driver, plan)
        assert result.ok, result.message
        np.testing.assert_allclose([*left.q, *right.q], plan.positions[-1], atol=2e-3)
        right.set_tool_output(1, True)
        time.sleep(0.2)
        assert right.state.actual_digital_output_bits == 1 << 17

        plan = swing(driver, joints, [*-MOVE, *MOVE], 3.0)
        driver.follow(plan)
        time.sleep(0.8)
        dashboard(hosts[1], "armcell protective stop")
        time.sleep(0.5)
        at_rest = np.array([*left.q, *right.q])
        time.sleep(0.4)
        np.testing.assert_allclose([*left.q, *right.q], at_rest, atol=1e-4)
        assert driver.fault().arm == "right_arm" and driver.fault().kind == "protective stop"
        with pytest.raises(InputError, match="no motion after a stop"):
            driver.follow(plan)
        with pytest.raises(InputError, match="cannot resume"):
            driver.resume()
        dashboard(hosts[1], "unlock protective stop")
        time.sleep(0.3)
        driver.resume()
        np.testing.assert_allclose([*left.q, *right.q], at_rest, atol=1e-4)
        result = execute(driver, swing(driver, joints, [*-0.3 * MOVE, *0.3 * MOVE], 1.5))
        assert result.ok, result.message
        assert [e.kind for e in driver.safety_events] == ["protective stop", "peer stopped", "resumed"]


@pytest.mark.slow
@needs_ur_rtde
@pytest.mark.realtime
def test_a_process_that_dies_and_a_frozen_network_stop_the_arm():
    (host,) = free_hosts(1)
    with emulator(hosts=[host]), one_arm(host, backend="ur_rtde") as driver:
        arm = driver.arms["arm"]
        link = arm._link
        assert isinstance(link, UrRtdeConnection) and link._process is not None
        following = driver.follow(swing(driver, arm.joint_names, MOVE, 3.0))
        time.sleep(0.8)
        os.kill(link._process.pid, signal.SIGSEGV)  # as ur_rtde dies when its link breaks
        time.sleep(1.0)
        assert driver.fault().kind == "program ended" and following.state() == "cancelled"
        rest = arm.q
        time.sleep(0.3)
        np.testing.assert_allclose(arm.q, rest, atol=1e-4)
        driver.resume()
        driver.follow(swing(driver, arm.joint_names, -0.5 * MOVE, 3.0))
        time.sleep(0.8)
        dashboard(host, "armcell fault freeze 0.8")
        time.sleep(1.6)
        fault = driver.fault()
        assert fault.kind in ("stale state", "program ended", "link lost") and fault.code is (
            ErrorCode.COMMUNICATION_FAILURE
        )
        rest = arm.q
        time.sleep(0.3)
        np.testing.assert_allclose(arm.q, rest, atol=1e-4)
        driver.resume()
        result = execute(driver, swing(driver, arm.joint_names, 0.3 * MOVE, 1.5))
        assert result.ok, result.message
