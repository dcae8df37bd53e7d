"""Recipes pick, place, move, hold: plan from the measured state, execute, report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from armcell.collision import neighbors
from armcell.core import ErrorCode, Goal, InputError, NamedGoal, Outcome
from armcell.core.checks import require
from armcell.execution import SCENE_INVALIDATED
from armcell.grasping import Placement
from armcell.model import Gripper
from armcell.planning import warm_up
from armcell.scene import PlanningScene
from armcell.tasks.context import TaskContext
from armcell.tasks.costs import costs
from armcell.tasks.interfaces import holding
from armcell.tasks.search import Lookahead, PartialSolution, Planning, Stage
from armcell.tasks.settings import TaskSettings
from armcell.tasks.stages import (
    AppendPlannedMotion,
    ChooseGrasp,
    ChoosePlacement,
    Close,
    Connect,
    ExpectSupport,
    Open,
    RunSteps,
    Straight,
    Upright,
)
from armcell.tasks.stages.grasp import GraspFilter
from armcell.tasks.steps import DONE, EMPTY, CheckGrasp, Dwell, Expect, Grip, perform_all
from armcell.tasks.task import Task, emit_rejections

Vector = tuple[float, float, float]
AHEAD = "what comes next"  # stage of a pick that checks whether later stages are feasible with a grasp
WIDER = 4  # factor on the number of grasps if later stages reject many


def pick(
    ctx: TaskContext, item: str, gripper: Gripper, excluded: tuple[str, ...] = (), ahead: Sequence[Stage] = ()
) -> Outcome:
    """Grasp an object and lift it; if a grasp fails, try the next one.

    Args:
        excluded: names of grasps that must not be used.
        ahead: stages that must be feasible with the object in the hand; other grasps are rejected.
    Returns:
        SUCCESS with the grasp in the evidence ("grasp", and "proof" if `prove_grasps` is set), or the last
        failure with the reasons per candidate ("rejections"). If an obstacle blocks the lift, a grasped
        object stays in the hand.
    Raises:
        InputError: no such object, not movable, or the gripper already holds something.
    """
    _check_free(ctx, item, gripper)
    s, outcome, before = ctx.settings, DONE, ""
    for _ in range(s.attempts):
        stages = pick_stages(ctx.scene(), item, gripper, s, excluded, ahead)
        solution, outcome = planned(ctx, stages, f"pick {item}")
        if solution is None:
            text = f"{outcome.message}; before that: {before}" if before else outcome.message
            return replace(outcome, message=text)
        outcome = perform_all(ctx, solution.steps)
        chosen = {"grasp": solution.data["grasp"], "proof": solution.data["proof"]}
        outcome = replace(outcome, evidence={**outcome.evidence, **chosen})
        if outcome.ok or outcome.code is ErrorCode.PREEMPTED:
            return outcome
        if outcome.code is SCENE_INVALIDATED:  # the scene changed: the grasp is still usable
            if item in ctx.holding:
                return outcome
            ctx.emit("note", f"pick {item}: {outcome.message}")
            if _is_near(ctx, item, gripper):
                back_off(ctx, item, gripper)
            continue
        excluded, before = (*excluded, solution.data["grasp"].name), outcome.message
        held = ctx.holding.pop(item, None)
        ctx.driver.unwatch_object(item)
        ctx.emit("note", f"pick {item}: {outcome.message}; trying the next grasp")
        ctx.driver.command_gripper(gripper.name, gripper.max_width, gripper.max_force)
        ctx.advance(s.release_settle + 0.5)
        if held is not None or (EMPTY in outcome.evidence and _is_near(ctx, item, gripper)):
            back_off(ctx, item, gripper)
    return outcome


def pick_stages(
    scene: PlanningScene, item: str, gripper: Gripper, s: TaskSettings, excluded: tuple[str, ...] = (),
    ahead: Sequence[Stage] = (), among: tuple[str, ...] = (),
) -> list[Stage]:  # fmt: skip
    """Return the stages of `pick` for the predicted scene in which they start.

    Args:
        among: names of the allowed grasps; empty for all.
    """
    supports = tuple(neighbors(scene, item))
    height = float(scene.object(item).T_world_object.translation[2])
    stages: list[Stage] = [
        ChooseGrasp(item, gripper, s.near, s.approach_distance, excluded, WIDER if ahead else 1, among,
                    _grasp_filter(ahead)),
        Connect("move to pre-grasp", gripper.arm_group, s.free, target="pre_grasp"),
        AppendPlannedMotion("approach", "after_approach", "approach"),
        Close(item, gripper, supports, s.grasp_settle),
        Straight("lift", gripper.arm_group, gripper.tcp_link, s.near, (0.0, 0.0, s.lift_distance),
                 allow=((item, supports),)),
        RunSteps("check grasp", (CheckGrasp(item, gripper, height, s.lift_distance),
                           Expect(item, supports, expected=False))),
    ]  # fmt: skip
    if ahead:
        after = partial(_grasped, item, gripper)
        stages.insert(1, Lookahead(AHEAD, tuple(ahead), after, ahead=(holding(item),)))
    return stages


def _grasp_filter(ahead: Sequence[Stage]) -> GraspFilter | None:
    """Return a quick test, without arm, that rejects grasps from which no placement is possible."""
    for stage in ahead:
        if isinstance(stage, ChoosePlacement):
            return lambda scene: stage.why_not(scene, Lookahead.candidates)
    return None


def _grasped(item: str, gripper: Gripper, solution: PartialSolution) -> PartialSolution:
    """Return a solution with the object attached to the hand, as after closing the chosen grasp."""
    scene = solution.data["after_approach"].with_attached(item, gripper.tcp_link, gripper.hand_links)
    return solution.then(scene=scene)


def grasp(ctx: TaskContext, item: str, gripper: Gripper) -> Outcome:
    """Grasp an object without lifting it; contact with its support stays allowed.

    Raises:
        InputError: no such object, not movable, or the gripper already holds something.
    """
    _check_free(ctx, item, gripper)
    s, scene = ctx.settings, ctx.scene()
    supports = tuple(neighbors(scene, item))
    stages: list[Stage] = [
        ChooseGrasp(item, gripper, s.near, s.approach_distance),
        Connect("move to pre-grasp", gripper.arm_group, s.free, target="pre_grasp"),
        AppendPlannedMotion("approach", "after_approach", "approach"),
        Close(item, gripper, supports, s.grasp_settle),
    ]
    solution, outcome = planned(ctx, stages, f"grasp {item}")
    if solution is None:
        return outcome
    outcome = perform_all(ctx, solution.steps)
    if outcome.ok and supports:
        ctx.change_scene(lambda scene: scene.with_allowed(item, supports))
    return outcome


def let_go(ctx: TaskContext, item: str) -> Outcome:
    """Open the hand that holds an object and retreat straight back.

    Raises:
        InputError: the object is not held.
    """
    if item not in ctx.holding:
        raise InputError(f"the robot does not hold {item!r}")
    s, gripper = ctx.settings, ctx.holding[item].gripper
    stages: list[Stage] = [
        Open(item, "", gripper, s.release_margin, s.release_settle),
        _retreat(item, gripper, s, s.retreat_distance),
    ]
    solution, outcome = planned(ctx, stages, f"let go of {item}")
    if solution is None:
        return outcome
    return perform_all(ctx, (*solution.steps, Expect(item, gripper.finger_links, expected=False)))


def _check_free(ctx: TaskContext, item: str, gripper: Gripper) -> None:
    for held in ctx.holding.values():
        if held.gripper.name == gripper.name:
            raise InputError(f"gripper {gripper.name!r} already holds {held.object}", cure="place it first")
    if not ctx.scene().object(item).movable:
        raise InputError(f"object {item!r} is fixed", cure="give it 'movable: true'")


def place(
    ctx: TaskContext,
    item: str,
    on: str,
    at: tuple[float, float] | None = None,
    up: Vector | None = None,
    lean: float | None = None,
) -> Outcome:
    """Place a held object on a support; the target pose is in the evidence ("placement").

    If the placement fails while the object is still held, it is planned again from the arm's position.

    Args:
        on: name of the support.
        at: point on the support's surface [m] from its center.
        up: direction in the object's frame that must point up; default: the present orientation.
        lean: maximum tilt of the object during the motion [rad], e.g. for a full cup; None for no limit.
    Raises:
        InputError: the object is not held, it does not fit on the support, or it is the support itself.
    """
    if item not in ctx.holding:
        raise InputError(f"the robot does not hold {item!r}", cure="pick it first")
    require(item != on, f"{item!r} cannot be put on itself")
    ctx.scene().object(on)  # raises an error with the existing names
    s, gripper, outcome = ctx.settings, ctx.holding[item].gripper, DONE
    for _ in range(s.attempts):
        stages = place_stages(item, on, gripper, s, at, up, lean)
        solution, outcome = planned(ctx, stages, f"place {item} on {on}")
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
    """Return the stages of `place`.

    Args:
        among: the allowed placements; empty for all.
    """
    upright = None if lean is None else Upright(item, lean)
    return [
        ChoosePlacement(item, on, gripper, s.near, s.lower_distance, at, up, among),
        Connect("move to pre-place", gripper.arm_group, s.carry, target="pre_place", upright=upright),
        ExpectSupport(item, on, gripper),
        AppendPlannedMotion("lower", "after_lower", "lower"),
        Open(item, on, gripper, s.release_margin, s.release_settle),
        _retreat(item, gripper, s, s.retreat_distance),
        RunSteps("let go", (Expect(item, gripper.finger_links, expected=False),)),
    ]


def _retreat(item: str, gripper: Gripper, s: TaskSettings, distance: float) -> Straight:
    """Return a straight retreat [m] against the hand's approach direction.

    Contact of the hand with the object is allowed during the retreat.
    """
    return Straight(
        "retreat", gripper.arm_group, gripper.tcp_link, s.near, (0.0, 0.0, -distance),
        in_tip_frame=True, allow=((item, gripper.hand_links),),
    )  # fmt: skip


def move_to(ctx: TaskContext, group: str, goal: Goal | str, name: str = "") -> Outcome:
    """Move a planning group to a goal or to a named state."""
    goal = NamedGoal(goal) if isinstance(goal, str) else goal
    label = name or (f"move to {goal.name}" if isinstance(goal, NamedGoal) else "move")
    speed = ctx.settings.carry if ctx.holding else ctx.settings.free
    solution, outcome = planned(ctx, [Connect(label, group, speed, goal=goal)], label)
    return outcome if solution is None else perform_all(ctx, solution.steps)


def hold(ctx: TaskContext, duration: float) -> Outcome:
    """Keep still for a duration [s]; the stage table reports the slip of a held object.

    Raises:
        InputError: the duration is negative or not finite.
    """
    require(np.isfinite(duration) and duration >= 0, f"cannot hold for {duration} s")
    return Dwell("hold", duration).perform(ctx)


def release(ctx: TaskContext, gripper: Gripper) -> Outcome:
    """Open a gripper fully at its present pose and detach the object it held."""
    for held in [h for h in ctx.holding.values() if h.gripper.name == gripper.name]:
        ctx.holding.pop(held.object)
        ctx.driver.unwatch_object(held.object)
    return Grip("open", gripper, gripper.max_width, gripper.max_force, ctx.settings.release_settle).perform(
        ctx
    )


def _is_near(ctx: TaskContext, item: str, gripper: Gripper) -> bool:
    """Return True if the hand may be around the object."""
    scene = ctx.scene()
    tcp, T = scene.frame_pose(gripper.tcp_link), scene.object(item).T_world_object
    return bool(np.linalg.norm(tcp.translation - T.translation) <= ctx.settings.approach_distance)


def back_off(ctx: TaskContext, item: str, gripper: Gripper) -> None:
    """Retreat straight from an object that the open hand surrounds.

    Planners find no path from this start. The retreat goes as far as possible; the next plan starts there.
    """
    s = ctx.settings
    back = _retreat(item, gripper, s, s.approach_distance)
    for solution in back.propose(PartialSolution(ctx.scene()), Planning(s, ctx.seed, ctx.cancel)):
        perform_all(ctx, solution.steps)


def planned(ctx: TaskContext, stages: Sequence[Stage], what: str) -> tuple[PartialSolution | None, Outcome]:
    """Plan stages from the measured state.

    Returns:
        The cheapest solution and a success, or None and the reason.
    Raises:
        TaskError: the stages do not fit together.
    """
    warm_up()  # compile before the planning time starts
    s = ctx.settings
    task = Task(what, tuple(stages), costs[s.cost])
    plan = task.plan(PartialSolution(ctx.scene()), Planning(s, ctx.seed, ctx.cancel), s.solutions)
    if plan.best is not None:
        emit_rejections(ctx, plan, what)
        return plan.best, DONE
    if plan.code is not ErrorCode.PREEMPTED:
        ctx.emit("error", plan.message, code=plan.code.name, **plan.evidence)
    return None, Outcome(plan.code, plan.message, plan.evidence)
