"""Steps of a planned task and how each is performed on the driver."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

from armcell.control import GuardedMotion, execute
from armcell.core import ErrorCode, JointTrajectory, Outcome
from armcell.model import Gripper
from armcell.scene import PlanningScene
from armcell.tasks.context import Holding, StageReport, TaskContext

DONE = Outcome(ErrorCode.SUCCESS)
LOST_FOR = 0.1  # [s] that nothing has been felt between the fingers
EMPTY = "empty"  # in the evidence of what ended with an empty hand
LOOK_AT_HANDS = 0.019  # [s] between two looks at what they hold


@dataclass(frozen=True, eq=False)
class Motion:
    """A planned arm motion."""

    name: str
    trajectory: JointTrajectory
    planner: str = ""
    planning_time: float = 0.0
    clearance: float | None = None
    planned_in: PlanningScene | None = None  # with the contacts that belong to the motion
    evidence: Mapping[str, Any] = field(default_factory=dict)  # what was asked of the planner, what it tells

    @property
    def duration(self) -> float:
        """[s]"""
        return self.trajectory.duration

    def told(self) -> dict[str, Any]:
        """What a record keeps of how it was planned."""
        return {
            "planner": self.planner, "planning_time_s": self.planning_time, "clearance_m": self.clearance,
            "evidence": dict(self.evidence),
        }  # fmt: skip

    def perform(self, ctx: TaskContext) -> Outcome:
        report = StageReport(self.name, self.planner, self.planning_time, clearance_m=self.clearance)
        return staged(ctx, report, lambda: self._move(ctx, report))

    def _move(self, ctx: TaskContext, report: StageReport) -> Outcome:
        trajectory = ctx.clear(self)
        if isinstance(trajectory, Outcome):
            return trajectory
        before = {n: ctx.T_tcp_object(h.object, h.gripper) for n, h in ctx.holding.items()}
        ctx.announce(trajectory, self.name, **self.told())
        watch = _Watch(ctx, trajectory, self.planned_in)
        result = execute(ctx.driver, watch, ctx.settings.execution, ctx.progress)
        ctx.rested()
        for name, T_before in before.items():
            held = ctx.holding[name]
            report.slip_m = T_before.distance_to(ctx.T_tcp_object(held.object, held.gripper))[0]
        return watch.dropped(self.name) if watch.lost is not None else result


class _Watch(GuardedMotion):
    """A motion that also stops when a hand has lost what it carries."""

    def __init__(self, ctx: TaskContext, trajectory: JointTrajectory, planned_in: PlanningScene | None):
        super().__init__(ctx.gate, trajectory, planned_in, ctx.cancel)
        self._ctx = ctx
        self._since: dict[str, float] = {}  # [s] by object
        self._next_look = 0.0  # [s]
        self.lost: Holding | None = None

    def is_set(self) -> bool:
        if self._ctx.holding and (now := self._ctx.driver.now) >= self._next_look:
            self._next_look = now + LOOK_AT_HANDS
            self._look_at_hands(now)
        return self.lost is not None or super().is_set()

    def _look_at_hands(self, now: float) -> None:
        for name, held in self._ctx.holding.items():
            if self._ctx.driver.gripper(held.gripper.name).held == name:
                self._since.pop(name, None)
            elif now - self._since.setdefault(name, now) > LOST_FOR:
                self.lost = held

    def dropped(self, where: str) -> Outcome:
        """The outcome of a motion on which something was lost; it is no longer held."""
        assert self.lost is not None
        item = self.lost.object
        text = f"lost {item} on the way ({where}): nothing is between the fingers any more"
        return lost(self._ctx, item, text)


@dataclass(frozen=True, eq=False)
class Grip:
    """Drive a gripper to a width [m]; with `force` given and width 0, close until it holds."""

    name: str
    gripper: Gripper
    width: float
    force: float
    settle: float = 0.0

    def perform(self, ctx: TaskContext) -> Outcome:
        self.start(ctx)
        return self.finish(ctx)

    def start(self, ctx: TaskContext) -> None:
        """Set the fingers going."""
        ctx.driver.command_gripper(self.gripper.name, self.width, self.force)

    def finish(self, ctx: TaskContext) -> Outcome:
        """Wait until they are there."""
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
class Together:
    """An arm motion, or a merged one of two arms, with fingers that move meanwhile."""

    motion: Motion | None
    grips: tuple[Grip, ...]

    @property
    def duration(self) -> float:
        """[s] of the motion."""
        return self.motion.duration if self.motion else 0.0

    def perform(self, ctx: TaskContext) -> Outcome:
        for grip in self.grips:
            grip.start(ctx)
        outcome = self.motion.perform(ctx) if self.motion else DONE
        for grip in self.grips if outcome.ok else ():
            outcome = grip.finish(ctx)
            if not outcome.ok:
                break
        return outcome


@dataclass(frozen=True, eq=False)
class Hold:
    """The gripper has closed: is the object between the fingers? From here on it counts as held."""

    object: str
    gripper: Gripper

    def perform(self, ctx: TaskContext) -> Outcome:
        reading = ctx.driver.gripper(self.gripper.name)
        if reading.held != self.object:
            between = f"{reading.held} is" if reading.held else "nothing is"
            x, y, z = ctx.scene().object(self.object).T_world_object.translation
            text = f"grasp failed: {between} between the fingers ({reading.width * 1000:.1f} mm apart)"
            text += f"; the scene has {self.object} at {x:.3f} {y:.3f} {z:.3f}"
            return not_held(ctx, text)
        T = ctx.T_tcp_object(self.object, self.gripper)
        ctx.take(Holding(self.object, self.gripper, T))
        ctx.emit("grasp", f"holds {self.object} with {reading.force_per_finger:.0f} N per finger")
        return DONE


@dataclass(frozen=True, eq=False)
class Release:
    """The gripper has opened: the object belongs to the world again."""

    object: str

    def perform(self, ctx: TaskContext) -> Outcome:
        ctx.holding.pop(self.object, None)
        ctx.emit("grasp", f"released {self.object}")
        return DONE


@dataclass(frozen=True, eq=False)
class Expect:
    """Contacts that belong to the task from here on (or no longer)."""

    body: str
    others: tuple[str, ...]
    expected: bool = True

    def perform(self, ctx: TaskContext) -> Outcome:
        if self.others:
            ctx.expect_contact(self.body, self.others, self.expected)
        return DONE


@dataclass(frozen=True, eq=False)
class Watch:
    """A held object may touch nothing but its supports (or is no longer watched)."""

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
class CheckGrasp:
    """After the lift: the object came along, and is still between the fingers."""

    object: str
    gripper: Gripper
    height_before: float  # [m] of the object's origin
    rise: float  # [m] wanted

    def perform(self, ctx: TaskContext) -> Outcome:
        reading = ctx.driver.gripper(self.gripper.name)
        height = float(ctx.driver.object_poses()[self.object].translation[2])
        if reading.held == self.object and height - self.height_before >= 0.5 * self.rise:
            return DONE
        rose = height - self.height_before
        return lost(
            ctx, self.object, f"lost {self.object}: it rose {rose * 1000:.0f} of {self.rise * 1000:.0f} mm"
        )


@dataclass(frozen=True, eq=False)
class StillHeld:
    """Before something is done with a held object: is it still between the fingers?"""

    object: str
    gripper: Gripper

    def perform(self, ctx: TaskContext) -> Outcome:
        reading = ctx.driver.gripper(self.gripper.name)
        if reading.held == self.object:
            return DONE
        apart = reading.width * 1000
        text = f"lost {self.object} on the way: the fingers are {apart:.1f} mm apart without it"
        return lost(ctx, self.object, text)


@dataclass(frozen=True, eq=False)
class Dwell:
    """Stand still [s]; reports how far a held object slips meanwhile."""

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
    """What a step ends with where a hand has not, or no longer, what it should have."""
    ctx.emit("grasp", text)
    return Outcome(ErrorCode.CONTROL_FAILED, text, {EMPTY: True})


def lost(ctx: TaskContext, item: str, text: str) -> Outcome:
    """The same of an object that was held: it belongs to the world again."""
    ctx.lose(item, text)
    ctx.driver.unwatch_object(item)
    return not_held(ctx, text)


class Step(Protocol):
    """Something that a task does."""

    def perform(self, ctx: TaskContext) -> Outcome: ...


def staged(ctx: TaskContext, report: StageReport, act: Callable[[], Outcome]) -> Outcome:
    """Run a step that shows in the stage table."""
    report.started_s = ctx.driver.now
    ctx.emit("stage", report.name, phase="begin")
    outcome = act()
    report.motion_time_s = ctx.driver.now - report.started_s
    report.ok, report.error = outcome.ok, "" if outcome.ok else outcome.message
    ctx.reports.append(report)
    ctx.emit("stage", report.name, phase="end", ok=report.ok, error=report.error)
    return outcome


def perform_all(ctx: TaskContext, steps: Iterable[Step]) -> Outcome:
    """Perform steps until one fails."""
    for step in steps:
        if ctx.cancel.is_set():
            return Outcome(ErrorCode.PREEMPTED, "cancelled")
        outcome = step.perform(ctx)
        if not outcome.ok:
            return outcome
    return DONE
