"""A start or goal that does not keep to the path constraints: which, by how much, the nearest that does."""

from __future__ import annotations

from itertools import islice

import numpy as np
from numpy.typing import NDArray

from armcell.core import Constraints, Goal, JointGoal, JointState, NamedGoal, PlanRequest, PoseGoal
from armcell.planning.constraint_check import ConstraintError, constraint_errors
from armcell.planning.constraints.views import manifold_of
from armcell.planning.explanation import words
from armcell.planning.explanation.case import Case, tell_way
from armcell.planning.explanation.changes import change_goal, change_request, change_start
from armcell.planning.explanation.constraints import exchanged
from armcell.planning.explanation.goal import wanted_joints
from armcell.planning.explanation.tolerances import One, loosened, name, told
from armcell.planning.goal_regions import candidates
from armcell.planning.placed import Placed

Array = NDArray[np.float64]

MOST_GOALS = 3  # that are looked into
LOOKED_AT = 40  # joint solutions of a goal
MOVED = 10  # of them that are tried to be moved onto the constraints
State = tuple[Array, list[ConstraintError]]


def start_violates(case: Case) -> None:
    """What the start violates; the nearest state that does not, and how much wider tolerances must be."""
    request = _request(case)
    errors = _violated(case, case.start)
    _tell(case, "at the start", errors)
    case.state = case.group_state(case.start)
    q = _moved(case, case.start)
    if q is not None:
        case.nearest = case.group_state(q)
        tell_way(case, "the nearest start found that keeps to them", case.start, q)
        step = words.joint_steps(case.scene.model, case.joint_names, q - case.start)
        case.suggest(f"start {step} from here, which keeps to the constraints", change_start,
                     {"state": case.nearest}, effort=float(np.linalg.norm(q - case.start)))  # fmt: skip
    ends = [state for goal in request.goals for state in _goal_states(case, goal)]
    _wider(case, [*errors, *(min(ends, key=_amount)[1] if ends else [])])
    _left_out(case, errors)


def goal_violates(case: Case) -> None:
    """The same for each goal."""
    for number, goal in enumerate(_request(case).goals[:MOST_GOALS]):
        states = _goal_states(case, goal)
        if not states or not states[0][1]:
            continue
        q, errors = states[0]
        _tell(case, "at the goal", errors)
        case.state = case.state or case.group_state(q)
        _nearest_goal(case, number, goal, [q for q, _ in states[:MOVED]])
        _wider(case, errors)
        _left_out(case, errors)


def _request(case: Case) -> PlanRequest:
    assert isinstance(case.request, PlanRequest)
    return case.request


def _violated(case: Case, q: Array) -> list[ConstraintError]:
    request = _request(case)
    errors = constraint_errors(case.started, request.group, request.path_constraints, q)
    return [e for e in errors if not e.ok]


def _tell(case: Case, where: str, errors: list[ConstraintError]) -> None:
    for error in errors:
        case.say(f"{where} {error.words}")
    case.data.setdefault("violated", {}).update({name(e.constraint): float(np.max(e.excess)) for e in errors})


def _moved(case: Case, q: Array) -> Array | None:
    """A free state near q (n,) that keeps to the path constraints: q projected onto them."""
    request, model = _request(case), case.scene.model
    manifold = manifold_of(case.started, request.group, request.path_constraints)
    low = np.maximum(model.lower[case.columns], manifold.lower)
    high = np.minimum(model.upper[case.columns], manifold.upper)
    if np.any(low > high):
        return None
    found = manifold.projected(q, low, high)
    return None if found is None or not case.checker.is_free(found) else found


def _goal_states(case: Case, goal: Goal) -> list[State]:
    """Free states that reach a goal, and what each violates; the one that violates least first."""
    if isinstance(goal, JointGoal | NamedGoal):
        wanted = wanted_joints(case, goal)
        return [] if wanted is None else [(wanted, _violated(case, wanted))]
    some = islice(candidates(case.started, case.request.group, goal, case.rng, case.deadline), LOOKED_AT)
    return sorted(((q, _violated(case, q)) for q in some if case.checker.is_free(q)), key=_amount)


def _amount(state: State) -> float:
    return max((float(np.max(e.excess)) for e in state[1]), default=0.0)


def _nearest_goal(case: Case, number: int, goal: Goal, states: list[Array]) -> None:
    """The goal where the first of the states that can be moved onto the constraints ends up."""
    both = next(((q, m) for q in states if (m := _moved(case, q)) is not None), None)
    if both is None:
        case.say("no free state near the goal was found that keeps to the constraints")
        return
    q, moved = both
    case.nearest = case.nearest or case.group_state(moved)
    tell_way(case, "the nearest goal found that keeps to them", q, moved)
    if isinstance(goal, PoseGoal):
        placed = Placed(case.started, case.request.group, goal.link)
        pose = placed.pose(moved)
        step, turn = goal.T_world_link.distance_to(pose)
        changed: Goal = PoseGoal(pose, goal.link, goal.position_tolerance, goal.orientation_tolerance)
        away = f"{words.length(step)} and {words.angle(turn)} away"
        text = f"take the pose {away}, which keeps to the constraints"
    else:
        changed = JointGoal(JointState(case.joint_names, moved))
        steps = words.joint_steps(case.scene.model, case.joint_names, moved - q)
        text = f"change the goal: {steps}, which keeps to the constraints"
    effort = float(np.linalg.norm(moved - q))
    case.suggest(text, change_goal, {"number": number, "goal": changed}, effort=effort)


def _wider(case: Case, errors: list[ConstraintError]) -> None:
    """Tolerances with room for all of these errors."""
    wide: dict[int, tuple[One, One]] = {}  # by identity: the constraint and what becomes of it
    for error in errors:
        first = error.constraint
        wide[id(first)] = (first, loosened(wide.get(id(first), (first, first))[1], error))
    constraints = _request(case).path_constraints
    for first, changed in wide.values():
        constraints = exchanged(constraints, first, changed)
    parts = " and ".join(f"{name(one)} to {told(changed)}" for one, changed in wide.values())
    effort = max(float(np.max(e.excess)) for e in errors)
    case.suggest(
        f"widen the tolerance of {parts}", change_request, {"path_constraints": constraints}, effort=effort
    )


def _left_out(case: Case, errors: list[ConstraintError]) -> None:
    whole = _request(case).path_constraints
    gone = {id(e.constraint) for e in errors}
    kept = Constraints(
        tuple(c for c in whole.joints if id(c) not in gone),
        tuple(c for c in whole.positions if id(c) not in gone),
        tuple(c for c in whole.orientations if id(c) not in gone),
        whole.name,
        tuple(c for c in whole.visibilities if id(c) not in gone),
    )
    told_names = " and ".join(name(e.constraint) for e in errors)
    case.suggest(
        f"leave out the constraint on {told_names}", change_request, {"path_constraints": kept}, effort=np.inf
    )
