"""Arms that are coupled: one trajectory, one clock, one scaling for all, watched at every tick."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from armcell.control.driver import Driver, Rehearsing, Watch
from armcell.control.executor import ExecutionSettings, Progress
from armcell.control.following import Follower, Paced
from armcell.control.gate import Executable, executable
from armcell.core import ErrorCode, ExecutionResult, Outcome, Playback
from armcell.core.protocols import offers

Array = NDArray[np.float64]

LATEST = 4  # periods of a real robot's driver that one tick makes up for
RAMP = 2.0  # [1/s] how fast the scaling may change: a pause brakes within half a second


def execute_coupled(
    driver: Driver,
    motion: Executable,
    correct: Callable[[float, Array, Array], tuple[Array, Array]] | None = None,
    watch: Callable[[], Outcome | None] | None = None,
    scalings: Callable[[], tuple[float, ...]] | None = None,
    settings: ExecutionSettings = ExecutionSettings(),
    progress: Progress | None = None,
) -> ExecutionResult:
    """Play one trajectory of several arms on one clock, and wait until all rest at its end.

    Args:
        motion: from a `MotionGate`, which proves it first; when it is set, all arms stop.
        correct: gets the time on the trajectory and the set points (n,), (n,); returns those to send.
        watch: looked at after every tick; a failure it returns stops all arms and is the result.
        scalings: what each arm lets itself be slowed to, 0..1; the smallest slows the common clock. By
            default what the driver tells of sliders and pauses, where it does.
    Returns:
        As `execute`, or what `watch` returned.
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
    paced = driver if offers(driver, Paced) else None
    if scalings is None and paced is not None:
        scalings = lambda: (paced.speed_fraction,)  # noqa: E731
    rehearsing = driver if offers(driver, Rehearsing) else None
    if rehearsing is not None and (refused := rehearsing.rehearse(trajectory)) is not None:
        return ended(refused)
    twin = rehearsing and rehearsing.watch(trajectory, correct is not None)
    follower = driver if offers(driver, Follower) else None
    sent = _Sent(0.0 if paced is None else paced.latency)
    playback = Playback(trajectory)
    clock, scale, last = 0.0, 1.0, 0.0 if paced is None else paced.tick
    deadline: float | None = None
    while True:
        if motion.is_set():
            return ended(Outcome(ErrorCode.PREEMPTED, f"cancelled at {clock:.2f} s"))
        if follower is not None and (fault := follower.fault()) is not None:
            return ended(Outcome(fault.code, f"stopped: {fault}", {"arm": fault.arm, "kind": fault.kind}))
        wanted = 1.0 if scalings is None else min(max(float(min(scalings())), 0.0), 1.0)
        step = RAMP * driver.period
        scale = min(max(wanted, scale - step), scale + step)
        passed = driver.period
        if paced is not None:  # a real robot's time passes by itself; this program being late is no jump
            passed, last = min(paced.tick - last, LATEST * driver.period), paced.tick
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
    """Set points of the last `latency` [s]: a real robot is on its way to one of them."""

    def __init__(self, latency: float):
        self._latency = latency
        self._kept: deque[tuple[float, Array]] = deque()

    def nearest(self, measured: Array, q: Array, now: float) -> Array:
        """The one of them that is nearest to where the robot is, the last one (n,) among them."""
        self._kept.append((now, q))
        while self._kept[0][0] < now - self._latency:
            self._kept.popleft()
        if len(self._kept) == 1:
            return q
        return min((q for _, q in self._kept), key=lambda q: float(np.abs(measured - q).max()))
