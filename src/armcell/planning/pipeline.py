"""The planning pipeline: validate a request, find a path, simplify, certify and time it."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from armcell.collision.inter_arm_checker import arms_of
from armcell.collision.kernel.checker import KernelChecker
from armcell.core import (
    ConstraintGoal,
    ErrorCode,
    InputError,
    JointPath,
    Outcome,
    PlanRequest,
    PlanResult,
    PoseGoal,
)
from armcell.planning.adapters import apply_request_adapters
from armcell.planning.arm_clearance import ArmClearance, achievable_arm_clearance
from armcell.planning.certify import PlannedMotion, certify_request_motion, clearance_along
from armcell.planning.constraints.plan import check_planner, plan_constrained
from armcell.planning.diagnosis import with_explanation
from armcell.planning.first_compile import warm_up, warm_up_ik
from armcell.planning.goals.joint_goals import find_joint_goals, stream_goals
from armcell.planning.moved_frame import MovedFrame
from armcell.planning.pilz.generators import plan_pilz, validate_pilz_request
from armcell.planning.planners.chomp import smooth_with_chomp
from armcell.planning.planners.problem import PlannerResult, Problem, sampling_bounds
from armcell.planning.planners.registry import PILZ, pipeline_for
from armcell.planning.planners.rrt_connect import simplify
from armcell.planning.planners.trajectory_optimization import path_validity
from armcell.planning.request import ValidatedRequest, validate_request
from armcell.planning.start_in_contact import leave_start_contact
from armcell.scene import PlanningScene

Array = NDArray[np.float64]

MAX_ROUNDS = 5
"""Maximum number of planning rounds, each with another seed, if paths fail certification."""
PADDED_ROUNDS = 3
"""Rounds in search of a motion with full padding, if a motion without contact exists already."""

ROUND_SEED, ATTEMPT_SEED = 7919, 104_729  # primes, so that rounds and attempts never share a seed


@with_explanation(PlanRequest)
def plan(scene: PlanningScene, request: PlanRequest, cancel: threading.Event | None = None) -> PlanResult:
    """Plan a certified motion with timing for one planning group, using the whole planning pipeline.

    Args:
        scene: the world; its state is the start unless the request names one.
        cancel: set this event from another thread to stop.
    Returns:
        SUCCESS with path and trajectory, or the code, message and evidence (contacts, joints, distances).
    Raises:
        InputError: misuse: unknown group, planner, link, joint, parameter or adapter; scaling outside (0,
            1].
    """
    warm_up()
    if (
        pipeline_for(request.pipeline_id, request.planner_id) == PILZ
    ):  # also if only a planner such as LIN is named
        request = replace(request, pipeline_id=PILZ)
    if request.group in scene.model.groups:
        for link in _links(request):
            warm_up_ik(scene.model, request.group, MovedFrame(scene, request.group, link).link)
    asked = validate_request(scene, request, cancel)
    is_pilz = request.pipeline_id == PILZ
    if is_pilz:
        validate_pilz_request(asked)
    elif request.path_constraints:
        check_planner(asked)
    validated = apply_request_adapters(asked)
    if isinstance(validated, Outcome):
        return asked.failed(validated)
    endpoints = find_start_and_goals(validated)
    if isinstance(endpoints, Outcome):
        return validated.failed(endpoints)
    validated = endpoints.validated
    if is_pilz:
        return plan_pilz(validated, endpoints.checker, endpoints.start, endpoints.goals)
    if request.path_constraints:
        return plan_constrained(validated, endpoints.checker, endpoints.start, endpoints.goals)
    return search(validated, endpoints)


def _links(request: PlanRequest) -> Iterator[str | None]:
    """Yield the links that the goals of a request constrain. The planning pipeline must solve inverse
    kinematics for these links.
    """
    for goal in request.goals:
        if isinstance(goal, PoseGoal):
            yield goal.link
        elif isinstance(goal, ConstraintGoal):
            yield from (c.link for c in (*goal.constraints.positions, *goal.constraints.orientations))


@dataclass(frozen=True, eq=False)
class StartAndGoals:
    """Input that the pipeline gives to planners: a collision-free start (n,), collision-free goals (n,),
    bounds and a collision checker.

    Attributes:
        validated: the request with this start; after resting contact, its `lead_in` leads to the start.
    """

    validated: ValidatedRequest
    checker: KernelChecker
    start: Array
    goals: tuple[Array, ...]
    lower: Array
    upper: Array
    arm_clearance: ArmClearance | None = None  # clearance between arms that the checker enforces


def find_start_and_goals(validated: ValidatedRequest) -> StartAndGoals | Outcome:
    """Find the start and the goals of a request as joint positions for the planning pipeline, or the reason
    why they are invalid.
    """
    scene = validated.scene
    try:
        scene.model.check_positions(scene.positions, margin=1e-3)
    except InputError as error:
        return Outcome(ErrorCode.START_STATE_INVALID, f"start: {error}")
    checker = KernelChecker(scene, validated.joint_names)
    start = scene.positions[checker.columns]
    if checker.touches(start):
        left = leave_start_contact(validated, checker)
        if isinstance(left, Outcome):
            return left
        validated, scene = left, left.scene
        checker = KernelChecker(scene, validated.joint_names)
        start = scene.positions[checker.columns]
    if why := validated.forbids(start):
        return Outcome(ErrorCode.START_STATE_INVALID, f"start: {why}")
    checker.relax_margins(start)
    rng = np.random.default_rng(validated.request.seed)
    goals, outcome = find_joint_goals(validated, checker, rng)
    if not outcome.ok:
        return outcome
    lower, upper = sampling_bounds(scene.model, validated.joint_names, start, goals)
    return StartAndGoals(validated, checker, start, goals, lower, upper)


PADDED_SHARE = 0.5
"""Share of the planning time for motions with arm clearance or full padding; the rest is for any motion."""


def search(validated: ValidatedRequest, endpoints: StartAndGoals) -> PlanResult:
    """Search in the planning pipeline for a motion that keeps the clearance between the arms of the group.

    If no such motion is found, search for any collision-free motion.
    """
    request = validated.request
    arms = arms_of(validated.scene.model, request.group)
    arm_clearance = achievable_arm_clearance(
        validated.scene, arms, endpoints.checker, endpoints.start, endpoints.goals, request.arm_clearance
    )
    if arm_clearance is None:
        return search_once(validated, endpoints)
    words = arm_clearance.note
    if arm_clearance.distance > 0:
        limit = replace(request, planning_time=PADDED_SHARE * request.planning_time)
        spaced = replace(
            endpoints,
            checker=arm_clearance.apply_to(endpoints.checker),
            goals=arm_clearance.goals,
            arm_clearance=arm_clearance,
        )
        result = search_once(replace(validated, request=limit), spaced)
        if result.ok or validated.cancel.is_set():
            return _report_arm_clearance(result, arm_clearance.distance, words)
        words = (
            "the arms do not touch, but no motion was found that keeps "
            f"{1000 * arm_clearance.distance:.0f} mm between them"
        )
    return _report_arm_clearance(search_once(validated, endpoints), 0.0, words)


def _report_arm_clearance(result: PlanResult, distance: float, words: str) -> PlanResult:
    """Add the clearance between the arms [m] to a successful result of the planning pipeline."""
    if not result.ok:
        return result
    message = "; ".join(text for text in (result.message, words) if text)
    return replace(result, message=message, evidence={**result.evidence, "arm_clearance": distance})


def search_once(validated: ValidatedRequest, endpoints: StartAndGoals) -> PlanResult:
    """Run the search of the planning pipeline once: return the straight line to a goal if it is
    collision-free, otherwise the shortest motion of all attempts.
    """
    problem = _problem(validated, endpoints, validated.request.seed)
    line = _direct(problem)
    if line is not None:
        made = certify_request_motion(validated, endpoints.checker, line)
        if isinstance(made, Outcome):
            return validated.failed(made)
        if made.certified:
            return _solved(validated, endpoints.checker, made, "straight line", None)
    count = int(validated.request.attempts)
    if count == 1:
        return attempt(validated, endpoints, 0)
    with ThreadPoolExecutor(min(count, os.cpu_count() or 1), "armcell-attempt") as pool:
        results = list(
            pool.map(
                lambda k: attempt(validated, _endpoints_of_thread(validated, endpoints), k), range(count)
            )
        )
    lengths = [r.path.length if r.path is not None else np.inf for r in results]
    best = results[int(np.argmin(lengths))]
    evidence = {"attempts": count, "solved": int(np.isfinite(lengths).sum()), "lengths": lengths}
    return replace(
        best, evidence={**best.evidence, **evidence}, planning_time=time.monotonic() - validated.began
    )


def _endpoints_of_thread(validated: ValidatedRequest, endpoints: StartAndGoals) -> StartAndGoals:
    """Copy the pipeline's start and goals for use in another thread,
    and give the copy its own collision checker.

    Threads must not share a checker's workspace.
    """
    checker = KernelChecker(validated.scene, validated.joint_names)
    checker.relax_margins(endpoints.start)
    return replace(
        endpoints,
        checker=checker if endpoints.arm_clearance is None else endpoints.arm_clearance.apply_to(checker),
    )


def _problem(validated: ValidatedRequest, endpoints: StartAndGoals, seed: int) -> Problem:
    return Problem(
        endpoints.checker,
        endpoints.start,
        endpoints.goals,
        endpoints.lower,
        endpoints.upper,
        seed,
        validated.deadline,
        validated.cancel,
        more_goals=stream_goals(validated, endpoints.checker, endpoints.goals, seed),
        options=validated.choice.options,
        settings=validated.choice.settings,
    )


def attempt(validated: ValidatedRequest, endpoints: StartAndGoals, number: int) -> PlanResult:
    """Run the pipeline's selected planner in rounds with different seeds, until a path can be certified and
    timed.

    Planners check the padding only at samples, so between samples a thin obstacle can be nearer than the
    padding. A few more rounds therefore try to find a motion that keeps the padding everywhere.
    """
    answer, why, unpadded = None, "", None
    enough = time.monotonic() + PADDED_SHARE * validated.request.planning_time
    for round_ in range(MAX_ROUNDS):
        if unpadded is not None and (round_ >= PADDED_ROUNDS or time.monotonic() > enough):
            break
        seed = validated.request.seed + ATTEMPT_SEED * number + ROUND_SEED * round_
        problem = _problem(validated, endpoints, seed)
        if unpadded is not None:
            problem = replace(problem, deadline=min(validated.deadline, enough))
        answer = validated.choice.planner(problem)
        if answer.waypoints is None:
            break
        waypoints = answer.waypoints
        if not answer.simplified and validated.choice.options.simplify_solutions:
            waypoints = simplify(problem, waypoints)
            if waypoints is None:
                continue
        if "chomp_smoothing" in validated.adapters:
            better = smooth_with_chomp(problem, waypoints, path_validity(problem))
            answer = replace(answer, statistics={**answer.statistics, "smoothed": better is not None})
            waypoints = waypoints if better is None else better
        if validated.cancel.is_set():
            break
        made = certify_request_motion(validated, endpoints.checker, waypoints)
        if isinstance(made, Outcome):
            return unpadded or validated.failed(made)
        if made.certified:
            solved = _solved(validated, endpoints.checker, made, validated.planner_id, answer)
            if made.padded_motion:
                return solved
            unpadded = unpadded or solved
        why = made.reason
    if unpadded is not None and not validated.cancel.is_set():
        return unpadded
    return validated.failed(_unsolved(validated, endpoints, answer, why))


def _solved(
    validated: ValidatedRequest,
    checker: KernelChecker,
    made: PlannedMotion,
    used: str,
    answer: PlannerResult | None,
) -> PlanResult:
    ignored = validated.choice.without_effect
    return PlanResult(
        ErrorCode.SUCCESS,
        made.note,
        {
            **validated.evidence,
            **(answer.statistics if answer else {}),
            **({"settings_without_effect": ignored} if ignored else {}),
        },
        path=JointPath(validated.joint_names, made.waypoints),
        trajectory=made.trajectory,
        planner_id=used,
        planning_time=time.monotonic() - validated.began,
        clearance=None if made.trajectory is None else partial(clearance_along, checker, made.trajectory),
    )


def _unsolved(
    validated: ValidatedRequest, endpoints: StartAndGoals, answer: PlannerResult | None, why: str
) -> Outcome:
    cancelled = validated.cancel.is_set()
    timed_out = time.monotonic() >= validated.deadline
    code = (
        ErrorCode.PREEMPTED if cancelled else ErrorCode.TIMED_OUT if timed_out else ErrorCode.PLANNING_FAILED
    )
    message = (answer.message if answer else "") or (
        f"{validated.planner_id}: cancelled"
        if cancelled
        else why or "found paths, but none could be proven free between its samples"
    )
    return Outcome(code, message, {"goals": len(endpoints.goals), **(answer.statistics if answer else {})})


def _direct(problem: Problem) -> Array | None:
    """Return the straight line from the start to the first goal for which the line is collision-free,
    including the collision padding. Return None if every line is blocked.
    """
    for goal in problem.goals:
        if np.max(np.abs(goal - problem.start)) < 1e-9:
            return np.vstack([problem.start])
        if problem.checker.edge_is_free(problem.start, goal):
            edge = np.vstack([problem.start, goal])
            if problem.checker.certify(edge, evidence=False).free:
                return edge
    return None
