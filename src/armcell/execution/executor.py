"""The trajectory executor: plays a trajectory on a driver, as FollowJointTrajectory does."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import partial

import numpy as np

from armcell.core import ErrorCode, ExecutionResult, JointState, JointTrajectory, Playback
from armcell.core.checks import checked, require
from armcell.drivers import Capability, Driver
from armcell.execution.followed import Steps, Tolerances, followed
from armcell.execution.gate import Executable, executable
from armcell.planning import explain_start


@dataclass(frozen=True)
@checked()
class ExecutionSettings:
    """Tolerances and time limits of an execution; 0.01 rad at the start is MoveIt's default."""

    start_tolerance: float = 0.01  # [rad or m] between the measured state and the trajectory's start
    path_tolerance: float = 0.1  # [rad or m] tracking error that aborts the motion
    goal_tolerance: float = 0.005  # [rad or m]
    goal_speed: float = 0.02  # [rad/s or m/s] below which the arm counts as at rest
    settle_time: float = 1.0  # [s] to reach the goal after the trajectory's end
    blend_time: float = 0.2  # [s] for blending a moving arm's velocity into the new motion
    stall_time: float = 5.0  # [s] without progress before a motion that the robot plays itself is aborted

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            require(value > 0, f"{field.name} is {value:g}, it must be positive")


AT_ONCE = 0.02  # [s] of trajectory that a driver plays itself per call
Progress = Callable[[float], None]


def execute(
    driver: Driver,
    motion: Executable,
    settings: ExecutionSettings = ExecutionSettings(),
    progress: Progress | None = None,
) -> ExecutionResult:
    """Play a trajectory to its end and wait until the arm rests at the goal.

    Args:
        motion: motion from a `MotionGate`, which checks it for collisions first; setting it stops the arm.
        progress: called after each command with the completed fraction, 0..1. Without it, a driver with
            `PLAY_PARTS` plays `AT_ONCE` seconds per call, and the executor checks `motion` in between.
    Returns:
        SUCCESS; CONTROL_FAILED with joint and error if the start differs, the arm leaves the path, or the arm
        misses the goal; MOTION_PLAN_INVALIDATED_BY_ENVIRONMENT_CHANGE or START_STATE_IN_COLLISION with the
        pair, the position and the time if the motion is not collision-free; PREEMPTED. After every result
        except SUCCESS, the driver holds the measured position.
    """
    alone = progress is None and Capability.PLAY_PARTS in driver.capabilities
    steps = playing(driver, motion, settings, progress, alone)
    while True:
        try:
            next(steps)
        except StopIteration as end:
            return end.value
        driver.advance(driver.period)


def playing(
    driver: Driver,
    motion: Executable,
    settings: ExecutionSettings = ExecutionSettings(),
    progress: Progress | None = None,
    alone: bool = False,
) -> Steps:
    """Execute a motion step by step: each `next` commands the driver for its next period.

    The caller advances the driver's clock between two steps. Several of these generators, for different
    joints, can run on one driver at the same time.

    An arm that already moves, for example because a newer motion takes over, is not stopped first: the offset
    from the trajectory's start, in position and velocity, fades out. This does not apply to robots that play
    trajectories themselves.

    Args:
        alone: True if the driver may play parts of the trajectory itself, which advances its clock; False to
            command every period.
    """
    executable(motion)
    try:
        result = yield from _played(driver, motion, settings, progress, alone)
    except BaseException as error:
        motion.end(ExecutionResult(ErrorCode.CONTROL_FAILED, str(error)))
        raise
    return motion.end(result)


def _played(
    driver: Driver,
    motion: Executable,
    settings: ExecutionSettings,
    progress: Progress | None,
    alone: bool,
) -> Steps:
    trajectory, began = motion.trajectory, driver.now
    names = trajectory.joint_names
    whole = driver.joint_state()
    columns, measured = np.array(whole.columns(names), dtype=int), whole.reindexed(names)
    if len(trajectory.times) == 0:
        driver.stop()  # ROS: an empty trajectory means stop
        return ExecutionResult(ErrorCode.SUCCESS, "empty trajectory: stopped", started=began, finished=began)
    worst, joint = _largest(np.abs(measured.positions - trajectory.positions[0]), names)
    if worst > settings.start_tolerance:
        text = (
            f"{joint} is {worst:.3f} from the trajectory's start (tolerance {settings.start_tolerance:g}): "
            "the robot moved since it was planned; plan again from the current state"
        )
        code = ErrorCode.CONTROL_FAILED
        start, tolerance = trajectory.start, settings.start_tolerance
        return ExecutionResult(
            code, text, {"joint": joint, "error": worst}, began, began,
            explainer=partial(explain_start, measured, start, tolerance, code, text),
        )  # fmt: skip
    follows = Capability.PLAY_TRAJECTORY in driver.capabilities
    fade = None if follows else _fade(measured, trajectory, settings)
    if (unproven := motion.begin(fade)) is not None:
        return unproven
    refused = driver.rehearse(trajectory) if Capability.DRY_RUN in driver.capabilities else None
    if refused is not None:
        return ExecutionResult(refused.code, refused.message, refused.evidence, began, driver.now)
    if follows:
        watched = Tolerances(**{f.name: getattr(settings, f.name) for f in fields(Tolerances)})
        return (yield from followed(driver, trajectory, watched, motion, progress))
    tracking = 0.0

    def ended(code: ErrorCode, text: str, **evidence) -> ExecutionResult:
        if code is not ErrorCode.SUCCESS:
            driver.stop()
        error = float(np.max(np.abs(driver.joint_state().positions[columns] - trajectory.positions[-1])))
        return ExecutionResult(code, text, evidence, began, driver.now, tracking, error)

    duration, playback = trajectory.duration, Playback(trajectory)
    while (t := driver.now - began) < duration - 1e-9:
        if motion.is_set():
            return ended(ErrorCode.PREEMPTED, f"cancelled at {t:.2f} of {duration:.2f} s")
        if alone and fade is None:
            until = min(t + AT_ONCE, duration)
            worst, column = driver.play(names, playback, began, until, settings.path_tolerance)
            joint = names[column]
        else:
            q, v = playback.at(min(t + driver.period, duration))
            if fade is not None:
                gap, gap_speed, _ = fade.sample(t + driver.period)
                q, v = q + gap, v + gap_speed
            driver.command(names, q, v)
            yield
            worst, joint = _largest(np.abs(driver.joint_state().positions[columns] - q), names)
        tracking = max(tracking, worst)
        if worst > settings.path_tolerance:
            text = (
                f"{joint} left the path by {worst:.3f} at {t:.2f} s (tolerance {settings.path_tolerance:g})"
            )
            return ended(ErrorCode.CONTROL_FAILED, text, joint=joint, error=worst)
        if progress:
            progress(min((t + driver.period) / duration, 1.0))
    goal, rest = trajectory.positions[-1], np.zeros(len(names))
    while True:
        driver.command(names, goal, rest)
        state = driver.joint_state()
        worst, joint = _largest(np.abs(state.positions[columns] - goal), names)
        v = state.velocities
        speed = 0.0 if v is None else float(np.max(np.abs(v[columns]), initial=0.0))
        if worst <= settings.goal_tolerance and speed <= settings.goal_speed:
            return ended(ErrorCode.SUCCESS, "")
        if driver.now - began > duration + settings.settle_time:
            text = f"{joint} ended {worst:.4f} from the goal (tolerance {settings.goal_tolerance:g})"
            return ended(ErrorCode.CONTROL_FAILED, text, joint=joint, error=worst)
        if motion.is_set():
            return ended(ErrorCode.PREEMPTED, "cancelled at the goal")
        yield


def _fade(
    measured: JointState, trajectory: JointTrajectory, settings: ExecutionSettings
) -> JointTrajectory | None:
    """Return the quintic blend from an arm's current motion into a trajectory; None at rest.

    The blend is an offset from the trajectory that ends at zero position and velocity.
    """
    moves = measured.velocities
    if moves is None or np.max(np.abs(moves)) <= settings.goal_speed or trajectory.duration <= 0:
        return None
    if trajectory.velocities is None:
        wanted = (trajectory.positions[1] - trajectory.positions[0]) / (
            trajectory.times[1] - trajectory.times[0]
        )
    else:
        wanted = trajectory.velocities[0]
    n = len(trajectory.joint_names)
    return JointTrajectory(
        trajectory.joint_names,
        np.array([0.0, min(settings.blend_time, trajectory.duration)]),
        np.array([measured.positions - trajectory.positions[0], np.zeros(n)]),
        np.array([moves - wanted, np.zeros(n)]),
        np.zeros((2, n)),
    )


def _largest(errors: np.ndarray, names: tuple[str, ...]) -> tuple[float, str]:
    if len(errors) == 0:
        return 0.0, ""
    i = int(errors.argmax())
    return errors.item(i), names[i]
