"""Path constraints that forbid a motion: which of them, and how much wider it would have to be."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from armcell.core import (
    Constraints,
    JointConstraint,
    OrientationConstraint,
    PositionConstraint,
)
from armcell.planning.explanation import words
from armcell.planning.explanation.case import Case
from armcell.planning.explanation.changes import Request, change_request

One = JointConstraint | PositionConstraint | OrientationConstraint
FIELDS = ("joints", "positions", "orientations")
FACTORS = (1.5, 2.0, 4.0, 8.0)
SHORT = 0.5  # [s] of planning for one "what if"


def too_constrained(case: Case) -> bool:
    """Whether the request succeeds without its path constraints; then which one is to blame."""
    request = case.request
    if not request.path_constraints:
        return False
    whole = request.path_constraints
    if not _works(case, request, Constraints(name=whole.name)):
        case.say("it is not the path constraints: without them it fails as well")
        return False
    blamed = [
        (kind, k, one) for kind, k, one in _each(whole) if _works(case, request, _without(whole, kind, k))
    ]
    for kind, k, one in blamed:
        case.say(f"without the constraint on {_name(one)} it works")
        _wider(case, request, whole, kind, k, one)
        case.suggest(f"leave out the constraint on {_name(one)}", change_request,
                     {"path_constraints": _without(whole, kind, k)}, effort=np.inf, known=True)  # fmt: skip
    if not blamed:
        case.say("no single path constraint forbids it, but all of them together")
        none = {"path_constraints": Constraints(name=whole.name)}
        case.suggest("leave out the path constraints", change_request, none, effort=np.inf, known=True)
    return True


def _each(whole: Constraints) -> Iterator[tuple[str, int, One]]:
    for kind in FIELDS:
        for k, one in enumerate(getattr(whole, kind)):
            yield kind, k, one


def _without(whole: Constraints, kind: str, k: int) -> Constraints:
    kept = getattr(whole, kind)
    return replace(whole, **{kind: kept[:k] + kept[k + 1 :]})


def _works(case: Case, request: Request, constraints: Constraints) -> bool:
    return case.succeeds(case.scene, replace(request, path_constraints=constraints), SHORT) is not None


def _wider(case: Case, request: Request, whole: Constraints, kind: str, k: int, one: One) -> None:
    """The smallest of a few factors on the tolerance with which it works."""
    for factor in FACTORS:
        if isinstance(one, OrientationConstraint):
            x, y, z = (min(t * factor, np.pi) for t in one.tolerance)
            changed = replace(one, tolerance=(x, y, z))
            told = ", ".join(words.angle(t) for t in changed.tolerance)
        elif isinstance(one, JointConstraint):
            above, below = one.tolerance_above * factor, one.tolerance_below * factor
            changed = replace(one, tolerance_above=above, tolerance_below=below)
            told = f"+{above:.3g}, -{below:.3g}"
        else:
            return
        kept = list(getattr(whole, kind))
        kept[k] = changed
        constraints = replace(whole, **{kind: tuple(kept)})
        if _works(case, request, constraints):
            case.suggest(f"widen the tolerance of {_name(one)} to {told}", change_request,
                         {"path_constraints": constraints}, effort=factor, known=True)  # fmt: skip
            return


def _name(one: One) -> str:
    if isinstance(one, JointConstraint):
        return one.joint
    what = "the orientation" if isinstance(one, OrientationConstraint) else "the position"
    return f"{what} of {one.link or 'the tip'}"
