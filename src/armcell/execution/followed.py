"""Execution of trajectories that the robot plays itself: hand over, monitor, and evaluate."""

from __future__ import annotations

import threading
from collections.abc import Callable, Generator
from dataclasses import dataclass

import numpy as np

from armcell.core import ErrorCode, ExecutionResult, JointTrajectory
from armcell.drivers import Driver, Fault, Following

Steps = Generator[None, None, ExecutionResult]
"""Generator of a running motion: resume it once per driver period; its return value is the result."""

CANCEL_TIME = 2.0  # [s] time limit for a cancelled arm to come to rest
LATENCY = 0.06  # [s] largest lag of the measured state behind the trajectory clock


@dataclass(frozen=True)
class Tolerances:
    """Tolerances of a motion that the robot plays itself, copied from `ExecutionSettings`."""

    path_tolerance: float  # [rad]
    goal_tolerance: float  # [rad]
    goal_speed: float  # [rad/s]
    settle_time: float  # [s]
    stall_time: float  # [s]


def followed(
    driver: Driver,
    trajectory: JointTrajectory,
    settings: Tolerances,
    cancel: threading.Event | None,
    progress: Callable[[float], None] | None,
) -> Steps:
    """Run `playing` after its start check, on a robot that plays trajectories itself.

    Args:
        driver: a driver that can play a whole trajectory itself.
        settings: tolerances and timeouts.
        cancel: stops the motion when set.
        progress: called with the completed fraction, 0..1.
    Returns:
        A generator to resume once per driver period; its value is the execution result.
    """
    names, began, duration = trajectory.joint_names, driver.now, trajectory.duration
    first = float(trajectory.times[0])
    tracking, advanced_at, furthest, done_at = 0.0, began, 0.0, None

    def state() -> tuple[np.ndarray, float]:
        measured = driver.joint_state().reindexed(names)
        speed = 0.0 if measured.velocities is None else float(np.max(np.abs(measured.velocities)))
        return measured.positions, speed

    def ended(code: ErrorCode, text: str, **evidence) -> ExecutionResult:
        if code is not ErrorCode.SUCCESS:
            driver.stop()
        error = float(np.max(np.abs(state()[0] - trajectory.positions[-1])))
        return ExecutionResult(code, text, evidence, began, driver.now, tracking, error)

    def stopped_by(fault: Fault) -> ExecutionResult:
        return ended(fault.code, f"stopped: {fault}", arm=fault.arm, kind=fault.kind)

    fault = driver.fault()
    if fault is not None:
        return stopped_by(fault)
    if duration <= 0.0:
        return ended(ErrorCode.SUCCESS, "")  # the arm is at the goal: the start check has passed
    following = driver.follow(trajectory)
    while True:
        yield
        fault = driver.fault()
        if fault is not None:
            return stopped_by(fault)
        if cancel is not None and cancel.is_set():
            return (yield from _cancelled(driver, following, state, ended))
        t = following.clock()
        q, speed = state()
        errors = np.min(
            [
                np.abs(q - trajectory.sample(first + max(t - late, 0.0))[0])
                for late in (0.0, LATENCY / 2, LATENCY)
            ],
            axis=0,
        )
        worst = int(np.argmax(errors))
        tracking = max(tracking, float(errors[worst]))
        if errors[worst] > settings.path_tolerance:
            following.cancel()
            text = f"{names[worst]} left the path by {errors[worst]:.3f} at {t:.2f} s"
            text += f" (tolerance {settings.path_tolerance:g})"
            return ended(ErrorCode.CONTROL_FAILED, text, joint=names[worst], error=float(errors[worst]))
        if progress:
            progress(min(t / duration, 1.0) if duration > 0 else 1.0)
        if t > furthest or following.paused():
            furthest, advanced_at = max(t, furthest), driver.now
        if following.state() == "running":
            if driver.now - advanced_at > settings.stall_time:
                following.cancel()
                text = f"no progress for {settings.stall_time:g} s at {t:.2f} of {duration:.2f} s"
                return ended(ErrorCode.TIMED_OUT, text)
            continue
        if following.state() != "done":
            return ended(ErrorCode.CONTROL_FAILED, f"the robot ended the trajectory: {following.state()}")
        done_at = driver.now if done_at is None else done_at
        left = np.abs(q - trajectory.positions[-1])
        worst = int(np.argmax(left))
        if left[worst] <= settings.goal_tolerance and speed <= settings.goal_speed:
            return ended(ErrorCode.SUCCESS, "")
        if driver.now - done_at > settings.settle_time:
            text = f"{names[worst]} ended {left[worst]:.4f} from the goal"
            text += f" (tolerance {settings.goal_tolerance:g})"
            return ended(ErrorCode.CONTROL_FAILED, text, joint=names[worst], error=float(left[worst]))


def _cancelled(
    driver: Driver, following: Following, state: Callable, ended: Callable[..., ExecutionResult]
) -> Steps:
    """Cancel the robot's trajectory and wait until the arm rests, at most `CANCEL_TIME` [s]."""
    at = following.clock()
    following.cancel()
    end = driver.now + CANCEL_TIME
    while driver.now < end:
        yield
        if following.state() != "running" and state()[1] < 0.005:
            break
    return ended(ErrorCode.PREEMPTED, f"cancelled at {at:.2f} s")
