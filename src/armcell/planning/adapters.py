"""Request adapters: named steps that change a planning request before the planner runs.

Smoothing, timing and validation run after the planner, in the pipeline; their names share the same list.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from armcell.collision.kernel.checker import KernelChecker
from armcell.collision.resting_contact import resting_contacts
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
from armcell.planning.request import ValidatedRequest
from armcell.planning.start_in_contact import REPAIR_RADII, find_departure, start_from_departure
from armcell.scene import PlanningScene

Array = NDArray[np.float64]

MAX_BOUNDS_ERROR = 0.05  # [rad or m] MoveIt's start_state_max_bounds_error

RequestAdapter = Callable[[ValidatedRequest], "ValidatedRequest | Outcome"]
request_adapters: Registry[RequestAdapter] = Registry("adapter", "armcell.adapters")
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
    """List the names of all planning adapters: first the adapters that change a request, then the steps that
    run after the planner.
    """
    return (*request_adapters, *FINISHING)


def normalize_adapter_names(names: tuple[str, ...]) -> tuple[str, ...]:
    """Convert names of planning request adapters, which may be MoveIt's names, to armcell's names.

    MoveIt's names may have the prefix `default_planning_request_adapters/`.

    Raises:
        UnknownNameError: an adapter does not exist. InputError: the list lacks 'validation'.
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
            hint="name it as well",
        )
    return tuple(ours)


def apply_request_adapters(validated: ValidatedRequest) -> ValidatedRequest | Outcome:
    """Apply the adapters that a planning request names, one after the other.

    Return the changed request, or the reason why an adapter refuses it.

    Raises:
        InputError: an adapter does not exist or cannot handle the request.
    """
    names = normalize_adapter_names(validated.request.adapters)
    if "chomp_smoothing" in names and validated.request.path_constraints:
        raise InputError(
            "adapter 'chomp_smoothing' does not keep path constraints", hint="leave out one of the two"
        )
    validated = replace(validated, adapters=names)
    for name in names:
        if name in request_adapters:
            answer = request_adapters[name](validated)
            if isinstance(answer, Outcome):
                return answer
            validated = answer
    for goal in validated.request.goals:
        if isinstance(goal, ConstraintGoal):
            _check_frames(validated.scene, goal.constraints)
    return validated


@request_adapters.register("fix_start_state_bounds")
def fix_start_state_bounds(validated: ValidatedRequest) -> ValidatedRequest | Outcome:
    """Request adapter that moves a start state slightly outside the joint limits back to these limits.

    The start may be outside by at most `MAX_BOUNDS_ERROR`. The planned motion begins with a lead-in from the
    robot's actual state to the moved start.
    """
    model, positions = validated.scene.model, validated.scene.positions
    if np.all((positions >= model.lower) & (positions <= model.upper)):
        return validated
    columns = np.array(model.columns(validated.joint_names))
    inside = positions.copy()
    inside[columns] = np.clip(positions[columns], model.lower[columns], model.upper[columns])
    moved = np.abs(inside - positions)
    if not 1e-3 < np.max(moved) <= MAX_BOUNDS_ERROR:  # less: rounding; more: a mistake
        return validated
    report = {
        name: (float(positions[k]), float(inside[k])) for k, name in enumerate(model.joint_names) if moved[k]
    }
    return replace(
        validated,
        scene=replace(validated.scene, positions=inside),
        lead_in=np.vstack([positions[columns], inside[columns]]),
        evidence={**validated.evidence, "start_moved_within_limits": report},
    )


@request_adapters.register("fix_start_state_collision")
def fix_start_state_collision(validated: ValidatedRequest) -> ValidatedRequest | Outcome:
    """Request adapter that replaces a start state in collision with a collision-free state nearby,
    however deep the collision is.

    The motion begins at the robot's actual state only if the way out is proven: no contact deepens or drags
    along, and no other pair touches. Otherwise the motion begins at the free state. `start_repaired` in the
    evidence reports which of the two it is, and the distance between the states.
    """
    scene = validated.scene
    checker = KernelChecker(scene, validated.joint_names)
    start = scene.positions[checker.columns]
    if not checker.touches(start):
        return validated
    found = find_departure(checker, start, validated.request.seed, np.inf)
    if found is None:
        contacts = resting_contacts(checker, start)
        what = "; ".join(c.describe() for c in contacts[:3])
        text = f"start in collision: {what}; no free state within {REPAIR_RADII[-1]:g} rad was found"
        return Outcome(ErrorCode.START_STATE_IN_COLLISION, text, {"contacts": contacts})
    return start_from_departure(validated, found, "actual start" if found.proven else "repaired start")


@request_adapters.register("resolve_constraint_frames")
def resolve_constraint_frames(validated: ValidatedRequest) -> ValidatedRequest | Outcome:
    """Request adapter that converts goal constraints from the frames of objects to the world frame, or to the
    frame of the link that carries the object.
    """
    if not any(isinstance(goal, ConstraintGoal) for goal in validated.request.goals):
        return validated
    goals = tuple(
        ConstraintGoal(in_robot_frames(validated.scene, goal.constraints))
        if isinstance(goal, ConstraintGoal)
        else goal
        for goal in validated.request.goals
    )
    return replace(validated, request=replace(validated.request, goals=goals))


def in_robot_frames(scene: PlanningScene, constraints: Constraints) -> Constraints:
    """Return a request's constraints after converting every constraint frame to the world frame or a link's
    frame. A request adapter calls it before planning.

    The frame of an attached object becomes the frame of the link that carries the object.
    """

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
                hint="add the adapter resolve_constraint_frames",
            )
