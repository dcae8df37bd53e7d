"""Pipelined tasks: while one task runs, the next one is planned."""

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
from armcell.tasks.pick import pick_stages
from armcell.tasks.recipes import Vector, place_stages
from armcell.tasks.search import PartialSolution, SearchState, Stage
from armcell.tasks.steps import DONE, perform_all
from armcell.tasks.task import Task, TaskPlan, emit_rejections


@dataclass(frozen=True, eq=False)
class PipelinedTask:
    """Pipelined task: its name, and a function that creates the task's
    stages from the scene in which they will start.
    """

    name: str
    stages: Callable[[TaskContext, PlanningScene], Sequence[Stage]]


@dataclass(frozen=True)
@checked()
class PipelineSettings:
    """Tolerances for a pipelined task: how far the scene may differ from the
    predicted one before a plan made in advance becomes invalid.
    """

    joints: float = 0.02  # [rad or m] between predicted and measured joint position
    distance: float = 0.003  # [m] of any object
    turn: float = 0.05  # [rad] of any object

    def __post_init__(self) -> None:
        for name in ("joints", "distance", "turn"):
            require(getattr(self, name) > 0, f"{name} is {getattr(self, name):g}, it must be positive")


def picking(item: str, gripper: Gripper) -> PipelinedTask:
    """Create a task that picks an object and can be planned while another task runs (`PipelinedTask`). The
    task makes only one attempt.
    """
    return PipelinedTask(f"pick {item}", lambda ctx, scene: pick_stages(scene, item, gripper, ctx.settings))


def placing(
    item: str, on: str, gripper: Gripper, at: tuple[float, float] | None = None, up: Vector | None = None
) -> PipelinedTask:
    """Create a task that places an object and can be planned while another task runs (`PipelinedTask`). The
    task makes only one attempt.
    """
    return PipelinedTask(
        f"place {item} on {on}", lambda ctx, _: place_stages(item, on, gripper, ctx.settings, at, up)
    )


def perform_pipelined(
    ctx: TaskContext, tasks: Sequence[PipelinedTask], settings: PipelineSettings = PipelineSettings()
) -> Outcome:
    """Perform pipelined tasks one after the other.
    While one task runs, the next one is planned from the predicted scene.

    If the measured scene differs from the prediction, the task is planned again. The run does not depend on
    the planning time.

    Returns:
        SUCCESS, or the first failure. Evidence: `performed`, the names of the performed tasks; `ahead`, how
        many of them used a plan made in advance; `again`, by task, the reason for planning again.
    """
    warm_up()
    done: list[str] = []
    again: dict[str, str] = {}
    background = _BackgroundPlan(ctx, tasks[0], ctx.scene()) if tasks else None
    for i, task_spec in enumerate(tasks):
        assert background is not None
        plan, now = background.wait(), ctx.scene()
        difference = scene_difference(background.scene, now, settings) if i else ""
        if difference and not ctx.cancel.is_set():
            again[task_spec.name] = difference
            ctx.emit("note", f"{task_spec.name}: planned again, {difference}")
            plan = _BackgroundPlan(ctx, task_spec, now).wait()
        if plan.best is None:
            ctx.emit("error", plan.message, code=plan.code.name, **plan.evidence)
            return _with_evidence(Outcome(plan.code, plan.message, plan.evidence), done, again)
        emit_rejections(ctx, plan, task_spec.name)
        background = _BackgroundPlan(ctx, tasks[i + 1], plan.best.scene) if i + 1 < len(tasks) else None
        outcome = perform_all(ctx, plan.best.steps)
        if not outcome.ok:
            if background is not None:
                background.stop()
            return _with_evidence(
                replace(outcome, message=f"{task_spec.name}: {outcome.message}"), done, again
            )
        done.append(task_spec.name)
    return _with_evidence(DONE, done, again)


def _with_evidence(outcome: Outcome, done: list[str], again: dict[str, str]) -> Outcome:
    ahead = max(len(done) - 1, 0) - sum(name in again for name in done)
    return replace(
        outcome, evidence={**outcome.evidence, "performed": done, "ahead": ahead, "again": dict(again)}
    )


class _BackgroundPlan:
    """Plan that a background thread computes for a pipelined task while another task is running."""

    def __init__(self, ctx: TaskContext, task_spec: PipelinedTask, scene: PlanningScene):
        self.scene = scene
        self._ctx, self._part = ctx, task_spec
        self._cancel = threading.Event()
        self._plan: TaskPlan | None = None
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name=f"plan {task_spec.name}", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        try:
            s = self._ctx.settings
            task = Task(self._part.name, tuple(self._part.stages(self._ctx, self.scene)), costs[s.cost])
            planning = SearchState(s, self._ctx.seed, self._cancel)
            self._plan = task.plan(PartialSolution(self.scene), planning, s.solutions)
        except BaseException as error:  # `wait` raises it in the caller's thread
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


def scene_difference(
    expected: PlanningScene, now: PlanningScene, settings: PipelineSettings = PipelineSettings()
) -> str:
    """Describe how a scene differs from the one predicted for a pipelined task. The text is empty if all
    differences are within the tolerances.
    """
    s, model = settings, now.model
    fingers = {name for gripper in model.grippers.values() for name in gripper.joint_names}
    for i, name in enumerate(model.joint_names):
        away = abs(float(now.positions[i] - expected.positions[i]))
        if name not in fingers and away > s.joints:
            return f"{name} is {away:.3f} from its predicted position"
    if missing := set(expected.objects) ^ set(now.objects):
        return f"{', '.join(sorted(missing))} appeared or disappeared"
    if held := set(expected.attached) ^ set(now.attached):
        return f"{', '.join(sorted(held))} should {'' if held & set(expected.attached) else 'not '}be held"
    for name in (*now.objects, *now.attached):
        if now.object(name).shapes is not expected.object(name).shapes:  # for example a camera's octomap
            return f"{name} has another shape"
        away, turn = expected.frame_pose(name).distance_to(now.frame_pose(name))
        if away > s.distance or turn > s.turn:
            degrees = np.rad2deg(turn)
            return f"{name} is {away * 1000:.1f} mm and {degrees:.1f} deg from its predicted position"
    return ""
