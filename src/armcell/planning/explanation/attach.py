"""Give failed results what explains them. Successful ones are left alone and keep nothing."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial, wraps
from typing import Any, TypeVar, cast

from armcell.core import CartesianRequest, ErrorCode, Explanation, InputError, PlanResult
from armcell.planning.explanation import cartesian, goal, industrial, motion, start, violated
from armcell.planning.explanation.case import Case, Solve
from armcell.planning.explanation.changes import Request
from armcell.planning.explanation.misuse import missing_result, misuse
from armcell.scene import PlanningScene

F = TypeVar("F", bound=Callable[..., PlanResult])

SOLVERS: dict[type, Solve] = {}
"""The planning function for each kind of request; `explained` fills it: explanation stands below them."""

CAUSES: dict[ErrorCode, Callable[[Case], None]] = {
    ErrorCode.START_STATE_INVALID: start.start_invalid,
    ErrorCode.START_STATE_IN_COLLISION: start.start_in_collision,
    ErrorCode.START_STATE_VIOLATES_PATH_CONSTRAINTS: violated.start_violates,
    ErrorCode.GOAL_VIOLATES_PATH_CONSTRAINTS: violated.goal_violates,
    ErrorCode.GOAL_STATE_INVALID: goal.goals,
    ErrorCode.GOAL_IN_COLLISION: goal.goals,
    ErrorCode.NO_IK_SOLUTION: goal.goals,
    ErrorCode.INVALID_GOAL_CONSTRAINTS: goal.goals,
    ErrorCode.PLANNING_FAILED: motion.no_motion,
    ErrorCode.TIMED_OUT: motion.no_motion,
    ErrorCode.PREEMPTED: motion.no_motion,
}


def explained(kind: type) -> Callable[[F], F]:
    """Make a planning function for one kind of request give results that can be asked `explain()`."""

    def decorate(solve: F) -> F:
        @wraps(solve)
        def solve_and_keep(scene: PlanningScene, request: Any, *more: Any, **options: Any) -> PlanResult:
            result = solve(scene, request, *more, **options)
            if result.ok:
                return result
            return replace(result, explainer=partial(_explain, scene, request, result))

        SOLVERS[kind] = solve
        return cast(F, solve_and_keep)

    return decorate


def _explain(scene: PlanningScene, request: Request, result: PlanResult, seconds: float) -> Explanation:
    case = Case(scene, request, result, SOLVERS, time.monotonic() + seconds)
    starts = (ErrorCode.START_STATE_INVALID, ErrorCode.START_STATE_IN_COLLISION)
    if isinstance(request, CartesianRequest) and result.code not in starts:
        cartesian.line_stops(case)
    elif industrial.is_told(case):
        industrial.told_motion(case)
    else:  # whatever else it is, it may be constraints, time or something in the way
        CAUSES.get(result.code, motion.no_motion)(case)
    return case.explanation()


def explain_misuse(
    scene: PlanningScene, request: Request, error: InputError, seconds: float = 10.0
) -> Explanation:
    """What would mend a request that a planning function refused with an error."""
    case = Case(scene, request, missing_result(error), SOLVERS, time.monotonic() + seconds)
    misuse(case, error)
    return case.explanation()
