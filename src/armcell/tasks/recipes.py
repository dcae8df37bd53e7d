"""Recipes: pick, place, move, hold. Each plans from the measured state, performs, and reports."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from armcell.collision import neighbours
from armcell.control import CHANGED
from armcell.core import ErrorCode, Goal, InputError, NamedGoal, Outcome
from armcell.core.checks import require
from armcell.grasping import Placement
from armcell.model import Gripper
from armcell.planning import warm_up
from armcell.scene import PlanningScene
from armcell.tasks.context import TaskContext
from armcell.tasks.costs import costs
from armcell.tasks.interfaces import holding
from armcell.tasks.search import Draft, Foresee, Planning, Stage
from armcell.tasks.settings import TaskSettings
from armcell.tasks.stages import (
    ChooseGrasp,
    ChoosePlacement,
    Close,
    Connect,
    Do,
    ExpectSupport,
    Open,
    Planned,
    Straight,
    Upright,
)
from armcell.tasks.stages.grasp import Sieve
from armcell.tasks.steps import DONE, EMPTY, CheckGrasp, Dwell, Expect, Grip, perform_all
from armcell.tasks.task import Task, tell_rejected

Vector = tuple[float, float, float]
AHEAD = "what comes next"  # the stage of a pick that looks whether a grasp leads on
WIDER = 4  # times as many grasps are looked at where what comes next allows few


def pick(
    ctx: TaskContext, item: str, gripper: Gripper, excluded: tuple[str, ...] = (), ahead: Sequence[Stage] = ()
) -> Outcome:
    """Grasp an object and lift it; the next grasp is tried when one fails.

    Args:
        excluded: names of grasps that are not to be used.
        ahead: stages that must have a way with the object in the hand; a grasp without one is not used.
    Returns:
        SUCCESS with the grasp in the evidence ("grasp", and "proof" where `prove_grasps` is set), or the last
        failure with the reasons per candidate ("rejections"). What is held already when something comes
        across the lift stays in the hand.
    Raises:
        InputError: no such object, not movable, or the gripper already holds something.
    """
    _check_free(ctx, item, gripper)
    s, outcome, before = ctx.settings, DONE, ""
    for _ in range(s.attempts):
        stages = pick_stages(ctx.scene(), item, gripper, s, excluded, ahead)
        draft, outcome = planned(ctx, stages, f"pick {item}")
        if draft is None:
            text = f"{outcome.message}; before that: {before}" if before else outcome.message
            return replace(outcome, message=text)
        outcome = perform_all(ctx, draft.steps)
        chosen = {"grasp": draft.data["grasp"], "proof": draft.data["proof"]}
        outcome = replace(outcome, evidence={**outcome.evidence, **chosen})
        if outcome.ok or outcome.code is ErrorCode.PREEMPTED:
            return outcome
        if outcome.code is CHANGED:  # the grasp is as good as it was
            if item in ctx.holding:
                return outcome
            ctx.emit("note", f"pick {item}: {outcome.message}")
            if _is_near(ctx, item, gripper):
                back_off(ctx, item, gripper)
            continue
        excluded, before = (*excluded, draft.data["grasp"].name), outcome.message
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
    """The stages of `pick`, from a scene as it will be when they begin.

    Args:
        among: names of the only grasps to be used; all where empty.
    """
    supports = tuple(neighbours(scene, item))
    height = float(scene.object(item).T_world_object.translation[2])
    stages: list[Stage] = [
        ChooseGrasp(item, gripper, s.near, s.approach_distance, excluded, WIDER if ahead else 1, among,
                    _sieve(ahead)),
        Connect("move to pre-grasp", gripper.arm_group, s.free, target="pre_grasp"),
        Planned("approach", "after_approach", "approach"),
        Close(item, gripper, supports, s.grasp_settle),
        Straight("lift", gripper.arm_group, gripper.tcp_link, s.near, (0.0, 0.0, s.lift_distance),
                 allow=((item, supports),)),
        Do("check grasp", (CheckGrasp(item, gripper, height, s.lift_distance),
                           Expect(item, supports, expected=False))),
    ]  # fmt: skip
    if ahead:
        after = partial(_grasped, item, gripper)
        stages.insert(1, Foresee(AHEAD, tuple(ahead), after, ahead=(holding(item),)))
    return stages


def _sieve(ahead: Sequence[Stage]) -> Sieve | None:
    """What tells a place without any arm that a grasp is of no use for it."""
    for stage in ahead:
        if isinstance(stage, ChoosePlacement):
            return lambda scene: stage.why_not(scene, Foresee.candidates)
    return None


def _grasped(item: str, gripper: Gripper, draft: Draft) -> Draft:
    """A draft as it will be when the chosen grasp is closed."""
    scene = draft.data["after_approach"].with_attached(item, gripper.tcp_link, gripper.hand_links)
    return draft.then(scene=scene)


def grasp(ctx: TaskContext, item: str, gripper: Gripper) -> Outcome:
    """Take hold of an object where it is, without lifting it; it may go on touching what it stands on.

    Raises:
        InputError: no such object, not movable, or the gripper already holds something.
    """
    _check_free(ctx, item, gripper)
    s, scene = ctx.settings, ctx.scene()
    supports = tuple(neighbours(scene, item))
    stages: list[Stage] = [
        ChooseGrasp(item, gripper, s.near, s.approach_distance),
        Connect("move to pre-grasp", gripper.arm_group, s.free, target="pre_grasp"),
        Planned("approach", "after_approach", "approach"),
        Close(item, gripper, supports, s.grasp_settle),
    ]
    draft, outcome = planned(ctx, stages, f"grasp {item}")
    if draft is None:
        return outcome
    outcome = perform_all(ctx, draft.steps)
    if outcome.ok and supports:
        ctx.change_scene(lambda scene: scene.with_allowed(item, supports))
    return outcome


def let_go(ctx: TaskContext, item: str) -> Outcome:
    """Open the hand that holds an object and draw it straight back.

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
    draft, outcome = planned(ctx, stages, f"let go of {item}")
    if draft is None:
        return outcome
    return perform_all(ctx, (*draft.steps, Expect(item, gripper.finger_links, expected=False)))


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
    """Put a held object down on another object; the outcome's evidence has the target pose ("placement").

    A place that fails on the way is planned again from where the arm is, as long as the object is still held.

    Args:
        up: direction in the object's frame that shall be up; without it, it stands as it does now.
        lean: how far it may lean on the way [rad], as a full cup; as the way has it where None.
    Raises:
        InputError: the object is not held, it does not fit on the support, or it is its own.
    """
    if item not in ctx.holding:
        raise InputError(f"the robot does not hold {item!r}", cure="pick it first")
    require(item != on, f"{item!r} cannot be put on itself")
    ctx.scene().object(on)  # a name that does not exist is said alone, with those that do
    s, gripper, outcome = ctx.settings, ctx.holding[item].gripper, DONE
    for _ in range(s.attempts):
        stages = place_stages(item, on, gripper, s, at, up, lean)
        draft, outcome = planned(ctx, stages, f"place {item} on {on}")
        if draft is None:
            return outcome
        outcome = perform_all(ctx, draft.steps)
        outcome = replace(outcome, evidence={**outcome.evidence, "placement": draft.data["placement"]})
        if outcome.ok or outcome.code is ErrorCode.PREEMPTED or item not in ctx.holding:
            return outcome
        ctx.emit("note", f"place {item}: {outcome.message}; planning again from here")
    return outcome


def place_stages(
    item: str, on: str, gripper: Gripper, s: TaskSettings, at: tuple[float, float] | None = None,
    up: Vector | None = None, lean: float | None = None, among: tuple[Placement, ...] = (),
) -> list[Stage]:  # fmt: skip
    """The stages of `place`.

    Args:
        among: the only placements to be used; all that there are where empty.
    """
    upright = None if lean is None else Upright(item, lean)
    return [
        ChoosePlacement(item, on, gripper, s.near, s.lower_distance, at, up, among),
        Connect("move to pre-place", gripper.arm_group, s.carry, target="pre_place", upright=upright),
        ExpectSupport(item, on, gripper),
        Planned("lower", "after_lower", "lower"),
        Open(item, on, gripper, s.release_margin, s.release_settle),
        _retreat(item, gripper, s, s.retreat_distance),
        Do("let go", (Expect(item, gripper.finger_links, expected=False),)),
    ]


def _retreat(item: str, gripper: Gripper, s: TaskSettings, distance: float) -> Straight:
    """Straight back [m] out of the hand's own direction, off an object it may touch meanwhile."""
    return Straight(
        "retreat", gripper.arm_group, gripper.tcp_link, s.near, (0.0, 0.0, -distance),
        in_tip_frame=True, allow=((item, gripper.hand_links),),
    )  # fmt: skip


def move_to(ctx: TaskContext, group: str, goal: Goal | str, name: str = "") -> Outcome:
    """Move a group to a goal, or to a named state given by its name."""
    goal = NamedGoal(goal) if isinstance(goal, str) else goal
    label = name or (f"move to {goal.name}" if isinstance(goal, NamedGoal) else "move")
    speed = ctx.settings.carry if ctx.holding else ctx.settings.free
    draft, outcome = planned(ctx, [Connect(label, group, speed, goal=goal)], label)
    return outcome if draft is None else perform_all(ctx, draft.steps)


def hold(ctx: TaskContext, duration: float) -> Outcome:
    """Stand still [s]; the stage table shows how far a held object slipped.

    Raises:
        InputError: a duration that is negative or not finite.
    """
    require(np.isfinite(duration) and duration >= 0, f"cannot hold for {duration} s")
    return Dwell("hold", duration).perform(ctx)


def release(ctx: TaskContext, gripper: Gripper) -> Outcome:
    """Open a gripper fully, wherever it is; what it held belongs to the world again."""
    for held in [h for h in ctx.holding.values() if h.gripper.name == gripper.name]:
        ctx.holding.pop(held.object)
        ctx.driver.unwatch_object(held.object)
    return Grip("open", gripper, gripper.max_width, gripper.max_force, ctx.settings.release_settle).perform(
        ctx
    )


def _is_near(ctx: TaskContext, item: str, gripper: Gripper) -> bool:
    """Whether the hand may be around an object."""
    scene = ctx.scene()
    tcp, T = scene.frame_pose(gripper.tcp_link), scene.object(item).T_world_object
    return bool(np.linalg.norm(tcp.translation - T.translation) <= ctx.settings.approach_distance)


def back_off(ctx: TaskContext, item: str, gripper: Gripper) -> None:
    """Straight back from an object the open hand stands around, which no planner finds its way out of.

    As far as it goes: the next plan begins wherever the arm is then.
    """
    s = ctx.settings
    back = _retreat(item, gripper, s, s.approach_distance)
    for draft in back.drafts(Draft(ctx.scene()), Planning(s, ctx.seed, ctx.cancel)):
        perform_all(ctx, draft.steps)


def planned(ctx: TaskContext, stages: Sequence[Stage], what: str) -> tuple[Draft | None, Outcome]:
    """Stages planned from the measured state: the cheapest draft found, or None and why there is none.

    Raises:
        TaskError: the stages do not fit together.
    """
    warm_up()  # not on the time of a plan
    s = ctx.settings
    task = Task(what, tuple(stages), costs[s.cost])
    plan = task.plan(Draft(ctx.scene()), Planning(s, ctx.seed, ctx.cancel), s.solutions)
    if plan.best is not None:
        tell_rejected(ctx, plan, what)
        return plan.best, DONE
    if plan.code is not ErrorCode.PREEMPTED:
        ctx.emit("error", plan.message, code=plan.code.name, **plan.evidence)
    return None, Outcome(plan.code, plan.message, plan.evidence)
