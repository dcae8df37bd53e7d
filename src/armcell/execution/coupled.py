"""Synchronized execution of one trajectory on several arms: one clock, one speed scaling."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from armcell.core import ErrorCode, ExecutionResult, Outcome, Playback
from armcell.drivers import Capability, Driver
from armcell.drivers.guarding import Watch
from armcell.execution.executor import ExecutionSettings, Progress
from armcell.execution.gate import Executable, executable

Array = NDArray[np.float64]

LATEST = 4  # driver periods of a real robot that one tick can catch up
RAMP = 2.0  # [1/s] limit on the scaling's rate: a pause brakes within half a second


def execute_coupled(
    driver: Driver,
    motion: Executable,
    correct: Callable[[float, Array, Array], tuple[Array, Array]] | None = None,
    watch: Callable[[], Outcome | None] | None = None,
    scalings: Callable[[], tuple[float, ...]] | None = None,
    settings: ExecutionSettings = ExecutionSettings(),
    progress: Progress | None = None,
) -> ExecutionResult:
    """Play one trajectory of several arms on one clock and wait until all arms rest at its end.

    Args:
        motion: motion from a `MotionGate`, which checks it for collisions first; setting it stops all arms.
        correct: maps the trajectory time [s] and the setpoints q, v, each (n,), to the setpoints to send.
        watch: called after every tick; a failure that it returns stops all arms and becomes the result.
        scalings: returns each arm's allowed speed fraction, 0..1; the smallest one slows the common clock.
            By default, the speed fraction that the driver reports for sliders and pauses, if it reports one.
    Returns:
        The result as from `execute`, or the failure that `watch` returned.
    """
    executable(motion)
    try:
        result = _coupled(driver, motion, correct, watch, scalings, settings, progress)
    except BaseException as error:
        motion.end(ExecutionResult(ErrorCode.CONTROL_FAILED, str(error)))
        raise
    return motion.end(result)


def _coupled(
    driver: Driver,
    motion: Executable,
    correct: Callable[[float, Array, Array], tuple[Array, Array]] | None,
    watch: Callable[[], Outcome | None] | None,
    scalings: Callable[[], tuple[float, ...]] | None,
    settings: ExecutionSettings,
    progress: Progress | None,
) -> ExecutionResult:
    trajectory = motion.trajectory
    names, began = trajectory.joint_names, driver.now
    whole = driver.joint_state()
    columns, tracking = np.array(whole.columns(names), dtype=int), 0.0
    measured = whole.positions[columns]

    twin: Watch | None = None

    def ended(outcome: Outcome) -> ExecutionResult:
        if not outcome.ok:
            driver.stop()
        if twin is not None:
            twin.end("done" if outcome.ok else outcome.message)
        final = driver.joint_state().positions[columns] - trajectory.positions[-1]
        return ExecutionResult(
            outcome.code, outcome.message, outcome.evidence, began, driver.now, tracking,
            float(np.max(np.abs(final))),
        )  # fmt: skip

    off = np.abs(measured - trajectory.positions[0])
    if off.max() > settings.start_tolerance:
        joint = names[int(np.argmax(off))]
        text = f"{joint} is {off.max():.3f} from the trajectory's start: plan again from the current state"
        return ended(Outcome(ErrorCode.CONTROL_FAILED, text, {"joint": joint, "error": float(off.max())}))
    if (unproven := motion.begin()) is not None:
        return unproven
    paced = Capability.ROBOT_CLOCK in driver.capabilities
    if scalings is None and paced:
        scalings = lambda: (driver.speed_fraction,)  # noqa: E731
    if Capability.DRY_RUN in driver.capabilities:
        if (refused := driver.rehearse(trajectory)) is not None:
            return ended(refused)
        twin = driver.watch(trajectory, correct is not None)
    sent = _Sent(driver.latency if paced else 0.0)
    playback = Playback(trajectory)
    clock, scale, last = 0.0, 1.0, driver.tick if paced else 0.0
    deadline: float | None = None
    while True:
        if motion.is_set():
            return ended(Outcome(ErrorCode.PREEMPTED, f"cancelled at {clock:.2f} s"))
        if (fault := driver.fault()) is not None:
            return ended(Outcome(fault.code, f"stopped: {fault}", {"arm": fault.arm, "kind": fault.kind}))
        wanted = 1.0 if scalings is None else min(max(float(min(scalings())), 0.0), 1.0)
        step = RAMP * driver.period
        scale = min(max(wanted, scale - step), scale + step)
        passed = driver.period
        if paced:  # real time passes on its own: a late program must not cause a jump
            passed, last = min(driver.tick - last, LATEST * driver.period), driver.tick
        clock = min(clock + scale * passed, trajectory.duration)
        q, v = playback.at(clock)
        v = v * scale
        planned = q
        if correct is not None:
            q, v = correct(clock, q, v)
        driver.command(names, q, v)
        if twin is not None:
            twin.sent(clock, q - planned)
        driver.advance(driver.period)
        if twin is not None:
            twin.look()
        state = driver.joint_state()
        at = state.positions[columns]
        error = np.abs(at - sent.nearest(at, q, driver.now))
        worst = int(error.argmax())
        tracking = max(tracking, float(error[worst]))
        if watch is not None and (trouble := watch()) is not None:
            return ended(trouble)
        if error[worst] > settings.path_tolerance:
            text = f"{names[worst]} left the path by {error[worst]:.3f} at {clock:.2f} s"
            return ended(Outcome(ErrorCode.CONTROL_FAILED, text, {"joint": names[worst]}))
        if progress is not None:
            progress(clock / trajectory.duration if trajectory.duration > 0 else 1.0)
        if clock < trajectory.duration:
            continue
        deadline = driver.now + settings.settle_time if deadline is None else deadline
        error = np.abs(at - q)
        worst = int(error.argmax())
        speed = 0.0 if state.velocities is None else float(np.max(np.abs(state.velocities[columns])))
        if error[worst] <= settings.goal_tolerance and speed <= settings.goal_speed:
            return ended(Outcome(ErrorCode.SUCCESS))
        if driver.now > deadline:
            text = f"{names[worst]} ended {error[worst]:.4f} from the goal"
            return ended(Outcome(ErrorCode.CONTROL_FAILED, text, {"joint": names[worst]}))


class _Sent:
    """Setpoints of the last `latency` seconds; a real robot lags behind the newest setpoint."""

    def __init__(self, latency: float):
        self._latency = latency
        self._kept: deque[tuple[float, Array]] = deque()

    def nearest(self, measured: Array, q: Array, now: float) -> Array:
        """Return the recorded setpoint (n,) that is nearest to the measured position.

        Args:
            measured: measured joint positions (n,) [rad or m].
            q: newest setpoint (n,), added to the history first.
            now: driver time [s].
        """
        self._kept.append((now, q))
        while self._kept[0][0] < now - self._latency:
            self._kept.popleft()
        if len(self._kept) == 1:
            return q
        return min((q for _, q in self._kept), key=lambda q: float(np.abs(measured - q).max()))
