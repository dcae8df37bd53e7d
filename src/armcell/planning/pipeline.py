"""The planning pipeline: check the request, find a path, shorten, prove and time it."""

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

from armcell.collision.arms import arms_of
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
from armcell.planning.adapters import adapted
from armcell.planning.apart import Room, room_between
from armcell.planning.constraints.plan import check_planner, plan_constrained
from armcell.planning.departure import departed
from armcell.planning.explanation import explained
from armcell.planning.finish import clearance_along
from armcell.planning.goal_stream import stream
from armcell.planning.goals import joint_goals
from armcell.planning.industrial.plan import check_command, plan_industrial
from armcell.planning.motion import Motion, timed_motion
from armcell.planning.native.warm_up import warm_up, warm_up_ik
from armcell.planning.optimise.smoother import smoothed
from armcell.planning.placed import Placed
from armcell.planning.planners.optimisers import free
from armcell.planning.problem import INDUSTRIAL, Answer, Problem, pipeline_for, sampling_bounds
from armcell.planning.question import Question, ask
from armcell.planning.simplify import simplify
from armcell.scene import PlanningScene

Array = NDArray[np.float64]

MAX_ROUNDS = 5
ROOMY_ROUNDS = 3
"""How often, where one that only does not touch is there, for one that keeps the padding all along."""
"""How often a path that fails certification is planned anew with another seed."""

ROUND_SEED, ATTEMPT_SEED = 7919, 104_729  # primes, so that rounds of one attempt are not another attempt


@explained(PlanRequest)
def plan(scene: PlanningScene, request: PlanRequest, cancel: threading.Event | None = None) -> PlanResult:
    """A certified, timed motion of one group.

    Args:
        scene: the world; its state is the start where the request names none.
        cancel: set it from another thread to stop.
    Returns:
        SUCCESS with path and trajectory, or the code, message and evidence (contacts, joints, distances).
    Raises:
        InputError: misuse: unknown group, planner, link, joint, parameter or adapter; scaling outside (0, 1].
    """
    warm_up()
    if pipeline_for(request.pipeline_id, request.planner_id) == INDUSTRIAL:  # also where only LIN is named
        request = replace(request, pipeline_id=INDUSTRIAL)
    if request.group in scene.model.groups:
        for link in _links(request):
            warm_up_ik(scene.model, request.group, Placed(scene, request.group, link).link)
    asked = ask(scene, request, cancel)
    industrial = request.pipeline_id == INDUSTRIAL
    if industrial:
        check_command(asked)
    elif request.path_constraints:
        check_planner(asked)
    question = adapted(asked)
    if isinstance(question, Outcome):
        return asked.failed(question)
    ends = find_ends(question)
    if isinstance(ends, Outcome):
        return question.failed(ends)
    question = ends.question
    if industrial:
        return plan_industrial(question, ends.checker, ends.start, ends.goals)
    if request.path_constraints:
        return plan_constrained(question, ends.checker, ends.start, ends.goals)
    return search(question, ends)


def _links(request: PlanRequest) -> Iterator[str | None]:
    """Those that inverse kinematics is asked for."""
    for goal in request.goals:
        if isinstance(goal, PoseGoal):
            yield goal.link
        elif isinstance(goal, ConstraintGoal):
            yield from (c.link for c in (*goal.constraints.positions, *goal.constraints.orientations))


@dataclass(frozen=True, eq=False)
class Ends:
    """A free start (n,) and goals (n,), bounds to sample in, and the checker they were found with.

    Attributes:
        question: from that start; where the robot stands in resting contact, its `lead_in` leads there.
    """

    question: Question
    checker: KernelChecker
    start: Array
    goals: tuple[Array, ...]
    lower: Array
    upper: Array
    room: Room | None = None  # that the checker keeps between arms


def find_ends(question: Question) -> Ends | Outcome:
    """Start and goals as joint positions, or what is wrong with them."""
    scene = question.scene
    try:
        scene.model.check_positions(scene.positions, margin=1e-3)
    except InputError as error:
        return Outcome(ErrorCode.START_STATE_INVALID, f"start: {error}")
    checker = KernelChecker(scene, question.joint_names)
    start = scene.positions[checker.columns]
    if checker.touches(start):
        left = departed(question, checker)
        if isinstance(left, Outcome):
            return left
        question, scene = left, left.scene
        checker = KernelChecker(scene, question.joint_names)
        start = scene.positions[checker.columns]
    if why := question.forbids(start):
        return Outcome(ErrorCode.START_STATE_INVALID, f"start: {why}")
    checker.relax_margins(start)
    rng = np.random.default_rng(question.request.seed)
    goals, outcome = joint_goals(question, checker, rng)
    if not outcome.ok:
        return outcome
    lower, upper = sampling_bounds(scene.model, question.joint_names, start, goals)
    return Ends(question, checker, start, goals, lower, upper)


ROOMY_SHARE = 0.5
"""Of the planning time, for motions that keep room between arms or all padding; what is left is for any."""


def search(question: Question, ends: Ends) -> PlanResult:
    """A motion on which arms keep room between each other; where none is found, any that is free."""
    request = question.request
    arms = arms_of(question.scene.model, request.group)
    room = room_between(question.scene, arms, ends.checker, ends.start, ends.goals, request.arm_clearance)
    if room is None:
        return found(question, ends)
    words = room.words
    if room.distance > 0:
        limit = replace(request, planning_time=ROOMY_SHARE * request.planning_time)
        roomy = replace(ends, checker=room.kept_by(ends.checker), goals=room.goals, room=room)
        result = found(replace(question, request=limit), roomy)
        if result.ok or question.cancel.is_set():
            return _with_room(result, room.distance, words)
        words = (
            f"the arms do not touch, but no motion was found that keeps {1000 * room.distance:.0f} mm "
            "between them"
        )
    return _with_room(found(question, ends), 0.0, words)


def _with_room(result: PlanResult, distance: float, words: str) -> PlanResult:
    """A result that says what is kept between the arms [m]."""
    if not result.ok:
        return result
    message = "; ".join(text for text in (result.message, words) if text)
    return replace(result, message=message, evidence={**result.evidence, "arm_clearance": distance})


def found(question: Question, ends: Ends) -> PlanResult:
    """The straight line where it is free; else the shortest motion of all attempts."""
    problem = _problem(question, ends, question.request.seed)
    line = _direct(problem)
    if line is not None:
        made = timed_motion(question, ends.checker, line)
        if isinstance(made, Outcome):
            return question.failed(made)
        if made.done:
            return _solved(question, ends.checker, made, "straight line", None)
    count = int(question.request.attempts)
    if count == 1:
        return attempt(question, ends, 0)
    with ThreadPoolExecutor(min(count, os.cpu_count() or 1), "armcell-attempt") as pool:
        results = list(
            pool.map(lambda k: attempt(question, _ends_of_thread(question, ends), k), range(count))
        )
    lengths = [r.path.length if r.path is not None else np.inf for r in results]
    best = results[int(np.argmin(lengths))]
    evidence = {"attempts": count, "solved": int(np.isfinite(lengths).sum()), "lengths": lengths}
    return replace(
        best, evidence={**best.evidence, **evidence}, planning_time=time.monotonic() - question.began
    )


def _ends_of_thread(question: Question, ends: Ends) -> Ends:
    """The same with a checker of its own: a checker has one workspace."""
    checker = KernelChecker(question.scene, question.joint_names)
    checker.relax_margins(ends.start)
    return replace(ends, checker=checker if ends.room is None else ends.room.kept_by(checker))


def _problem(question: Question, ends: Ends, seed: int) -> Problem:
    return Problem(
        ends.checker,
        ends.start,
        ends.goals,
        ends.lower,
        ends.upper,
        seed,
        question.deadline,
        question.cancel,
        more_goals=stream(question, ends.checker, ends.goals, seed),
        options=question.choice.options,
        settings=question.choice.settings,
    )


def attempt(question: Question, ends: Ends, number: int) -> PlanResult:
    """Paths from one seed until one can be proven and timed, and with a few more tries keeps its padding.

    Paths keep the padding at the configurations that were looked at; a thin thing can be nearer in between.
    """
    answer, why, tight = None, "", None
    enough = time.monotonic() + ROOMY_SHARE * question.request.planning_time
    for round_ in range(MAX_ROUNDS):
        if tight is not None and (round_ >= ROOMY_ROUNDS or time.monotonic() > enough):
            break
        seed = question.request.seed + ATTEMPT_SEED * number + ROUND_SEED * round_
        problem = _problem(question, ends, seed)
        if tight is not None:
            problem = replace(problem, deadline=min(question.deadline, enough))
        answer = question.choice.planner(problem)
        if answer.waypoints is None:
            break
        waypoints = answer.waypoints
        if not answer.simplified and question.choice.options.simplify_solutions:
            waypoints = simplify(problem, waypoints)
            if waypoints is None:
                continue
        if "chomp_smoothing" in question.adapters:
            better = smoothed(problem, waypoints, free(problem))
            answer = replace(answer, statistics={**answer.statistics, "smoothed": better is not None})
            waypoints = waypoints if better is None else better
        if question.cancel.is_set():
            break
        made = timed_motion(question, ends.checker, waypoints)
        if isinstance(made, Outcome):
            return tight or question.failed(made)
        if made.done:
            solved = _solved(question, ends.checker, made, question.planner_id, answer)
            if made.roomy:
                return solved
            tight = tight or solved
        why = made.why
    if tight is not None and not question.cancel.is_set():
        return tight
    return question.failed(_unsolved(question, ends, answer, why))


def _solved(
    question: Question, checker: KernelChecker, made: Motion, used: str, answer: Answer | None
) -> PlanResult:
    ignored = question.choice.without_effect
    return PlanResult(
        ErrorCode.SUCCESS,
        made.words,
        {
            **question.evidence,
            **(answer.statistics if answer else {}),
            **({"settings_without_effect": ignored} if ignored else {}),
        },
        path=JointPath(question.joint_names, made.waypoints),
        trajectory=made.trajectory,
        planner_id=used,
        planning_time=time.monotonic() - question.began,
        clearance=None if made.trajectory is None else partial(clearance_along, checker, made.trajectory),
    )


def _unsolved(question: Question, ends: Ends, answer: Answer | None, why: str) -> Outcome:
    cancelled = question.cancel.is_set()
    timed_out = time.monotonic() >= question.deadline
    code = (
        ErrorCode.PREEMPTED if cancelled else ErrorCode.TIMED_OUT if timed_out else ErrorCode.PLANNING_FAILED
    )
    message = (answer.message if answer else "") or (
        f"{question.planner_id}: cancelled"
        if cancelled
        else why or "found paths, but none could be proven free between its samples"
    )
    return Outcome(code, message, {"goals": len(ends.goals), **(answer.statistics if answer else {})})


def _direct(problem: Problem) -> Array | None:
    """The straight line to a goal, where it is free with padding: the shortest path there is."""
    for goal in problem.goals:
        if np.max(np.abs(goal - problem.start)) < 1e-9:
            return np.vstack([problem.start])
        if problem.checker.edge_is_free(problem.start, goal):
            edge = np.vstack([problem.start, goal])
            if problem.checker.certify(edge, evidence=False).free:
                return edge
    return None
