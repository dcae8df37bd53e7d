"""Parts of a task in turn, each planned while the one before it is performed."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from armcell.core import Outcome
from armcell.core.checks import checked, require
from armcell.model import Gripper
from armcell.planning import warm_up
from armcell.scene import PlanningScene
from armcell.tasks.context import TaskContext
from armcell.tasks.costs import costs
from armcell.tasks.recipes import Vector, pick_stages, place_stages
from armcell.tasks.search import Draft, Planning, Stage
from armcell.tasks.steps import DONE, perform_all
from armcell.tasks.task import Task, TaskPlan, tell_rejected


@dataclass(frozen=True, eq=False)
class Part:
    """Some stages of a task, made from the scene in which they will begin."""

    name: str
    stages: Callable[[TaskContext, PlanningScene], Sequence[Stage]]


@dataclass(frozen=True)
@checked()
class AheadSettings:
    """When a plan that was made ahead still holds."""

    joints: float = 0.02  # [rad or m] between where an arm was to be and where it is
    distance: float = 0.003  # [m] of any object
    turn: float = 0.05  # [rad] of any object

    def __post_init__(self) -> None:
        for name in ("joints", "distance", "turn"):
            require(getattr(self, name) > 0, f"{name} is {getattr(self, name):g}, it must be positive")


def picking(item: str, gripper: Gripper) -> Part:
    """Picking as a part; one attempt."""
    return Part(f"pick {item}", lambda ctx, scene: pick_stages(scene, item, gripper, ctx.settings))


def placing(
    item: str, on: str, gripper: Gripper, at: tuple[float, float] | None = None, up: Vector | None = None
) -> Part:
    """Placing as a part; one attempt."""
    return Part(f"place {item} on {on}", lambda ctx, _: place_stages(item, on, gripper, ctx.settings, at, up))


def perform_parts(
    ctx: TaskContext, parts: Sequence[Part], settings: AheadSettings = AheadSettings()
) -> Outcome:
    """Perform parts in turn; while one is performed the next is planned, from the scene it should lead to.

    Where the world then is not as it should be, that part is planned again from what is measured. So the same
    seed gives the same run, however long planning takes.

    Returns:
        SUCCESS, or the first part's failure. Evidence: `performed`, the parts that were; `ahead`, how many of
        them by a plan made ahead; `again`, by part, why it was planned again.
    """
    warm_up()
    done: list[str] = []
    again: dict[str, str] = {}
    coming = _Coming(ctx, parts[0], ctx.scene()) if parts else None
    for i, part in enumerate(parts):
        assert coming is not None
        plan, now = coming.wait(), ctx.scene()
        wrong = changed(coming.scene, now, settings) if i else ""
        if wrong and not ctx.cancel.is_set():
            again[part.name] = wrong
            ctx.emit("note", f"{part.name}: planned again, {wrong}")
            plan = _Coming(ctx, part, now).wait()
        if plan.best is None:
            ctx.emit("error", plan.message, code=plan.code.name, **plan.evidence)
            return _told(Outcome(plan.code, plan.message, plan.evidence), done, again)
        tell_rejected(ctx, plan, part.name)
        coming = _Coming(ctx, parts[i + 1], plan.best.scene) if i + 1 < len(parts) else None
        outcome = perform_all(ctx, plan.best.steps)
        if not outcome.ok:
            if coming is not None:
                coming.stop()
            return _told(replace(outcome, message=f"{part.name}: {outcome.message}"), done, again)
        done.append(part.name)
    return _told(DONE, done, again)


def _told(outcome: Outcome, done: list[str], again: dict[str, str]) -> Outcome:
    ahead = max(len(done) - 1, 0) - sum(name in again for name in done)
    return replace(
        outcome, evidence={**outcome.evidence, "performed": done, "ahead": ahead, "again": dict(again)}
    )


class _Coming:
    """A part that is being planned in a thread of its own."""

    def __init__(self, ctx: TaskContext, part: Part, scene: PlanningScene):
        self.scene = scene
        self._ctx, self._part = ctx, part
        self._cancel = threading.Event()
        self._plan: TaskPlan | None = None
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name=f"plan {part.name}", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        try:
            s = self._ctx.settings
            task = Task(self._part.name, tuple(self._part.stages(self._ctx, self.scene)), costs[s.cost])
            planning = Planning(s, self._ctx.seed, self._cancel)
            self._plan = task.plan(Draft(self.scene), planning, s.solutions)
        except BaseException as error:  # raised again by `wait`, in the task's own thread
            self._error = error

    def wait(self) -> TaskPlan:
        while self._thread.is_alive():
            if self._ctx.cancel.is_set():
                self._cancel.set()
            self._thread.join(0.05)
        if self._error is not None:
            raise self._error
        assert self._plan is not None
        return self._plan

    def stop(self) -> None:
        self._cancel.set()
        self._thread.join()


def changed(expected: PlanningScene, now: PlanningScene, settings: AheadSettings = AheadSettings()) -> str:
    """How a scene differs from the one that was planned for; empty where it does not matter."""
    s, model = settings, now.model
    fingers = {gripper.joint_name for gripper in model.grippers.values()}
    for i, name in enumerate(model.joint_names):
        away = abs(float(now.positions[i] - expected.positions[i]))
        if name not in fingers and away > s.joints:
            return f"{name} is {away:.3f} from where it should be"
    if missing := set(expected.objects) ^ set(now.objects):
        return f"{', '.join(sorted(missing))} came or went"
    if held := set(expected.attached) ^ set(now.attached):
        return f"{', '.join(sorted(held))} should {'' if held & set(expected.attached) else 'not '}be held"
    for name in (*now.objects, *now.attached):
        if now.object(name).shapes is not expected.object(name).shapes:  # a map of what a camera sees
            return f"{name} is another shape"
        away, turn = expected.frame_pose(name).distance_to(now.frame_pose(name))
        if away > s.distance or turn > s.turn:
            degrees = np.rad2deg(turn)
            return f"{name} is {away * 1000:.1f} mm and {degrees:.1f} deg from where it should be"
    return ""
