"""The executor's states, over all sources of setpoints: streamed, played by the robot, coupled arms."""

from __future__ import annotations

import threading

import numpy as np
import pytest
from tests.execution.helpers import ARM, StuckJoint, alone, make, swing

from armcell.core import ErrorCode, ExecutionResult, JointTrajectory, Outcome
from armcell.drivers import Capability, DriverProxy, Fault
from armcell.execution import ExecutionSettings, UngatedMotion, execute, execute_coupled

SETTINGS = ExecutionSettings(settle_time=0.3, stall_time=0.5)


class Playing:
    """Handle of a trajectory that `PlayingRobot` plays."""

    def __init__(self, trajectory):
        self.trajectory, self.time, self.ended = trajectory, 0.0, "running"

    def trajectory_time(self):
        return self.time

    def state(self):
        return self.ended

    def paused(self):
        return False

    def cancel(self):
        self.ended = "cancelled"


class PlayingRobot(DriverProxy):
    """An arm whose controller plays trajectories by its own clock, at a fraction of their speed."""

    speed = 1.0
    handle: Playing | None = None

    @property
    def capabilities(self):
        return super().capabilities | {Capability.PLAY_TRAJECTORY}

    def follow(self, trajectory):
        self.handle = Playing(trajectory)
        return self.handle

    def advance(self, duration):
        handle = self.handle
        if handle is not None and handle.ended == "running":
            handle.time = min(handle.time + self.speed * duration, handle.trajectory.duration)
            q, v, _ = handle.trajectory.sample(handle.time)
            self.command(handle.trajectory.joint_names, q, v)
            if handle.time >= handle.trajectory.duration:
                handle.ended = "done"
        self._driver.advance(duration)


class Observed(DriverProxy):
    """Counts commands and reports what a test sets: a fault, or the refusal of a dry run."""

    commands, found, refusal = 0, None, None

    @property
    def capabilities(self):
        dry_run = set() if self.refusal is None else {Capability.DRY_RUN}
        return super().capabilities | dry_run

    def command(self, joint_names, positions, velocities):
        self.commands += 1
        return self._driver.command(joint_names, positions, velocities)

    def fault(self):
        return self.found

    def dry_run(self, trajectory):
        return self.refusal


def streamed(driver, motion, progress=None):
    return execute(driver, motion, SETTINGS, progress)


def coupled(driver, motion, progress=None):
    return execute_coupled(driver, motion, settings=SETTINGS, progress=progress)


@pytest.fixture(params=[streamed, coupled, "played"], ids=["streamed", "coupled", "played"])
def rig(request):
    """A driver without its source of setpoints, the function that adds the source, and the executor."""
    played = request.param == "played"
    with make("fake", alone()) as driver:
        yield driver, (PlayingRobot if played else DriverProxy), (streamed if played else request.param)


def arm(driver):
    return driver.joint_state().reindexed(ARM).positions


def test_the_arm_rests_at_the_goal(rig):
    driver, source, run = rig
    fractions: list[float] = []
    result = run(source(driver), UngatedMotion(swing()), fractions.append)
    assert result.ok, result
    np.testing.assert_allclose(arm(driver), swing().positions[-1], atol=SETTINGS.goal_tolerance)
    assert result.finished == driver.now and result.duration < swing().duration + 0.1
    assert fractions == sorted(fractions) and fractions[-1] == pytest.approx(1.0)


def test_an_arm_elsewhere_is_not_commanded(rig):
    driver, source, run = rig
    observed = Observed(driver)
    shifted = swing().positions + 0.3 * np.eye(len(ARM))[2]
    result = run(source(observed), UngatedMotion(JointTrajectory(ARM, swing().times, shifted)))
    assert result.code is ErrorCode.CONTROL_FAILED and "plan again" in result.message
    assert result.evidence["joint"] == ARM[2] and result.evidence["error"] == pytest.approx(0.3)
    assert result.explain().text and observed.commands == 0 and driver.now == 0.0


def test_an_unproven_motion_is_not_commanded(rig):
    class Unproven(UngatedMotion):
        ended: Outcome | None = None

        def begin(self, blend=None):
            return ExecutionResult(ErrorCode.START_STATE_IN_COLLISION, "not proven")

        def end(self, result):
            self.ended = result
            return result

    driver, source, run = rig
    observed, motion = Observed(driver), Unproven(swing())
    result = run(source(observed), motion)
    assert result.code is ErrorCode.START_STATE_IN_COLLISION and motion.ended is result
    assert observed.commands == 0 and driver.now == 0.0


def test_what_the_dry_run_refuses_is_not_commanded(rig):
    driver, source, run = rig
    observed = Observed(driver)
    observed.refusal = Outcome(ErrorCode.CONTROL_FAILED, "touches the table", {"pair": ("a", "b")})
    result = run(source(observed), UngatedMotion(swing()))
    assert (result.message, result.evidence) == ("touches the table", {"pair": ("a", "b")})
    assert observed.commands == 0 and driver.now == 0.0


def test_a_canceled_motion_does_not_begin(rig):
    driver, source, run = rig
    cancel = threading.Event()
    cancel.set()
    before = arm(driver)
    assert run(source(driver), UngatedMotion(swing(), cancel)).code is ErrorCode.PREEMPTED
    driver.advance(0.3)
    np.testing.assert_allclose(arm(driver), before, atol=1e-9)


def test_cancel_stops_the_arm_on_its_way(rig):
    driver, source, run = rig
    motion = UngatedMotion(swing())
    result = run(source(driver), motion, lambda done: motion.set() if done > 0.5 else None)
    assert result.code is ErrorCode.PREEMPTED and f"of {swing().duration:.2f} s" in result.message
    assert 0.05 < result.final_error < 0.4
    stopped = arm(driver)
    driver.advance(0.5)
    np.testing.assert_allclose(arm(driver), stopped, atol=0.02)


@pytest.mark.parametrize("limit, word", [(0.1, "path"), (0.45, "goal")])
def test_a_blocked_joint_is_named(rig, limit, word):
    driver, source, run = rig
    result = run(source(StuckJoint(driver, ARM[0], limit)), UngatedMotion(swing()))
    tolerance = getattr(SETTINGS, f"{word}_tolerance")
    assert result.code is ErrorCode.CONTROL_FAILED and word in result.message
    assert f"tolerance {tolerance:g}" in result.message
    assert result.evidence["joint"] == ARM[0] and result.evidence["error"] > tolerance


@pytest.mark.parametrize("late", [False, True])
def test_a_fault_ends_the_motion(rig, late):
    driver, source, run = rig
    observed = Observed(driver)
    fault = Fault("left", "protective stop", "it has stopped")
    if not late:
        observed.found = fault
    result = run(
        source(observed), UngatedMotion(swing()),
        lambda done: setattr(observed, "found", fault if done > 0.3 else None),
    )  # fmt: skip
    assert result.code is fault.code and "it has stopped" in result.message
    assert result.evidence == {"arm": "left", "kind": "protective stop"}
    assert (result.duration > 0.0) == late


def test_an_error_ends_the_motion_at_the_gate(rig):
    class Noted(UngatedMotion):
        ended: Outcome | None = None

        def end(self, result):
            self.ended = result
            return result

    def broken(done):
        raise ValueError("from the callback")

    driver, source, run = rig
    motion = Noted(swing())
    with pytest.raises(ValueError, match="from the callback"):
        run(source(driver), motion, broken)
    assert motion.ended is not None and motion.ended.code is ErrorCode.CONTROL_FAILED


def test_a_robot_that_makes_no_progress_times_out():
    with make("fake", alone()) as driver:
        robot = PlayingRobot(driver)
        robot.speed = 0.0
        result = streamed(robot, UngatedMotion(swing()))
        assert result.code is ErrorCode.TIMED_OUT and "no progress for 0.5 s" in result.message
        assert robot.handle is not None and robot.handle.ended == "cancelled"
        assert SETTINGS.stall_time < result.duration < SETTINGS.stall_time + 0.1


def test_a_paused_robot_has_all_the_time_it_needs():
    with make("fake", alone()) as driver:
        robot = PlayingRobot(driver)

        def pause(done):
            paused = 0.3 < driver.now < 1.5
            robot.speed = 0.0 if paused else 1.0
            assert robot.handle is not None
            robot.handle.paused = lambda: paused

        result = streamed(robot, UngatedMotion(swing()), pause)
        assert result.ok and result.duration == pytest.approx(swing().duration + 1.2, abs=0.1)


def test_a_robot_that_ends_by_itself_is_reported():
    with make("fake", alone()) as driver:
        robot = PlayingRobot(driver)

        def end(done):
            if done > 0.5 and robot.handle is not None:
                robot.handle.ended = "joint limit"

        result = streamed(robot, UngatedMotion(swing()), end)
        assert result.code is ErrorCode.CONTROL_FAILED and "joint limit" in result.message
