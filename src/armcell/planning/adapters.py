"""What is done around a planner, by name: adapters of the request, before anything is planned.

Smoothing, timing and validation come after the planner, in the pipeline, and have names in the same list.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from armcell.collision.kernel.checker import KernelChecker
from armcell.collision.resting import touching
from armcell.core import (
    WORLD,
    ConstraintGoal,
    Constraints,
    ErrorCode,
    InputError,
    Outcome,
    Registry,
    UnknownNameError,
)
from armcell.planning.departure import REPAIR_RADII, departure, leaving
from armcell.planning.question import Question
from armcell.scene import PlanningScene

Array = NDArray[np.float64]

MAX_BOUNDS_ERROR = 0.05  # [rad or m] MoveIt's start_state_max_bounds_error

RequestAdapter = Callable[[Question], "Question | Outcome"]
request_adapters: Registry[RequestAdapter] = Registry("adapter")
FINISHING = ("chomp_smoothing", "timing", "validation")
MOVEIT_NAMES = {
    "CheckStartStateBounds": "fix_start_state_bounds",
    "FixStartStateBounds": "fix_start_state_bounds",
    "FixStartStateCollision": "fix_start_state_collision",
    "ResolveConstraintFrames": "resolve_constraint_frames",
    "OptimizerAdapter": "chomp_smoothing",
    "AddTimeOptimalParameterization": "timing",
    "AddTimeParameterization": "timing",
    "ValidateSolution": "validation",
}


def adapter_names() -> tuple[str, ...]:
    """All adapters, those of the request and the finishing steps."""
    return (*request_adapters, *FINISHING)


def normalized_adapters(names: tuple[str, ...]) -> tuple[str, ...]:
    """Adapters by our names; MoveIt's (`default_planning_request_adapters/...`) are understood.

    Raises:
        UnknownNameError: no such adapter. InputError: validation is left out.
    """
    ours = []
    for given in names:
        name = MOVEIT_NAMES.get(given.split("/")[-1], given)
        if name not in adapter_names():
            raise UnknownNameError("adapter", given, [*adapter_names(), *MOVEIT_NAMES])
        ours.append(name)
    if "validation" not in ours:
        raise InputError(
            "adapter 'validation' is left out, but every motion that is returned is proven",
            cure="name it as well",
        )
    return tuple(ours)


def adapted(question: Question) -> Question | Outcome:
    """The question after the adapters of its request, in their order.

    Raises:
        InputError: an adapter that does not exist, or that cannot do what is asked.
    """
    names = normalized_adapters(question.request.adapters)
    if "chomp_smoothing" in names and question.request.path_constraints:
        raise InputError(
            "adapter 'chomp_smoothing' does not keep path constraints", cure="leave out one of the two"
        )
    question = replace(question, adapters=names)
    for name in names:
        if name in request_adapters:
            answer = request_adapters[name](question)
            if isinstance(answer, Outcome):
                return answer
            question = answer
    for goal in question.request.goals:
        if isinstance(goal, ConstraintGoal):
            _check_frames(question.scene, goal.constraints)
    return question


@request_adapters.register("fix_start_state_bounds")
def fix_start_state_bounds(question: Question) -> Question | Outcome:
    """A start at most `MAX_BOUNDS_ERROR` out of limits is moved in; the motion leads there."""
    model, positions = question.scene.model, question.scene.positions
    if np.all((positions >= model.lower) & (positions <= model.upper)):
        return question
    columns = np.array(model.columns(question.joint_names))
    inside = positions.copy()
    inside[columns] = np.clip(positions[columns], model.lower[columns], model.upper[columns])
    moved = np.abs(inside - positions)
    if not 1e-3 < np.max(moved) <= MAX_BOUNDS_ERROR:  # less is rounding, more is a mistake
        return question
    report = {
        name: (float(positions[k]), float(inside[k])) for k, name in enumerate(model.joint_names) if moved[k]
    }
    return replace(
        question,
        scene=replace(question.scene, positions=inside),
        lead_in=np.vstack([positions[columns], inside[columns]]),
        evidence={**question.evidence, "start_moved_within_limits": report},
    )


@request_adapters.register("fix_start_state_collision")
def fix_start_state_collision(question: Question) -> Question | Outcome:
    """A start in contact, however deep, is replaced by a free state near it.

    The motion begins where the robot is only if the way out is proven: no contact deepens or is dragged along
    and no other pair touches. Else it begins at the free state. `start_repaired` in the evidence says which,
    and how far it is.
    """
    scene = question.scene
    checker = KernelChecker(scene, question.joint_names)
    start = scene.positions[checker.columns]
    if not checker.touches(start):
        return question
    found = departure(checker, start, question.request.seed, np.inf)
    if found is None:
        contacts = touching(checker, start)
        what = "; ".join(c.describe() for c in contacts[:3])
        text = f"start in collision: {what}; no free state within {REPAIR_RADII[-1]:g} rad was found"
        return Outcome(ErrorCode.START_STATE_IN_COLLISION, text, {"contacts": contacts})
    return leaving(question, found, "actual start" if found.proven else "repaired start")


@request_adapters.register("resolve_constraint_frames")
def resolve_constraint_frames(question: Question) -> Question | Outcome:
    """Frames of objects in goals' constraints are replaced: by the world's, or by the carrying link's."""
    if not any(isinstance(goal, ConstraintGoal) for goal in question.request.goals):
        return question
    goals = tuple(
        ConstraintGoal(in_robot_frames(question.scene, goal.constraints))
        if isinstance(goal, ConstraintGoal)
        else goal
        for goal in question.request.goals
    )
    return replace(question, request=replace(question.request, goals=goals))


def in_robot_frames(scene: PlanningScene, constraints: Constraints) -> Constraints:
    """The same constraints with every frame the world or a link; an attached object's becomes its link's."""

    def base(frame: str) -> str:
        if frame in scene.model.links:
            return frame
        body = frame.split("/")[0]
        return scene.attached[body].link if body in scene.attached else WORLD

    def moved(item):
        target = base(item.frame)
        return target, scene.transform(target, item.frame)

    positions = []
    for c in constraints.positions:
        target, T = moved(c)
        positions.append(
            replace(c, frame=target, region=tuple((shape, T @ pose) for shape, pose in c.region))
        )
    orientations = []
    for c in constraints.orientations:
        target, T = moved(c)
        orientations.append(replace(c, frame=target, rotation=T.rotation @ c.rotation))
    return replace(constraints, positions=tuple(positions), orientations=tuple(orientations))


def _check_frames(scene: PlanningScene, constraints: Constraints) -> None:
    for item in (*constraints.positions, *constraints.orientations):
        if item.frame != WORLD and item.frame not in scene.model.links:
            raise InputError(
                f"the frame {item.frame!r} of a constraint is an object's",
                cure="add the adapter resolve_constraint_frames",
            )


__all__ = [
    "adapted",
    "adapter_names",
    "in_robot_frames",
    "normalized_adapters",
    "request_adapters",
]
