"""Synchronized motions of several arms: one goal per arm, or one trajectory of all arms."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

from armcell.core import Goal, JointTrajectory, Outcome, PlanRequest
from armcell.execution import execute_coupled
from armcell.planning import plan_synchronized
from armcell.scene import PlanningScene
from armcell.tasks.context import StageReport, TaskContext
from armcell.tasks.stages.moves import goal_data
from armcell.tasks.steps import staged


def move_together(
    ctx: TaskContext, combined: str, goals: Mapping[str, Goal], name: str = "move together"
) -> Outcome:
    """Move coupled arms to one goal each, so that all start and arrive at the same time."""
    s, scene = ctx.settings, ctx.scene()
    template = PlanRequest(
        next(iter(goals)), (), planner_id=s.planner_id, planning_time=s.planning_time,
        velocity_scaling=s.free.velocity, acceleration_scaling=s.free.acceleration, seed=ctx.seed,
    )  # fmt: skip
    planned = plan_synchronized(scene, goals, combined, template=template)
    if not planned.ok or planned.trajectory is None:
        ctx.emit("error", f"{name}: {planned.message}")
        return Outcome(planned.code, f"{name}: {planned.message}", planned.evidence)
    report = StageReport(name, planned.how, planned.planning_time)
    evidence = {"goals": {group: goal_data(goal) for group, goal in goals.items()}, "seed": ctx.seed,
            "between_arms_m": planned.clearance, "message": planned.message, **planned.evidence}  # fmt: skip
    trajectory = planned.trajectory.reindexed(scene.model.group(combined).joint_names)
    return play(ctx, trajectory, report, evidence=evidence, planned_in=scene)


def play(
    ctx: TaskContext, trajectory: JointTrajectory, report: StageReport,
    correct: Callable | None = None, watch: Callable | None = None,
    evidence: Mapping[str, Any] = MappingProxyType({}), scene: Callable[[], PlanningScene] | None = None,
    planned_in: PlanningScene | None = None,
) -> Outcome:  # fmt: skip
    """Execute a trajectory of coupled arms as one stage of a task.

    Args:
        evidence: planning metadata for the record.
        scene: returns the measured scene with this motion's contacts and carried object; default: the cell's.
        planned_in: scene in which the trajectory was planned; the gate's proof reuses its cached arrays.
    """

    def act() -> Outcome:
        ctx.announce(
            trajectory, report.name, planner=report.planner, planning_time_s=report.planning_time_s,
            clearance_m=report.clearance_m, evidence=dict(evidence),
        )  # fmt: skip
        motion = ctx.gate.motion(trajectory, planned_in, ctx.cancel, scene)
        return execute_coupled(
            ctx.driver, motion, correct, watch, settings=ctx.settings.execution,
            progress=ctx.progress,
        )  # fmt: skip

    return staged(ctx, report, act)
