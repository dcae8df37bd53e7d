"""The executor: plays a motion to its end, or says which joint was wrong and leaves the arm at rest."""

from __future__ import annotations

import threading

import numpy as np
import pytest
from tests.execution.helpers import ARM, ROBOT, StuckJoint, alone, make, motion, scene, swing
from tests.execution.ungated import execute, execution_steps

from armcell.core import ErrorCode, JointTrajectory, UnknownNameError
from armcell.drivers import DriverProxy, drivers
from armcell.execution import ExecutionSettings


@pytest.fixture(params=[n for n in drivers if n != "real"])  # real arms: tests/drivers/ur
def driver(request):
    with make(request.param, alone()) as connected:
        yield connected


@pytest.fixture
def fake():
    with make("fake", alone()) as connected:
        yield connected


def arm(driver) -> np.ndarray:
    return driver.joint_state().reindexed(ARM).positions


def assert_rests(driver, within: float = 0.05):
    """The arm stops within a bounded distance of where it is now and then stays."""
    stopped = arm(driver)
    driver.advance(1.0)
    resting = arm(driver)
    assert np.abs(resting - stopped).max() < within
    driver.advance(0.5)
    np.testing.assert_allclose(arm(driver), resting, atol=1e-3)


def test_reaches_the_goal(driver):
    trajectory, fractions = swing(), []
    result = execute(driver, trajectory, progress=fractions.append)
    assert result.ok, result.message
    tolerance = ExecutionSettings().goal_tolerance
    np.testing.assert_allclose(arm(driver), trajectory.positions[-1], atol=tolerance)
    assert result.final_error <= tolerance
    assert result.max_tracking_error < 0.02
    assert trajectory.duration <= result.duration < trajectory.duration + 0.5
    assert result.finished == driver.now
    assert fractions == sorted(fractions) and fractions[0] > 0 and fractions[-1] == pytest.approx(1.0)


def test_what_nobody_watches_is_the_same_motion_bit_for_bit():
    """Where no progress is asked for, the simulated robot plays many periods at once."""
    ends = []
    for progress in (None, lambda fraction: None):
        with make("sim", alone()) as driver:
            result = execute(driver, swing(), progress=progress)
            state = driver.joint_state()
            ends.append((result, state.positions, state.velocities))
    (a, *bits_a), (b, *bits_b) = ends
    assert a.ok and (a.finished, a.max_tracking_error) == (b.finished, b.max_tracking_error)
    for x, y in zip(bits_a, bits_b, strict=True):
        np.testing.assert_array_equal(x, y)


def test_a_blocked_joint_is_noticed_where_nobody_watches():
    with make("sim", alone()) as driver:
        driver.world.block(ARM[0])
        result = execute(driver, swing(0.8))
        assert result.code is ErrorCode.CONTROL_FAILED and result.evidence["joint"] == ARM[0]
        assert 0.1 < result.evidence["error"] < 0.11  # at the first period past the tolerance
        assert_rests(driver)


def test_joints_it_does_not_name_stay(driver):
    goal = {ARM[6]: 0.3, ARM[1]: -0.6}  # in no particular order
    assert execute(driver, motion(goal)).ok
    assert driver.joint_state()[ARM[1]] == pytest.approx(-0.6, abs=5e-3)
    others = [n for n in ARM if n not in goal]
    np.testing.assert_allclose(
        driver.joint_state().reindexed(others).positions,
        scene().state.reindexed(others).positions,
        atol=5e-3,
    )


def test_one_motion_after_another(driver):
    there = swing(0.3)
    back = JointTrajectory(ARM, there.times, there.positions[::-1], -there.velocities[::-1])
    first = execute(driver, there)
    second = execute(driver, back)
    assert first.ok and second.ok
    assert second.started == first.finished
    np.testing.assert_allclose(arm(driver), there.positions[0], atol=5e-3)


def test_wrong_start_names_the_joint_and_moves_nothing(driver):
    trajectory = swing()
    shifted = trajectory.positions.copy()
    shifted[:, 2] += 0.2
    result = execute(driver, JointTrajectory(ARM, trajectory.times, shifted))
    assert result.code is ErrorCode.CONTROL_FAILED
    assert ARM[2] in result.message and result.evidence["joint"] == ARM[2]
    assert result.evidence["error"] == pytest.approx(0.2, abs=1e-3)
    assert result.duration == 0.0
    assert_rests(driver, 5e-3)


def test_start_tolerance_is_what_decides(fake):
    trajectory = swing()
    off = JointTrajectory(ARM, trajectory.times, trajectory.positions + 0.009)
    assert execute(fake, off).ok
    assert not execute(fake, off, ExecutionSettings(start_tolerance=1e-4)).ok


def test_leaving_the_path_names_the_joint_and_stops(driver):
    stuck = StuckJoint(driver, ARM[0], 0.1)
    result = execute(stuck, swing(0.8))
    assert result.code is ErrorCode.CONTROL_FAILED
    assert ARM[0] in result.message and "path" in result.message
    assert result.evidence["error"] > ExecutionSettings().path_tolerance
    assert result.finished < swing(0.8).duration  # at once, not at the end
    assert driver.joint_state()[ARM[0]] < 0.2
    assert_rests(driver)


def test_goal_not_reached_names_the_joint(fake):
    settings = ExecutionSettings(settle_time=0.3)
    result = execute(StuckJoint(fake, ARM[0], 0.45), swing(0.5), settings)
    assert result.code is ErrorCode.CONTROL_FAILED
    assert ARM[0] in result.message and "goal" in result.message
    assert result.final_error == pytest.approx(0.05, abs=1e-6)
    waited = result.duration - swing(0.5).duration
    assert settings.settle_time <= waited <= settings.settle_time + 3 * fake.period


def test_an_arm_that_does_not_come_to_rest_is_not_there(fake):
    class Restless(DriverProxy):
        def joint_state(self):
            state = self._driver.joint_state()
            state.velocities[0] = 0.1
            return state

    result = execute(Restless(fake), swing(), ExecutionSettings(settle_time=0.1))
    assert result.code is ErrorCode.CONTROL_FAILED


def test_cancel_from_the_progress_callback_stops(driver):
    cancel, seen = threading.Event(), []

    def progress(fraction):
        seen.append(fraction)
        if fraction > 0.5:
            cancel.set()

    trajectory = swing(1.0)
    result = execute(driver, trajectory, cancel=cancel, progress=progress)
    assert result.code is ErrorCode.PREEMPTED
    assert len([f for f in seen if f > 0.5]) == 1  # not one command more
    assert result.duration < 0.6 * trajectory.duration
    assert np.abs(arm(driver) - trajectory.positions[-1]).max() > 0.2
    assert_rests(driver, 0.1)


def test_cancel_from_another_thread_stops(driver):
    cancel, halfway = threading.Event(), threading.Event()
    stopper = threading.Thread(target=lambda: (halfway.wait(10), cancel.set()))
    stopper.start()

    def progress(fraction):
        if fraction > 0.4:
            halfway.set()
            assert cancel.wait(10)

    result = execute(driver, swing(), cancel=cancel, progress=progress)
    halfway.set()
    stopper.join()
    assert result.code is ErrorCode.PREEMPTED
    assert "cancelled" in result.message
    assert_rests(driver, 0.1)


class Recorder(DriverProxy):
    """Notes the speeds it is told."""

    def __init__(self, driver):
        super().__init__(driver)
        self.told = []

    def command(self, joint_names, positions, velocities):
        self.told.append(np.array(velocities, float))
        return self._driver.command(joint_names, positions, velocities)


@pytest.mark.parametrize("shape", ["at rest", "linear", "cubic"])
def test_a_motion_begins_with_the_speed_that_the_arm_has(shape):
    """The difference fades within the blend time; an arm at rest gets the trajectory as it is."""
    with make("sim", alone()) as inner:
        driver, first = Recorder(inner), swing(1.0)
        if shape != "at rest":
            steps = execution_steps(driver, first)
            while inner.now < 0.5 * first.duration:
                next(steps)
                inner.advance(inner.period)
        state = inner.joint_state().reindexed(ARM)
        speed = np.abs(state.velocities).max()
        assert speed > 0.5 or shape == "at rest"
        q = np.array([state.positions, state.positions + 0.3 * np.sign(state.velocities)])
        still = None if shape == "linear" else np.zeros((2, len(ARM)))
        second = JointTrajectory(ARM, np.array([0.0, 1.0]), q, still)
        driver.told.clear()
        result = execute(driver, second)
        assert result.ok, result.message
        told = np.array(driver.told)
        plain = np.array([second.sample(inner.period * (i + 1))[1] for i in range(len(told))])
        after = round(ExecutionSettings().blend_time / inner.period)
        if shape == "at rest":
            np.testing.assert_allclose(told, plain)
        else:
            assert np.abs(told[0] - state.velocities).max() < 0.02 * speed
            assert np.abs(plain[0] - state.velocities).max() > 0.5 * speed  # without it: a jump
            assert np.abs(np.diff(told[:after], axis=0)).max() < 0.1 * speed
        np.testing.assert_allclose(told[after:], plain[after:], atol=1e-9)


def test_cancelled_before_it_began_does_not_move(driver):
    cancel = threading.Event()
    cancel.set()
    before = arm(driver)
    assert execute(driver, swing(), cancel=cancel).code is ErrorCode.PREEMPTED
    driver.advance(0.3)
    np.testing.assert_allclose(arm(driver), before, atol=2e-3)


def test_an_empty_trajectory_means_stop(fake):
    class Counting(DriverProxy):
        stops = 0

        def stop(self):
            self.stops += 1
            self._driver.stop()

    counting = Counting(fake)
    result = execute(counting, JointTrajectory(ARM, [], np.zeros((0, len(ARM)))))
    assert result.ok and counting.stops == 1
    assert result.duration == 0.0
    assert_rests(fake)


def test_a_single_point_is_reached(driver):
    q = arm(driver) + 0.004  # within the start tolerance
    assert execute(driver, JointTrajectory(ARM, [0.0], [q])).ok
    np.testing.assert_allclose(arm(driver), q, atol=5e-3)


def test_the_callback_s_error_comes_out(fake):
    def broken(fraction):
        raise ValueError("from the callback")

    with pytest.raises(ValueError, match="from the callback"):
        execute(fake, swing(), progress=broken)


def test_a_joint_of_another_robot_is_misuse(fake):
    with pytest.raises(UnknownNameError, match="elbow"):
        execute(fake, JointTrajectory(("elbow",), [0.0, 1.0], [[0.0], [1.0]]))
    assert ROBOT.joint_names == fake.joint_state().joint_names
