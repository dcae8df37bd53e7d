"""Explainer for failed planning results: selects the diagnosis by the error code."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial, wraps
from typing import Any, TypeVar, cast

from armcell.core import CartesianRequest, ErrorCode, Explanation, InputError, PlanResult
from armcell.planning.diagnosis import cartesian, constraints, goal, pilz, search_failure, start_state
from armcell.planning.diagnosis.changes import Request
from armcell.planning.diagnosis.diagnosis import Diagnosis, Solve
from armcell.planning.diagnosis.invalid_request import diagnose_invalid_request, missing_result
from armcell.scene import PlanningScene

F = TypeVar("F", bound=Callable[..., PlanResult])

SOLVERS: dict[type, Solve] = {}
"""The planning function of each request type; `with_explanation` fills it, so that no planner is imported."""

EXPLAINERS: dict[ErrorCode, Callable[[Diagnosis], None]] = {
    ErrorCode.START_STATE_INVALID: start_state.explain_start_limits,
    ErrorCode.START_STATE_IN_COLLISION: start_state.explain_start_contact,
    ErrorCode.START_STATE_VIOLATES_PATH_CONSTRAINTS: constraints.explain_start_constraints,
    ErrorCode.GOAL_VIOLATES_PATH_CONSTRAINTS: constraints.explain_goal_constraints,
    ErrorCode.GOAL_STATE_INVALID: goal.explain_goals,
    ErrorCode.GOAL_IN_COLLISION: goal.explain_goals,
    ErrorCode.NO_IK_SOLUTION: goal.explain_goals,
    ErrorCode.INVALID_GOAL_CONSTRAINTS: goal.explain_goals,
    ErrorCode.PLANNING_FAILED: search_failure.explain_search_failure,
    ErrorCode.TIMED_OUT: search_failure.explain_search_failure,
    ErrorCode.PREEMPTED: search_failure.explain_search_failure,
}


def with_explanation(kind: type) -> Callable[[F], F]:
    """Return a decorator for the planning function of one kind of request, which makes failed results
    explainable: the dispatcher selects the diagnosis that fits the failure, when an explanation is requested.
    """

    def decorate(solve: F) -> F:
        @wraps(solve)
        def solve_and_keep(scene: PlanningScene, request: Any, *more: Any, **options: Any) -> PlanResult:
            if not isinstance(scene, PlanningScene) or not isinstance(request, kind):
                given = f"{type(scene).__name__} and {type(request).__name__}"
                raise InputError(
                    f"{solve.__name__}() needs a PlanningScene and a {kind.__name__}, not {given}",
                    hint="PlanningScene.of(model) is the scene of a robot without objects",
                )
            result = solve(scene, request, *more, **options)
            if result.ok:
                return result
            return replace(result, explainer=partial(_explain, scene, request, result))

        SOLVERS[kind] = solve
        return cast(F, solve_and_keep)

    return decorate


def _explain(scene: PlanningScene, request: Request, result: PlanResult, seconds: float) -> Explanation:
    diagnosis = Diagnosis(scene, request, result, SOLVERS, time.monotonic() + seconds)
    starts = (ErrorCode.START_STATE_INVALID, ErrorCode.START_STATE_IN_COLLISION)
    if isinstance(request, CartesianRequest) and result.code not in starts:
        cartesian.explain_cartesian_stop(diagnosis)
    elif pilz.is_pilz_motion_failure(diagnosis):
        pilz.explain_pilz_motion(diagnosis)
    else:  # other codes: constraints, time or obstacles
        EXPLAINERS.get(result.code, search_failure.explain_search_failure)(diagnosis)
    return diagnosis.explanation()


def explain_invalid_request(
    scene: PlanningScene, request: Request, error: InputError, seconds: float = 10.0
) -> Explanation:
    """Dispatch an invalid request to its diagnosis: explain why the planning function rejected the request,
    and suggest corrections.
    """
    diagnosis = Diagnosis(scene, request, missing_result(error), SOLVERS, time.monotonic() + seconds)
    diagnose_invalid_request(diagnosis, error)
    return diagnosis.explanation()
