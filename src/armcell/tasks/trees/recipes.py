"""Recipes as behavior tree nodes, and `transfer` with its recovery as a behavior tree."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from py_trees.behaviour import Behaviour
from py_trees.composites import Selector
from py_trees.composites import Sequence as InTurn
from py_trees.decorators import Retry, SuccessIsFailure

from armcell.collision import neighbors
from armcell.core import ErrorCode, Goal, Outcome
from armcell.grasping import surface_for
from armcell.model import Gripper
from armcell.tasks.context import TaskContext
from armcell.tasks.pick import back_off, pick
from armcell.tasks.recipes import move_to, place
from armcell.tasks.recovery import Look, RecoverySettings
from armcell.tasks.search import Stage
from armcell.tasks.steps import DONE, perform_all
from armcell.tasks.task import plan_stages
from armcell.tasks.trees.nodes import Act, Check

Vector = tuple[float, float, float]


def picking(ctx: TaskContext, item: str, gripper: Gripper, ahead: Sequence[Stage] = ()) -> Act:
    """Return a behavior tree node that runs the recipe `pick`."""
    return Act(f"pick {item}", ctx, lambda c: pick(c, item, gripper, ahead=ahead))


def placing(
    ctx: TaskContext, item: str, on: str, at: tuple[float, float] | None = None, up: Vector | None = None
) -> Act:
    """Return a behavior tree node that runs the recipe `place`."""
    return Act(f"place {item} on {on}", ctx, lambda c: place(c, item, on, at, up))


def moving_to(ctx: TaskContext, group: str, goal: Goal | str) -> Act:
    """Return a behavior tree node that runs the recipe `move_to`."""
    name = goal if isinstance(goal, str) else type(goal).__name__
    return Act(f"move to {name}", ctx, lambda c: move_to(c, group, goal))


def performing(ctx: TaskContext, name: str, stages: Callable[[TaskContext], Sequence[Stage]]) -> Act:
    """Return a behavior tree node that creates, plans and executes
    the stages of a recipe when the tree reaches it.
    """

    def act(c: TaskContext) -> Outcome:
        solution, outcome = plan_stages(c, stages(c), name)
        return outcome if solution is None else perform_all(c, solution.steps)

    return Act(name, ctx, act)


def looking(name: str, look: Look) -> Check:
    """Return a behavior tree node that takes a camera image to check the scene before the tree continues.

    Example: `looking("look", lambda: cell.look("above"))`.
    """
    return Check(name, look)


def held_node(ctx: TaskContext, item: str) -> Check:
    """Return a behavior tree node that checks whether an object is held. Both the task and the gripper's
    sensors must report the object as held.
    """

    def ask() -> Outcome:
        holding = ctx.holding.get(item)
        if holding is not None and ctx.driver.gripper(holding.gripper.name).held == item:
            return DONE
        return Outcome(ErrorCode.FAILURE, f"no hand holds {item}")

    return Check(f"{item} held?", ask)


def rests_on(
    ctx: TaskContext, item: str, on: str, at: tuple[float, float] | None = None, tolerance: float = 0.015
) -> Check:
    """Return a behavior tree node that checks whether an object rests on another object,
    optionally near a given point [m].
    """

    def ask() -> Outcome:
        scene = ctx.scene()
        if item in ctx.holding or item not in scene.objects:
            return Outcome(ErrorCode.FAILURE, f"{item} is {'held' if item in ctx.holding else 'not seen'}")
        if on not in neighbors(scene, item):
            return Outcome(ErrorCode.FAILURE, f"{item} does not stand on {on}")
        if at is not None:
            frame = surface_for(scene.object(item), scene.object(on))[0]
            where = frame.inverse().apply(scene.object(item).T_world_object.translation)[:2]
            away = float(np.linalg.norm(where - np.asarray(at)))
            if away > tolerance:
                return Outcome(ErrorCode.FAILURE, f"{item} is {away * 1000:.0f} mm from its place on {on}")
        return DONE

    return Check(f"{item} on {on}?", ask)


def transferring(
    ctx: TaskContext, item: str, gripper: Gripper, on: str, at: tuple[float, float] | None = None,
    up: Vector | None = None, look: Look | None = None, settings: RecoverySettings = RecoverySettings(),
) -> Behaviour:  # fmt: skip
    """Return a behavior tree that moves an object to its goal by picking and placing, and recovers from
    failures as `transfer` does.

    The tree makes up to `settings.tries` attempts. Between attempts objects come to rest and the open hand
    retreats.
    """
    fetch: Behaviour = picking(ctx, item, gripper)
    if look is not None:
        fetch = InTurn(f"find and pick {item}", memory=True, children=[looking("look", look), fetch])
    in_hand = Selector(f"get {item}", memory=True, children=[held_node(ctx, item), fetch])
    there = rests_on(ctx, item, on, at, settings.tolerance)
    way = InTurn(
        f"bring {item}", memory=True,
        children=[in_hand, placing(ctx, item, on, at, up), rests_on(ctx, item, on, at, settings.tolerance)],
    )  # fmt: skip

    def rest(c: TaskContext) -> Outcome:
        c.advance(settings.settle)
        if item not in c.holding and item in c.scene().objects:
            back_off(c, item, gripper)
        return DONE

    again = SuccessIsFailure("and again", Act("come to rest", ctx, rest))
    return Retry(
        f"{settings.tries} times", Selector(f"{item} to {on}", memory=True, children=[there, way, again]),
        settings.tries,
    )  # fmt: skip
