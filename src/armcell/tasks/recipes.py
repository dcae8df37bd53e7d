"""Recipes to place, let go, move, hold and release.

Each recipe plans from the measured state, executes the plan and reports the outcome.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from armcell.core import SE3, ErrorCode, Goal, InputError, NamedGoal, Outcome
from armcell.core.checks import require
from armcell.grasping import Placement
from armcell.model import Gripper
from armcell.tasks.context import TaskContext
from armcell.tasks.pick import retreat
from armcell.tasks.search import Stage
from armcell.tasks.settings import TaskSettings
from armcell.tasks.stages import (
    AppendPlannedMotion,
    ChoosePlacement,
    Connect,
    ExpectSupport,
    OpenHand,
    RunSteps,
    UprightConstraint,
)
from armcell.tasks.steps import DONE, CommandGripper, Dwell, ExpectContact, perform_all
from armcell.tasks.task import plan_stages

Vector = tuple[float, float, float]


def release_and_retreat(ctx: TaskContext, item: str) -> Outcome:
    """Recipe that lets go of a held object: it opens the hand and retreats straight back.

    Raises:
        InputError: the object is not held.
    """
    if item not in ctx.holding:
        raise InputError(f"the robot does not hold {item!r}")
    s, gripper = ctx.settings, ctx.holding[item].gripper
    stages: list[Stage] = [
        OpenHand(item, "", gripper, s.release_margin, s.release_settle),
        retreat(item, gripper, s, s.retreat_distance),
    ]
    solution, outcome = plan_stages(ctx, stages, f"let go of {item}")
    if solution is None:
        return outcome
    return perform_all(ctx, (*solution.steps, ExpectContact(item, gripper.contact_links, expected=False)))


def place(
    ctx: TaskContext,
    item: str,
    on: str,
    at: tuple[float, float] | None = None,
    up: Vector | None = None,
    lean: float | None = None,
    pose: SE3 | None = None,
) -> Outcome:
    """Recipe that places a held object on a support.
    The outcome's evidence contains the target pose ("placement").

    If the placement fails while the object is still held, it is planned again from the arm's position.

    Args:
        on: name of the support.
        at: point on the support's surface [m] from its center.
        up: direction in the object's frame that must point up; default: the present orientation.
        lean: maximum tilt of the object during the motion [rad], e.g. for a full cup; None for no limit.
        pose: T_world_object at which the object rests on the support, such as the pose before it was picked;
            default: chosen by `at` and `up`.
    Raises:
        InputError: the object is not held, it does not fit on the support, it is the support itself, or
            `pose` is given together with `at` or `up`.
    """
    if item not in ctx.holding:
        raise InputError(f"the robot does not hold {item!r}", hint="pick it first")
    require(item != on, f"{item!r} cannot be put on itself")
    ctx.scene().object(on)  # raises an error with the existing names
    require(pose is None or (at is None and up is None), "give either a pose, or `at` and `up`")
    among = () if pose is None else (Placement("at the given pose", pose),)
    s, gripper, outcome = ctx.settings, ctx.holding[item].gripper, DONE
    for _ in range(s.attempts):
        stages = place_stages(item, on, gripper, s, at, up, lean, among)
        solution, outcome = plan_stages(ctx, stages, f"place {item} on {on}")
        if solution is None:
            return outcome
        outcome = perform_all(ctx, solution.steps)
        outcome = replace(outcome, evidence={**outcome.evidence, "placement": solution.data["placement"]})
        if outcome.ok or outcome.code is ErrorCode.PREEMPTED or item not in ctx.holding:
            return outcome
        ctx.emit("note", f"place {item}: {outcome.message}; planning again from here")
    return outcome


def place_stages(
    item: str, on: str, gripper: Gripper, s: TaskSettings, at: tuple[float, float] | None = None,
    up: Vector | None = None, lean: float | None = None, among: tuple[Placement, ...] = (),
) -> list[Stage]:  # fmt: skip
    """Return the stages of which the recipe `place` consists.

    Args:
        among: the allowed placements; empty for all.
    """
    upright = None if lean is None else UprightConstraint(item, lean)
    return [
        ChoosePlacement(item, on, gripper, s.near, s.lower_distance, at, up, among),
        Connect("move to pre-place", gripper.arm_group, s.carry, target="pre_place", upright=upright),
        ExpectSupport(item, on, gripper),
        AppendPlannedMotion("lower", "after_lower", "lower"),
        OpenHand(item, on, gripper, s.release_margin, s.release_settle),
        retreat(item, gripper, s, s.retreat_distance),
        RunSteps("let go", (ExpectContact(item, gripper.contact_links, expected=False),)),
    ]


def move_to(ctx: TaskContext, group: str, goal: Goal | str, name: str = "") -> Outcome:
    """Recipe that moves a planning group to a goal or to a named state."""
    goal = NamedGoal(goal) if isinstance(goal, str) else goal
    label = name or (f"move to {goal.name}" if isinstance(goal, NamedGoal) else "move")
    speed = ctx.settings.carry if ctx.holding else ctx.settings.free
    return perform_stages(ctx, [Connect(label, group, speed, goal=goal)], label)


def perform_stages(ctx: TaskContext, stages: Sequence[Stage], name: str) -> Outcome:
    """Plan the stages of a recipe from the measured state, and execute the cheapest solution.

    Raises:
        TaskError: the stages do not fit together.
    """
    solution, outcome = plan_stages(ctx, stages, name)
    return outcome if solution is None else perform_all(ctx, solution.steps)


def hold(ctx: TaskContext, duration: float) -> Outcome:
    """Recipe that keeps the arm still for a duration [s].
    The stage table reports how far a held object slips.

    Raises:
        InputError: the duration is negative or not finite.
    """
    require(np.isfinite(duration) and duration >= 0, f"cannot hold for {duration} s")
    return Dwell("hold", duration).perform(ctx)


def release(ctx: TaskContext, gripper: Gripper) -> Outcome:
    """Recipe that opens a gripper fully at its present pose and detaches the held object."""
    for held in [h for h in ctx.holding.values() if h.gripper.name == gripper.name]:
        ctx.holding.pop(held.object)
        ctx.driver.unwatch_object(held.object)
    return CommandGripper(
        "open", gripper, gripper.max_width, gripper.max_force, ctx.settings.release_settle
    ).perform(ctx)
