"""The executor: one state machine for all motions, with FollowJointTrajectory semantics.

A motion passes these states; each one can end it with a result:

    start check -> proof by the gate -> dry run -> moving -> settling -> result

The setpoints come from one of three sources (`setpoints.py`): streamed by the executor, played by the robot,
or coupled arms on one clock.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from functools import partial

import numpy as np

from armcell.core import ErrorCode, ExecutionResult, JointState, JointTrajectory, Outcome
from armcell.drivers import Capability, Driver
from armcell.execution.motion_gate import NOT_STARTED, Executable, executable
from armcell.execution.setpoints import (
    CANCEL_TIME,
    Correction,
    CoupledSetpoints,
    RobotPlayback,
    SetpointSource,
    StreamedSetpoints,
    largest,
)
from armcell.execution.settings import ExecutionSettings
from armcell.planning import explain_start

Progress = Callable[[float], None]
ExecutionSteps = Generator[None, None, ExecutionResult]
"""Generator of a running motion: resume it once per driver period; its return value is the result."""

Source = Callable[[Driver, JointTrajectory, ExecutionSettings], SetpointSource]


def execute(
    driver: Driver,
    motion: Executable,
    settings: ExecutionSettings = ExecutionSettings(),
    progress: Progress | None = None,
) -> ExecutionResult:
    """Execute a trajectory to its end with the executor, and wait until the arm is at rest at the goal.

    Args:
        motion: motion from a `MotionGate`, which checks it for collisions first; setting it stops the arm.
        progress: called after each command with the completed fraction, 0..1. Without it, a driver with
            `PLAY_PARTS` plays several periods per call, and the executor checks `motion` in between.
    Returns:
        SUCCESS; CONTROL_FAILED with joint and error if the start differs, the arm leaves the path, or the arm
        misses the goal; MOTION_PLAN_INVALIDATED_BY_ENVIRONMENT_CHANGE or START_STATE_IN_COLLISION with the
        pair, the position and the time if the motion is not collision-free; TIMED_OUT if a robot that plays
        the motion itself makes no progress; PREEMPTED. A motion that ends early holds the measured position;
        a motion that is refused at its start commands nothing.
    """
    return _advanced(driver, _steps(driver, motion, _source(driver, progress is None), settings, progress))


def execute_coupled(
    driver: Driver,
    motion: Executable,
    correct: Correction | None = None,
    watch: Callable[[], Outcome | None] | None = None,
    scalings: Callable[[], tuple[float, ...]] | None = None,
    settings: ExecutionSettings = ExecutionSettings(),
    progress: Progress | None = None,
) -> ExecutionResult:
    """Execute one trajectory of several arms on a common clock,
    and wait until all arms are at rest at the end of the trajectory.

    Args:
        motion: motion from a `MotionGate`, which checks it for collisions first; setting it stops all arms.
        correct: maps the trajectory time [s] and the setpoints q, v, each (n,), to the setpoints to send.
        watch: called after every setpoint; a failure that it returns stops all arms and becomes the result.
        scalings: returns each arm's allowed speed fraction, 0..1; the smallest one slows the common clock.
            By default, the speed fraction that the driver reports for sliders and pauses, if it reports one.
    Returns:
        The result as from `execute`, or the failure that `watch` returned.
    """
    source = partial(CoupledSetpoints, correct=correct, watch=watch, scalings=scalings)
    return _advanced(driver, _steps(driver, motion, source, settings, progress))


def execution_steps(
    driver: Driver,
    motion: Executable,
    settings: ExecutionSettings = ExecutionSettings(),
    progress: Progress | None = None,
) -> ExecutionSteps:
    """Execute a motion with the executor as a generator: each call of `next` sends the driver the commands
    for its next period.

    The caller advances the driver's clock between two steps. Several of these generators, for different
    joints, can run on one driver at the same time. Arguments and result are those of `execute`.

    An arm that already moves, for example because a newer motion takes over, is not stopped first: the offset
    from the trajectory's start, in position and velocity, fades out. This does not apply to robots that play
    trajectories themselves.
    """
    return _steps(driver, motion, _source(driver), settings, progress)


def _source(driver: Driver, may_play: bool = False) -> Source:
    """Select the source of setpoints that the executor uses for a driver: streaming, or playback by the
    robot.

    Args:
        may_play: True if the driver may advance the clock itself.
    """
    if Capability.PLAY_TRAJECTORY in driver.capabilities:
        return RobotPlayback
    return partial(StreamedSetpoints, plays=may_play and Capability.PLAY_PARTS in driver.capabilities)


def _advanced(driver: Driver, steps: ExecutionSteps) -> ExecutionResult:
    """Run all steps of a motion's execution to the end, and advance the driver's clock between the steps."""
    while True:
        try:
            next(steps)
        except StopIteration as end:
            return end.value
        driver.advance(driver.period)


def _steps(
    driver: Driver,
    motion: Executable,
    source: Source,
    settings: ExecutionSettings,
    progress: Progress | None,
) -> ExecutionSteps:
    executable(motion)
    try:
        result = yield from _Execution(driver, motion, settings, progress).run(source)
    except BaseException as error:
        motion.end(ExecutionResult(ErrorCode.CONTROL_FAILED, str(error)))
        raise
    return motion.end(result)


class _Execution:
    """State of the executor while it executes one motion, from the check of the start to the result."""

    def __init__(
        self, driver: Driver, motion: Executable, settings: ExecutionSettings, progress: Progress | None
    ):
        self.driver, self.motion, self.settings, self.progress = driver, motion, settings, progress
        self.trajectory, self.began = motion.trajectory, driver.now
        self.names = self.trajectory.joint_names
        self.tracking = 0.0  # [rad or m] largest tracking error so far

    def run(self, make_source: Source) -> ExecutionSteps:
        """Execute a motion as a generator (`ExecutionSteps`) that yields once per driver period."""
        measured = self.driver.joint_state().reindexed(self.names)
        if len(self.trajectory.times) == 0:
            self.driver.stop()  # ROS: an empty trajectory means stop
            return self._result(ErrorCode.SUCCESS, "empty trajectory: stopped")
        if (refused := self._check_start(measured)) is not None:
            return refused
        source = make_source(self.driver, self.trajectory, self.settings)
        blend = blend_from(measured, self.trajectory, self.settings) if source.blends else None
        if (refused := self.motion.begin(blend)) is not None or (refused := self._dry_run()) is not None:
            return refused
        if (outcome := self._fault()) is None and (outcome := source.start(blend)) is None:
            outcome = yield from self._move(source)
        if not (outcome.ok or source.over):
            self.driver.stop()
        source.end(outcome)
        off = self.driver.joint_state().positions[source.columns] - self.trajectory.positions[-1]
        final_error = float(np.max(np.abs(off), initial=0.0))
        return self._result(outcome.code, outcome.message, outcome.evidence, final_error)

    # --- before the motion ---
    def _check_start(self, measured: JointState) -> ExecutionResult | None:
        """Check before the executor runs whether the arm is at the start of the trajectory; return a failure
        if it is not, else None.
        """
        error, column = largest(np.abs(measured.positions - self.trajectory.positions[0]))
        tolerance, code = self.settings.start_tolerance, ErrorCode.CONTROL_FAILED
        if error <= tolerance:
            return None
        text = (
            f"{self.names[column]} is {error:.3f} from the trajectory's start (tolerance {tolerance:g}): "
            "the robot moved since it was planned; plan again from the current state"
        )
        return ExecutionResult(
            code, text, {"joint": self.names[column], "error": error, NOT_STARTED: True},
            self.began, self.began,
            explainer=partial(explain_start, measured, self.trajectory.start, tolerance, code, text),
        )  # fmt: skip

    def _dry_run(self) -> ExecutionResult | None:
        """Dry-run a motion in simulation before the executor executes it; return a failure if the dry run
        refuses the motion, else None.
        """
        dry_runs = Capability.DRY_RUN in self.driver.capabilities
        refused = self.driver.dry_run(self.trajectory) if dry_runs else None
        return None if refused is None else self._result(refused.code, refused.message, refused.evidence)

    # --- the motion ---
    def _move(self, source: SetpointSource) -> Generator[None, None, Outcome]:
        """Send the setpoints of a motion from the executor until the arm is at rest at the goal, and return
        the outcome.
        """
        while True:
            if source.complete and (outcome := self._settle(source)) is not None:
                return outcome
            if self.motion.is_set():
                yield from self._halt(source)
                text = f"cancelled at {source.clock:.2f} of {source.duration:.2f} s"
                return Outcome(ErrorCode.PREEMPTED, text)
            if source.send():
                yield
            if (outcome := self._fault()) is not None:
                return outcome
            if (outcome := self._check(source)) is not None:
                source.cancel()
                return outcome

    def _check(self, source: SetpointSource) -> Outcome | None:
        """Compare the moving arm with the executor's setpoints; return the outcome that ends the motion, or
        None to continue.
        """
        found = source.tracking_error()
        if found is not None:
            self.tracking = max(self.tracking, found[0])
        if (outcome := source.ended()) is not None or found is None:
            return outcome
        if found[0] > self.settings.path_tolerance:
            return self._off(found, f"left the path by {found[0]:.3f} at {source.clock:.2f} s", "path")
        if self.progress is not None:
            self.progress(min(source.clock / source.duration, 1.0) if source.duration > 0 else 1.0)
        return None

    def _settle(self, source: SetpointSource) -> Outcome | None:
        """Check whether the arm is at rest at the goal of the executor's motion. Return success if it is, a
        failure after the time limit, or None to keep waiting.
        """
        state = self.driver.joint_state()
        found = largest(np.abs(state.positions[source.columns] - source.goal))
        v = state.velocities
        speed = 0.0 if v is None else float(np.max(np.abs(v[source.columns]), initial=0.0))
        if found[0] <= self.settings.goal_tolerance and speed <= self.settings.goal_speed:
            return Outcome(ErrorCode.SUCCESS)
        if source.settling_time() > self.settings.settle_time:
            return self._off(found, f"ended {found[0]:.4f} from the goal", "goal")
        return None

    def _halt(self, source: SetpointSource) -> Generator[None, None, None]:
        """Cancel the motion that the executor runs, and wait until the arm is at rest."""
        source.cancel()
        deadline = self.driver.now + CANCEL_TIME
        while not source.halted() and self.driver.now < deadline:
            yield

    # --- results ---
    def _fault(self) -> Outcome | None:
        """Return a failure if the robot reports a fault that stops the executor's motion, else None."""
        fault = self.driver.fault()
        if fault is None:
            return None
        return Outcome(fault.code, f"stopped: {fault}", {"arm": fault.arm, "kind": fault.kind})

    def _off(self, found: tuple[float, int], text: str, tolerance: str) -> Outcome:
        error, column = found
        limit = getattr(self.settings, f"{tolerance}_tolerance")
        return Outcome(
            ErrorCode.CONTROL_FAILED,
            f"{self.names[column]} {text} (tolerance {limit:g})",
            {"joint": self.names[column], "error": error},
        )

    def _result(self, code: ErrorCode, text: str, evidence=None, final_error: float = 0.0) -> ExecutionResult:
        return ExecutionResult(
            code,
            text,
            {} if evidence is None else evidence,
            self.began,
            self.driver.now,
            self.tracking,
            final_error,
        )


def blend_from(
    measured: JointState, trajectory: JointTrajectory, settings: ExecutionSettings
) -> JointTrajectory | None:
    """Return a quintic blend with which the executor passes from an arm's current motion into a new
    trajectory, or None if the arm is at rest.

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
