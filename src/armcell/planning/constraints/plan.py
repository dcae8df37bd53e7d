"""Planning a motion that keeps to path constraints all along."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from functools import partial
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armcell.collision.kernel.checker import KernelChecker
from armcell.core import ErrorCode, InputError, JointPath, Outcome, PlanRequest, PlanResult, PoseGoal
from armcell.kinematics import ik_solver
from armcell.planning.constraints.description import Manifold, Violation
from armcell.planning.constraints.planner import constrained
from armcell.planning.constraints.timed import timed
from armcell.planning.constraints.warm_up import warm_up_constraints
from armcell.planning.finish import clearance_along, torque_model
from armcell.planning.goal_stream import candidates, stream
from armcell.planning.planners.native import stopping, unsolved
from armcell.planning.problem import Problem, normalized_planner_id, sampling_bounds
from armcell.scene import PlanningScene
from armcell.timing import TorqueLimitError

Array = NDArray[np.float64]

MAX_ROUNDS = 5  # of planning anew with another seed, where a path cannot be proven
MORE = 200  # solutions of a pose goal that are looked at where none of the first keeps to the constraints
PLANNER = "RRTConnect"


def check_planner(request: PlanRequest) -> None:
    """Raises InputError where the planner that is named cannot keep to path constraints."""
    planner = normalized_planner_id(request.planner_id)
    if (request.pipeline_id or "native") != "native" or planner != PLANNER:
        raise InputError(
            f"planner {planner!r} of pipeline {request.pipeline_id or 'native'!r} cannot keep to path "
            "constraints",
            cure=f"pipeline_id='native' with planner_id={PLANNER!r} can",
        )


def plan_constrained(
    scene: PlanningScene, request: PlanRequest, checker: KernelChecker, start: Array,
    goals: tuple[Array, ...], began: float, cancel: threading.Event | None = None,
) -> PlanResult:  # fmt: skip
    """A certified, timed motion whose every configuration is proven to keep to the path constraints.

    Args:
        scene: at the request's start. start: (n,), free of contact. goals: (n,) free ones, found so far.
        began: [s] of time.monotonic().
    Raises:
        InputError: constraints that cannot be understood, or a planner that cannot keep to them.
    """
    check_planner(request)
    compiling = time.monotonic()
    warm_up_constraints()
    began += time.monotonic() - compiling  # not of the request's time
    manifold = Manifold(scene, request.group, request.path_constraints)

    def answered(outcome: Outcome, **more: Any) -> PlanResult:
        spent = time.monotonic() - began
        return PlanResult(
            outcome.code, outcome.message, outcome.evidence, planner_id=PLANNER, planning_time=spent, **more
        )

    if violations := manifold.violations(start):
        return answered(_violated(ErrorCode.START_STATE_VIOLATES_PATH_CONSTRAINTS, "start", violations))
    good, violations = _goals(scene, request, checker, manifold, goals)
    if not good:
        return answered(_violated(ErrorCode.GOAL_VIOLATES_PATH_CONSTRAINTS, "goal", violations))
    manifold.allow_edges([start, *good])
    lower, upper = sampling_bounds(scene.model, checker.joint_names, start, good)
    lower = np.maximum(lower, np.minimum(manifold.lower, start))
    upper = np.minimum(upper, np.maximum(manifold.upper, start))
    torque = torque_model(scene, checker.joint_names) if request.torque_limits else None
    answer = unsuccessful = None
    planner = constrained(checker, manifold)
    event = cancel or threading.Event()
    deadline = began + request.planning_time
    for round_ in range(MAX_ROUNDS):
        seed = request.seed + 7919 * round_
        more = _more(scene, request, checker, manifold, good)
        problem = Problem(checker, start, good, lower, upper, seed, deadline, event, more)
        waypoints = _direct(problem, manifold) if round_ == 0 else None
        if waypoints is None:
            with stopping(problem) as stop:
                answer = planner.plan(
                    start, np.vstack(good), lower, upper, seed, stop, more_goals=problem.more_goals
                )
            waypoints = answer.waypoints
            if waypoints is None:
                break
        if event.is_set():
            break
        try:
            trajectory = timed(checker, manifold, waypoints, request, torque)
        except TorqueLimitError as error:
            evidence = {"joint": error.joint, "torque": error.torque, "limit": error.limit}
            return answered(Outcome(ErrorCode.PLANNING_FAILED, str(error), evidence))
        if trajectory is not None:
            return answered(
                Outcome(ErrorCode.SUCCESS, "", _statistics(answer)),
                path=JointPath(checker.joint_names, waypoints),
                trajectory=trajectory,
                clearance=partial(clearance_along, checker, trajectory),
            )
    statistics: dict[str, Any] = {"goals": len(good), **_statistics(answer)}
    code = (
        ErrorCode.PREEMPTED if event.is_set()
        else ErrorCode.TIMED_OUT if time.monotonic() >= deadline
        else ErrorCode.PLANNING_FAILED
    )  # fmt: skip
    if answer is None or answer.waypoints is not None:
        message = f"{PLANNER}: cancelled" if event.is_set() else (
            "found paths, but none whose timed motion could be proven to keep to the constraints"
        )  # fmt: skip
    else:
        unsuccessful = unsolved(PLANNER, problem, answer.iterations, answer.closest, statistics)
        message = f"{unsuccessful.message}, with the path constraints kept"
    return answered(Outcome(code, message, statistics))


def _violated(code: ErrorCode, what: str, violations: list[Violation]) -> Outcome:
    text = f"{what} violates the path constraints: " + "; ".join(v.text for v in violations[:3])
    return Outcome(code, text, {"violations": violations})


def _statistics(answer: Any) -> dict[str, Any]:
    if answer is None:
        return {}
    return {
        "iterations": float(answer.iterations),
        "nodes": float(answer.nodes),
        "plan_us": answer.plan_s * 1e6,
        "simplify_us": answer.simplify_s * 1e6,
    }


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
    scene: PlanningScene, request: PlanRequest, checker: KernelChecker, manifold: Manifold,
    found: tuple[Array, ...],
) -> tuple[tuple[Array, ...], list[Violation]]:  # fmt: skip
    """Those goals that keep to the constraints; else others of the pose goals, moved there; else why not."""
    good = tuple(q for q in found if not manifold.violations(q))
    if good:
        return good, []
    first = next(islice(_moved(scene, request, checker, manifold), 1), None)
    if first is not None:
        return (first,), []
    return (), min((manifold.violations(q) for q in found), key=lambda some: max(v.amount for v in some))


def _moved(
    scene: PlanningScene, request: PlanRequest, checker: KernelChecker, manifold: Manifold
) -> Iterator[Array]:
    """Free configurations that reach a pose goal within its tolerances and keep to the constraints."""
    rng = np.random.default_rng([request.seed, 2])
    low = np.maximum(scene.model.lower[checker.columns], manifold.lower)
    high = np.minimum(scene.model.upper[checker.columns], manifold.upper)
    for goal in request.goals:
        if not isinstance(goal, PoseGoal):
            continue
        ik, full = ik_solver(scene.model, request.group, goal.link), scene.positions.copy()
        for q in islice(candidates(scene, request.group, goal, rng), MORE):
            moved = q if not manifold.violations(q) else manifold.projected(q, low, high)
            if moved is None or not checker.is_free(moved):
                continue
            full[checker.columns] = moved
            apart = ik.tree.link_pose(full, ik.tip_link).distance_to(goal.T_world_link)
            if apart[0] <= goal.position_tolerance and apart[1] <= goal.orientation_tolerance:
                yield moved


def _more(
    scene: PlanningScene, request: PlanRequest, checker: KernelChecker, manifold: Manifold,
    known: tuple[Array, ...],
) -> Iterator[Array] | None:  # fmt: skip
    """Further goals for a search that has not reached the first, see `goal_stream.stream`."""
    more = stream(scene, request, checker, known)
    return None if more is None else (q for q in more if not manifold.violations(q))
