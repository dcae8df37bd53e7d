"""Executable steps of a planned task."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

from armcell.core import ErrorCode, JointTrajectory, Outcome
from armcell.execution import GuardedMotion, execute
from armcell.model import Gripper
from armcell.scene import PlanningScene
from armcell.tasks.context import HeldObject, StageReport, TaskContext

DONE = Outcome(ErrorCode.SUCCESS)
EMPTY = "empty"  # evidence key of outcomes with an empty hand
UNLIKE = 0.004  # [m] by which a measured width may differ from the believed one without a note
LOOK_AT_HANDS = 0.019  # [s] between two checks of the grippers


@dataclass(frozen=True, eq=False)
class Motion:
    """Step of a planned task that executes a motion of the arm."""

    name: str
    trajectory: JointTrajectory
    planner: str = ""
    planning_time: float = 0.0
    clearance: float | None = None
    planned_in: PlanningScene | None = None  # with the contacts allowed for this motion
    evidence: Mapping[str, Any] = field(default_factory=dict)  # request and planner statistics
    exact: bool = False  # whether arms side by side must not replace the motion by a detour to the same goal

    @property
    def duration(self) -> float:
        """Return the duration [s] of the planned motion in a step of a task."""
        return self.trajectory.duration

    def plan_metadata(self) -> dict[str, Any]:
        """Return the planning metadata that a record stores with the motion of a task's step."""
        return {
            "planner": self.planner, "planning_time_s": self.planning_time, "clearance_m": self.clearance,
            "evidence": dict(self.evidence),
        }  # fmt: skip

    def perform(self, ctx: TaskContext) -> Outcome:
        report = StageReport(self.name, self.planner, self.planning_time, clearance_m=self.clearance)
        return staged(ctx, report, lambda: self._move(ctx, report))

    def _move(self, ctx: TaskContext, report: StageReport) -> Outcome:
        trajectory = ctx.request_start(self)
        if isinstance(trajectory, Outcome):
            return trajectory
        before = {n: ctx.T_tcp_object(h.object, h.gripper) for n, h in ctx.holding.items()}
        ctx.announce(trajectory, self.name, **self.plan_metadata())
        watch = self.monitor(ctx, trajectory)
        result = execute(ctx.driver, watch, ctx.settings.execution, ctx.progress)
        ctx.rested()
        for name, T_before in before.items():
            held = ctx.holding[name]
            report.slip_m = T_before.distance_to(ctx.T_tcp_object(held.object, held.gripper))[0]
        return watch.dropped(self.name) if watch.lost is not None else self.outcome(ctx, watch, result)

    def monitor(self, ctx: TaskContext, trajectory: JointTrajectory) -> DropMonitor:
        """Return the guarded motion that monitors a task's motion while it runs."""
        return DropMonitor(ctx, trajectory, self.planned_in)

    def outcome(self, ctx: TaskContext, watch: DropMonitor, result: Outcome) -> Outcome:
        """Return the outcome of a task's motion, given the result of its execution."""
        return result


class DropMonitor(GuardedMotion):
    """Guarded motion in a step of a task. In addition to the checks of `GuardedMotion`, it stops as soon as a
    hand has lost its object.
    """

    def __init__(self, ctx: TaskContext, trajectory: JointTrajectory, planned_in: PlanningScene | None):
        super().__init__(ctx.gate, trajectory, planned_in, ctx.cancel)
        self._ctx = ctx
        self._since: dict[str, float] = {}  # object -> start [s] of missing grip force
        self._next_look = 0.0  # [s]
        self.lost: HeldObject | None = None

    def is_set(self) -> bool:
        if self._ctx.holding and (now := self._ctx.driver.now) >= self._next_look:
            self._next_look = now + LOOK_AT_HANDS
            self._look_at_hands(now)
        return self.lost is not None or super().is_set()

    def _look_at_hands(self, now: float) -> None:
        for name, held in self._ctx.holding.items():
            if self._ctx.driver.gripper(held.gripper.name).held == name:
                self._since.pop(name, None)
            elif now - self._since.setdefault(name, now) > self._ctx.settings.lost_after:
                self.lost = held

    def dropped(self, where: str) -> Outcome:
        """Record that a hand has lost its object during a step of a task,
        and return the outcome of the motion.
        """
        assert self.lost is not None
        item = self.lost.object
        reading = self._ctx.driver.gripper(self.lost.gripper.name)
        text = f"lost {item} on the way ({where}): {reading.describe()}"
        return lost(self._ctx, item, text)


@dataclass(frozen=True, eq=False)
class CommandGripper:
    """Step of a planned task that moves a gripper to a width [m].

    With `force` and width 0, the gripper closes until it reaches the grip force.
    """

    name: str
    gripper: Gripper
    width: float
    force: float
    settle: float = 0.0

    def perform(self, ctx: TaskContext) -> Outcome:
        self.start(ctx)
        return self.finish(ctx)

    def start(self, ctx: TaskContext) -> None:
        """Command the gripper width of a task's step, without waiting for the gripper."""
        ctx.driver.command_gripper(self.gripper.name, self.width, self.force)

    def finish(self, ctx: TaskContext) -> Outcome:
        """Wait until the gripper motion of a task's step has ended."""
        return staged(ctx, StageReport(self.name), lambda: self._wait(ctx))

    def _wait(self, ctx: TaskContext) -> Outcome:
        driver, name = ctx.driver, self.gripper.name
        closing = self.width <= 0.0
        end = driver.now + ctx.settings.gripper_timeout
        while driver.now < end and not ctx.cancel.is_set():
            ctx.advance(0.02)
            reading = driver.gripper(name)
            if closing and reading.held and reading.force_per_finger >= 0.8 * self.force:
                break
            if not closing and abs(reading.width - self.width) < 1e-3:
                break
        else:
            reading = driver.gripper(name)
            if ctx.cancel.is_set():
                return Outcome(ErrorCode.PREEMPTED, "cancelled")
            if not closing:
                text = f"gripper stands at {reading.width * 1000:.1f} mm, wanted {self.width * 1000:.1f} mm"
                return Outcome(ErrorCode.CONTROL_FAILED, text)
        ctx.advance(self.settle)
        return DONE


@dataclass(frozen=True, eq=False)
class ParallelMotions:
    """Step of a task that executes an arm motion and gripper motions at the same time.

    The arm motion may be a merged motion of several arms.
    """

    motion: Motion | None
    grips: tuple[CommandGripper, ...]

    @property
    def duration(self) -> float:
        """Return the duration [s] of the arm motion in a task's step
        that combines arm and gripper motions.
        """
        return self.motion.duration if self.motion else 0.0

    def perform(self, ctx: TaskContext) -> Outcome:
        for grip in self.grips:
            grip.start(ctx)
        # the moving fingers are proven collision-free only along this motion
        outcome = replace(self.motion, exact=True).perform(ctx) if self.motion else DONE
        for grip in self.grips if outcome.ok else ():
            outcome = grip.finish(ctx)
            if not outcome.ok:
                break
        return outcome


@dataclass(frozen=True, eq=False)
class ConfirmGrasp:
    """Step of a task that checks, after the gripper has closed, that the hand holds the object.

    From then on the object counts as held.
    """

    object: str
    gripper: Gripper
    width: float = 0.0  # [m] believed width of the object between the pads; 0: unknown

    def perform(self, ctx: TaskContext) -> Outcome:
        reading = ctx.driver.gripper(self.gripper.name)
        if reading.held != self.object:
            text = f"grasp failed: {reading.describe()}; {ctx.belief(self.object, self.width)}"
            return not_held(ctx, text)
        T = ctx.T_tcp_object(self.object, self.gripper)
        ctx.record_grasp(HeldObject(self.object, self.gripper, T))
        kind = "finger" if reading.sealed is None else "cup"
        ctx.emit("grasp", f"holds {self.object} with {reading.force_per_finger:.0f} N per {kind}")
        if self.width and abs(reading.width - self.width) > UNLIKE:
            text = f"{self.object} is {reading.width * 1000:.1f} mm wide between the fingers (measured)"
            ctx.emit("note", f"{text}; {ctx.belief(self.object, self.width)}")
        return DONE


@dataclass(frozen=True, eq=False)
class Release:
    """Step of a task that detaches the object after the gripper has opened."""

    object: str

    def perform(self, ctx: TaskContext) -> Outcome:
        ctx.holding.pop(self.object, None)
        ctx.emit("grasp", f"released {self.object}")
        return DONE


@dataclass(frozen=True, eq=False)
class ExpectContact:
    """Step of a task that allows contacts of a body with other bodies, or forbids them again."""

    body: str
    others: tuple[str, ...]
    expected: bool = True

    def perform(self, ctx: TaskContext) -> Outcome:
        if self.others:
            ctx.expect_contact(self.body, self.others, self.expected)
        return DONE


@dataclass(frozen=True, eq=False)
class WatchObject:
    """Step of a task that starts or stops watching a held object for unexpected contacts.

    The object may touch nothing but its supports.
    """

    object: str
    supports: tuple[str, ...] = ()
    on: bool = True

    def perform(self, ctx: TaskContext) -> Outcome:
        if self.on:
            ctx.driver.watch_object(self.object, self.supports)
        else:
            ctx.driver.unwatch_object(self.object)
        return DONE


@dataclass(frozen=True, eq=False)
class CheckLift:
    """Step of a task that checks, after the lift, that the object has
    moved with the hand and that the hand still holds it.
    """

    object: str
    gripper: Gripper
    height_before: float  # [m] height of the object's origin
    rise: float  # [m] expected rise

    def perform(self, ctx: TaskContext) -> Outcome:
        reading = ctx.driver.gripper(self.gripper.name)
        height = float(ctx.driver.object_poses()[self.object].translation[2])
        if reading.held == self.object and height - self.height_before >= 0.5 * self.rise:
            return DONE
        rose = height - self.height_before
        text = f"lost {self.object} in the lift: {reading.describe()}"
        if reading.held == self.object:
            text += f", but it rose only {rose * 1000:.0f} of {self.rise * 1000:.0f} mm"
        return lost(ctx, self.object, text)


@dataclass(frozen=True, eq=False)
class CheckStillHeld:
    """Step of a task that checks that the gripper still holds an object."""

    object: str
    gripper: Gripper

    def perform(self, ctx: TaskContext) -> Outcome:
        reading = ctx.driver.gripper(self.gripper.name)
        if reading.held == self.object:
            return DONE
        return lost(ctx, self.object, f"lost {self.object} on the way: {reading.describe()}")


@dataclass(frozen=True, eq=False)
class Dwell:
    """Step of a task that keeps the arm still for a duration [s],
    and reports how far a held object slips meanwhile.
    """

    name: str
    duration: float

    def perform(self, ctx: TaskContext) -> Outcome:
        report = StageReport(self.name)

        def wait() -> Outcome:
            before = {n: ctx.T_tcp_object(h.object, h.gripper) for n, h in ctx.holding.items()}
            ctx.advance(self.duration)
            for name, T_before in before.items():
                held = ctx.holding[name]
                report.slip_m = T_before.distance_to(ctx.T_tcp_object(held.object, held.gripper))[0]
            return Outcome(ErrorCode.PREEMPTED, "cancelled") if ctx.cancel.is_set() else DONE

        return staged(ctx, report, wait)


def not_held(ctx: TaskContext, text: str) -> Outcome:
    """Report that the hand does not hold the object that a step of the task expects, and return the error
    outcome.
    """
    ctx.emit("grasp", text)
    return Outcome(ErrorCode.CONTROL_FAILED, text, {EMPTY: True})


def lost(ctx: TaskContext, item: str, text: str) -> Outcome:
    """Record that a held object was lost during a step of a task, and return the outcome of this step."""
    ctx.lose(item, text)
    ctx.driver.unwatch_object(item)
    return not_held(ctx, text)


class Step(Protocol):
    """Interface of an executable step of a task."""

    def perform(self, ctx: TaskContext) -> Outcome: ...


def staged(ctx: TaskContext, report: StageReport, act: Callable[[], Outcome]) -> Outcome:
    """Execute a step of a task, and add an entry for it to the stage table."""
    report.started_s = ctx.driver.now
    ctx.emit("stage", report.name, phase="begin")
    outcome = act()
    report.motion_time_s = ctx.driver.now - report.started_s
    report.ok, report.error = outcome.ok, "" if outcome.ok else outcome.message
    ctx.reports.append(report)
    ctx.emit("stage", report.name, phase="end", ok=report.ok, error=report.error)
    return outcome


def perform_all(ctx: TaskContext, steps: Iterable[Step]) -> Outcome:
    """Execute the steps of a planned task one after the other, until one fails."""
    for step in steps:
        if ctx.cancel.is_set():
            return Outcome(ErrorCode.PREEMPTED, "cancelled")
        outcome = step.perform(ctx)
        if not outcome.ok:
            return outcome
    return DONE
