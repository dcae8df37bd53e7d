"""Planning a motion that keeps to path constraints all along."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armcell.collision.kernel.checker import KernelChecker
from armcell.core import ConstraintGoal, ErrorCode, InputError, JointPath, Outcome, PlanResult, PoseGoal
from armcell.planning.constraints.description import Manifold, Violation
from armcell.planning.constraints.planner import constrained
from armcell.planning.constraints.timed import timed
from armcell.planning.constraints.views import Seen, manifold_of
from armcell.planning.constraints.warm_up import warm_up_constraints
from armcell.planning.finish import clearance_along, torque_model
from armcell.planning.goal_regions import candidates, reaches
from armcell.planning.goal_stream import stream
from armcell.planning.motion import completed
from armcell.planning.planners.native import stopping, unsolved
from armcell.planning.problem import Answer, Problem, find_planner, sampling_bounds
from armcell.planning.question import Question
from armcell.timing import TorqueLimitError

Array = NDArray[np.float64]

MAX_ROUNDS = 5  # of planning anew with another seed, where a path cannot be proven
MORE = 200  # solutions of a pose goal that are looked at where none of the first keeps to the constraints
PLANNER = "RRTConnect"


def check_planner(question: Question) -> None:
    """Raises InputError where the planner that is named cannot keep to the path constraints."""
    pipeline_id = question.request.pipeline_id or "native"
    if pipeline_id != "native" or question.planner_id != PLANNER:
        raise InputError(
            f"planner {question.planner_id!r} of pipeline {pipeline_id!r} cannot keep to path constraints",
            cure=f"pipeline_id='native' with planner_id={PLANNER!r} can",
        )


def plan_constrained(
    question: Question, checker: KernelChecker, start: Array, goals: tuple[Array, ...]
) -> PlanResult:
    """A certified, timed motion whose every configuration is proven to keep to the path constraints.

    Args:
        start: (n,), free of contact. goals: (n,) free ones, found so far.
    Raises:
        InputError: constraints that cannot be understood.
    """
    compiling = time.monotonic()
    warm_up_constraints()
    compiling = time.monotonic() - compiling
    question = replace(question, began=question.began + compiling)  # not of the request's time
    scene, request = question.scene, question.request
    manifold = manifold_of(scene, request.group, request.path_constraints)
    standing = start if question.lead_in is None else question.lead_in[0]
    if violations := manifold.violations(standing) or manifold.violations(start):
        return question.failed(
            _violated(ErrorCode.START_STATE_VIOLATES_PATH_CONSTRAINTS, "start", violations)
        )
    good, violations = _goals(question, checker, manifold, goals)
    if not good:
        return question.failed(_violated(ErrorCode.GOAL_VIOLATES_PATH_CONSTRAINTS, "goal", violations))
    manifold.allow_edges([start, *good])
    lower, upper = sampling_bounds(scene.model, checker.joint_names, start, good)
    lower = np.maximum(lower, np.minimum(manifold.lower, start))
    upper = np.minimum(upper, np.maximum(manifold.upper, start))
    results = []
    for number in range(int(request.attempts)):
        seed = request.seed + 104_729 * number
        problem = Problem(checker, start, good, lower, upper, seed, question.deadline, question.cancel)
        results.append(_attempt(question, manifold, problem))
    return min(results, key=lambda r: r.path.length if r.path is not None else np.inf)


def _attempt(question: Question, manifold: Manifold, problem: Problem) -> PlanResult:
    """Paths until one can be proven and timed."""
    request, checker = question.request, problem.checker
    torque = torque_model(question.scene, checker.joint_names) if request.torque_limits else None
    answer, why = None, "found paths, but none whose timed motion could be proven to keep to the constraints"
    for round_ in range(MAX_ROUNDS):
        seed = problem.seed + 7919 * round_
        waypoints = _direct(problem, manifold) if round_ == 0 else None
        if waypoints is None:
            answer = _searched(question, manifold, replace(problem, seed=seed))
            waypoints = answer.waypoints
            if waypoints is None:
                break
        if question.cancel.is_set():
            break
        if question.workspace is not None and (q := question.workspace.left_at(waypoints)) is not None:
            why = f"the paths found leave the workspace: {question.workspace.describe(q)}"
            continue
        try:
            trajectory = timed(checker, manifold, waypoints, request, torque)
        except TorqueLimitError as error:
            evidence = {"joint": error.joint, "torque": error.torque, "limit": error.limit}
            return question.failed(Outcome(ErrorCode.PLANNING_FAILED, str(error), evidence))
        if trajectory is None:
            continue
        made = completed(question, checker, waypoints, trajectory)
        return PlanResult(
            ErrorCode.SUCCESS,
            made.words,
            {**question.evidence, **(answer.statistics if answer else {})},
            path=JointPath(checker.joint_names, made.waypoints),
            trajectory=made.trajectory,
            planner_id=PLANNER,
            planning_time=time.monotonic() - question.began,
            clearance=None if made.trajectory is None else partial(clearance_along, checker, made.trajectory),
        )
    return question.failed(_unsolved(question, problem, answer, why))


def _searched(question: Question, manifold: Manifold, problem: Problem) -> Answer:
    """A path on the manifold, or why there is none."""
    if isinstance(
        manifold, Seen
    ):  # nothing projects onto what a sensor sees: what it does not is thrown away
        return find_planner("ompl", PLANNER)(replace(problem, forbids=manifold.forbids))
    planner = constrained(problem.checker, manifold)
    more = _more(question, problem.checker, manifold, problem.goals, problem.seed)
    with stopping(problem) as stop:
        found = planner.plan(
            problem.start, np.vstack(problem.goals), problem.lower, problem.upper, problem.seed, stop,
            more_goals=more,
        )  # fmt: skip
    statistics: dict[str, Any] = {
        "iterations": float(found.iterations),
        "nodes": float(found.nodes),
        "plan_us": found.plan_s * 1e6,
        "simplify_us": found.simplify_s * 1e6,
    }
    if found.waypoints is None:
        return unsolved(PLANNER, problem, found.iterations, found.closest, statistics)
    return Answer(found.waypoints, "", statistics)


def _unsolved(question: Question, problem: Problem, answer: Answer | None, why: str) -> Outcome:
    cancelled = question.cancel.is_set()
    timed_out = time.monotonic() >= question.deadline
    code = (
        ErrorCode.PREEMPTED if cancelled else ErrorCode.TIMED_OUT if timed_out else ErrorCode.PLANNING_FAILED
    )
    if answer is None or answer.waypoints is not None:
        message = f"{PLANNER}: cancelled" if cancelled else why
    else:
        message = f"{answer.message}, with the path constraints kept"
    statistics = {} if answer is None else answer.statistics
    return Outcome(code, message, {"goals": len(problem.goals), **statistics})


def _violated(code: ErrorCode, what: str, violations: list[Violation]) -> Outcome:
    text = f"{what} violates the path constraints: " + "; ".join(v.text for v in violations[:3])
    return Outcome(code, text, {"violations": violations})


def _direct(problem: Problem, manifold: Manifold) -> Array | None:
    """The straight line to a goal, where it is free and keeps to the constraints."""
    for goal in problem.goals:
        if np.max(np.abs(goal - problem.start)) < 1e-9:
            return np.vstack([problem.start])
        edge = np.vstack([problem.start, goal])
        free = manifold.leaves(edge) < 0 and problem.checker.edge_is_free(problem.start, goal)
        if free and problem.checker.certify(edge, evidence=False).free:
            return edge
    return None


def _goals(
    question: Question, checker: KernelChecker, manifold: Manifold, found: tuple[Array, ...]
) -> tuple[tuple[Array, ...], list[Violation]]:
    """Those that keep to the constraints; else others of the goal regions, moved there; else why not."""
    good = tuple(q for q in found if not manifold.violations(q))
    if good:
        return good, []
    first = next(islice(_moved(question, checker, manifold), 1), None)
    if first is not None:
        return (first,), []
    return (), min((manifold.violations(q) for q in found), key=lambda some: max(v.amount for v in some))


def _moved(question: Question, checker: KernelChecker, manifold: Manifold) -> Iterator[Array]:
    """Free configurations that reach a goal within its tolerances and keep to the constraints."""
    scene, request = question.scene, question.request
    rng = np.random.default_rng([request.seed, 2])
    low = np.maximum(scene.model.lower[checker.columns], manifold.lower)
    high = np.minimum(scene.model.upper[checker.columns], manifold.upper)
    for goal in request.goals:
        if not isinstance(goal, PoseGoal | ConstraintGoal):
            continue
        for q in islice(candidates(scene, request.group, goal, rng, question.deadline), MORE):
            moved = q if not manifold.violations(q) else manifold.projected(q, low, high)
            if moved is None or not checker.is_free(moved) or question.forbids(moved):
                continue
            if reaches(scene, request.group, goal, moved):
                yield moved


def _more(
    question: Question, checker: KernelChecker, manifold: Manifold, known: tuple[Array, ...], seed: int
) -> Iterator[Array] | None:
    """Further goals for a search that has not reached the first, see `goal_stream.stream`."""
    more = stream(question, checker, known, seed)
    return None if more is None else (q for q in more if not manifold.violations(q))
