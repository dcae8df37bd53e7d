"""Constraints that forbid a motion or its goal: which of them, and how much wider it would have to be."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from armcell.core import ConstraintGoal, Constraints
from armcell.planning.explanation.case import Case
from armcell.planning.explanation.changes import change_goal, change_request
from armcell.planning.explanation.tolerances import One, name, scaled, told

FIELDS = ("joints", "positions", "orientations", "visibilities")
FACTORS = (1.5, 2.0, 4.0, 8.0)
SHORT = 0.5  # [s] of planning for one "what if"
Put = Callable[[Constraints], tuple[Callable, dict]]
"""Where changed constraints go: the change of the request, and its arguments."""


def too_constrained(case: Case) -> bool:
    """Whether the request succeeds without its path constraints; then which one is to blame."""
    request = case.request
    if not request.path_constraints:
        return False

    def put(constraints: Constraints):
        return change_request, {"path_constraints": constraints}

    whole = request.path_constraints
    if not _works(case, put, Constraints(name=whole.name)):
        case.say("it is not the path constraints: without them it fails as well")
        return False
    if not _blame(case, put, whole):
        case.say("no single path constraint forbids it, but all of them together")
        change, arguments = put(Constraints(name=whole.name))
        case.suggest("leave out the path constraints", change, arguments, effort=np.inf, known=True)
    return True


def goal_too_constrained(case: Case, number: int, goal: ConstraintGoal) -> None:
    """Which constraint of a constraint goal forbids it."""

    def put(constraints: Constraints):
        return change_goal, {"number": number, "goal": ConstraintGoal(constraints)}

    if not _blame(case, put, goal.constraints):
        case.say("no single constraint of the goal forbids it")


def _blame(case: Case, put: Put, whole: Constraints) -> bool:
    """Each constraint without which it works: how much wider it would have to be, or without it."""
    each = list(_each(whole))
    if len(each) == 1:  # there is nothing left without it
        blamed = each
    else:
        blamed = [(kind, k, one) for kind, k, one in each if _works(case, put, without(whole, kind, k))]
    names = [name(one) for _, _, one in each]
    called = {
        id(one): name(one) + (f" (number {k + 1})" if names.count(name(one)) > 1 else "")
        for _, k, one in each
    }
    found = False
    for _, _, one in blamed:
        if len(each) > 1:
            case.say(f"without the constraint on {called[id(one)]} it works")
        found |= _wider(case, put, whole, one, called[id(one)])
    for kind, k, one in blamed:
        fewer = without(whole, kind, k)
        if _works(case, put, fewer):
            change, arguments = put(fewer)
            text = f"leave out the constraint on {called[id(one)]}"
            case.suggest(text, change, arguments, effort=np.inf, known=True)
            found = True
    return found


def _each(whole: Constraints) -> Iterator[tuple[str, int, One]]:
    for kind in FIELDS:
        for k, one in enumerate(getattr(whole, kind)):
            yield kind, k, one


def without(whole: Constraints, kind: str, k: int) -> Constraints:
    kept = getattr(whole, kind)
    return replace(whole, **{kind: kept[:k] + kept[k + 1 :]})


def exchanged(whole: Constraints, old: One, new: One) -> Constraints:
    """With one constraint replaced by another of its kind."""
    return replace(
        whole, **{kind: tuple(new if c is old else c for c in getattr(whole, kind)) for kind in FIELDS}
    )


def _works(case: Case, put: Put, constraints: Constraints) -> bool:
    change, arguments = put(constraints)
    scene, request = change(case.scene, case.request, **arguments)
    return case.succeeds(scene, request, SHORT) is not None


def _wider(case: Case, put: Put, whole: Constraints, one: One, called: str) -> bool:
    """The smallest of a few factors on the tolerance with which it works."""
    for factor in FACTORS:
        changed = scaled(one, factor)
        if changed is None:
            return False
        constraints = exchanged(whole, one, changed)
        if _works(case, put, constraints):
            change, arguments = put(constraints)
            text = f"widen the tolerance of {called} to {told(changed)}"
            case.suggest(text, change, arguments, effort=factor, known=True)
            return True
    return False
