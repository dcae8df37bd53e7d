"""Diagnosis of constraints that forbid a motion, its start or its goal.

The diagnosis names the constraint and the tolerance that it needs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from armcell.core import (
    SE3,
    Box,
    Capsule,
    ConstraintGoal,
    Constraints,
    Cylinder,
    Goal,
    JointConstraint,
    JointGoal,
    JointState,
    NamedGoal,
    OrientationConstraint,
    Plane,
    PlanRequest,
    PoseGoal,
    PositionConstraint,
    Shape,
    Sphere,
    VisibilityConstraint,
)
from armcell.planning.constraints.evaluation import ConstraintResidual, constraint_errors
from armcell.planning.constraints.visibility_manifold import make_manifold
from armcell.planning.diagnosis import text_format
from armcell.planning.diagnosis.changes import change_goal, change_request, change_start
from armcell.planning.diagnosis.diagnosis import Diagnosis, report_distance, wanted_joints
from armcell.planning.goals.sampling import sample_goal_positions
from armcell.planning.moved_frame import MovedFrame

Array = NDArray[np.float64]

One = JointConstraint | PositionConstraint | OrientationConstraint | VisibilityConstraint
SPARE = (1.05, 1e-3)  # factor and addition [rad or m] to the minimal tolerance


def constraint_label(one: One) -> str:
    """Return a short name for a constraint, for use in a diagnosis: the name of its joint, link or sensor."""
    if isinstance(one, JointConstraint):
        return one.joint
    if isinstance(one, VisibilityConstraint):
        return f"the view of {one.sensor}"
    what = "the orientation" if isinstance(one, OrientationConstraint) else "the position"
    return f"{what} of {one.link or 'the tip'}"


def tolerance_text(one: One) -> str:
    """Describe the tolerance of a constraint as text for a diagnosis."""
    if isinstance(one, OrientationConstraint):
        return ", ".join(text_format.angle(t) for t in one.tolerance)
    if isinstance(one, JointConstraint):
        return f"+{one.tolerance_above:.3g}, -{one.tolerance_below:.3g}"
    if isinstance(one, VisibilityConstraint):
        return text_format.length(one.target_radius)
    return " or ".join(_size(shape) for shape, _ in one.region)


def scaled_constraint(one: One, factor: float) -> One | None:
    """Return a copy of a constraint whose tolerance is multiplied by `factor`. A diagnosis tests and suggests
    such copies as looser constraints.

    Return None for a half space, which has no size, and for a visibility constraint.
    """
    if isinstance(one, VisibilityConstraint):
        return None
    if isinstance(one, OrientationConstraint):
        x, y, z = (min(t * factor, np.pi) for t in one.tolerance)
        return replace(one, tolerance=(x, y, z))
    if isinstance(one, JointConstraint):
        above, below = one.tolerance_above * factor, one.tolerance_below * factor
        return replace(one, tolerance_above=above, tolerance_below=below)
    if any(isinstance(shape, Plane) for shape, _ in one.region):
        return None
    region = tuple(_grown(shape, T, (factor - 1) * _half(shape)) for shape, T in one.region)
    return replace(one, region=region)


def widened_constraint(one: One, error: ConstraintResidual) -> One:
    """Return a wider copy of a constraint. A state with the given error satisfies the copy with a small
    margin, so that a diagnosis can suggest it.

    Args:
        one: the constraint of the error, or an already widened copy of this constraint.
    """
    if isinstance(one, VisibilityConstraint):
        return one
    need = [float(v) for v in np.abs(error.error) * SPARE[0] + SPARE[1]]
    if isinstance(one, OrientationConstraint):
        x, y, z = (
            t if over <= 0 else min(max(t, n), np.pi)
            for t, n, over in zip(one.tolerance, need, error.excess, strict=True)
        )
        return replace(one, tolerance=(x, y, z))
    if isinstance(one, JointConstraint):
        if error.error[0] > 0:
            return replace(one, tolerance_above=max(one.tolerance_above, need[0]))
        return replace(one, tolerance_below=max(one.tolerance_below, need[0]))
    return replace(one, region=tuple(_grown(shape, T, need[0]) for shape, T in one.region))


def _half(shape: Shape) -> float:
    return float(np.max(_extent(shape))) / 2


def _extent(shape: Shape) -> tuple[float, ...]:
    """Return the sizes [m] of a shape in a constraint region, so that a diagnosis can suggest larger ones."""
    match shape:
        case Box():
            return shape.x, shape.y, shape.z
        case Sphere():
            return (2 * shape.radius,)
        case Cylinder() | Capsule():
            return 2 * shape.radius, shape.length
    return ()


def _size(shape: Shape) -> str:
    extent = _extent(shape)
    kind = type(shape).__name__.lower()
    return f"a {kind} of {' x '.join(text_format.length(x) for x in extent)}" if extent else f"a {kind}"


def _grown(shape: Shape, T: SE3, by: float) -> tuple[Shape, SE3]:
    """Enlarge a shape of a constraint region so that its surface moves outward by at least `by` [m] on every
    side.
    """
    match shape:
        case Box():
            return Box(shape.x + 2 * by, shape.y + 2 * by, shape.z + 2 * by), T
        case Sphere():
            return Sphere(shape.radius + by), T
        case Cylinder():
            return Cylinder(shape.radius + by, shape.length + 2 * by), T
        case Capsule():
            return Capsule(shape.radius + by, shape.length), T
        case Plane():  # solid below its xy plane
            return shape, T @ SE3.from_xyz(0.0, 0.0, by)
    return shape, T


FIELDS = ("joints", "positions", "orientations", "visibilities")
FACTORS = (1.5, 2.0, 4.0, 8.0)
SHORT = 0.5  # [s] planning time of one test
Put = Callable[[Constraints], tuple[Callable, dict]]
"""Converts changed constraints to a change of the request and its arguments."""


def diagnose_path_constraints(diagnosis: Diagnosis) -> bool:
    """Test whether path constraints are the cause of a failure: the request may succeed without them.

    If it does, find the constraint to blame and return True.
    """
    request = diagnosis.request
    if not request.path_constraints:
        return False

    def put(constraints: Constraints):
        return change_request, {"path_constraints": constraints}

    whole = request.path_constraints
    if not _works(diagnosis, put, Constraints(name=whole.name)):
        diagnosis.add_finding("it is not the path constraints: without them it fails as well")
        return False
    if not _blame(diagnosis, put, whole):
        diagnosis.add_finding("no single path constraint forbids it, but all of them together")
        change, arguments = put(Constraints(name=whole.name))
        diagnosis.suggest("leave out the path constraints", change, arguments, effort=np.inf, known=True)
    return True


def diagnose_goal_constraints(diagnosis: Diagnosis, number: int, goal: ConstraintGoal) -> None:
    """Diagnose a goal that is given by constraints: find the constraint that makes the goal of the failed
    request unreachable.
    """

    def put(constraints: Constraints):
        return change_goal, {"number": number, "goal": ConstraintGoal(constraints)}

    if not _blame(diagnosis, put, goal.constraints):
        diagnosis.add_finding("no single constraint of the goal forbids it")


def _blame(diagnosis: Diagnosis, put: Put, whole: Constraints) -> bool:
    """Find the constraints to blame for a failed request: those whose removal makes it succeed. Suggest
    widening or removing them.
    """
    each = list(_each(whole))
    if len(each) == 1:  # no constraint remains without it
        blamed = each
    else:
        blamed = [(kind, k, one) for kind, k, one in each if _works(diagnosis, put, without(whole, kind, k))]
    names = [constraint_label(one) for _, _, one in each]
    called = {
        id(one): constraint_label(one)
        + (f" (number {k + 1})" if names.count(constraint_label(one)) > 1 else "")
        for _, k, one in each
    }
    found = False
    for _, _, one in blamed:
        if len(each) > 1:
            diagnosis.add_finding(f"without the constraint on {called[id(one)]} it works")
        found |= _suggest_scaled(diagnosis, put, whole, one, called[id(one)])
    for kind, k, one in blamed:
        fewer = without(whole, kind, k)
        if _works(diagnosis, put, fewer):
            change, arguments = put(fewer)
            text = f"leave out the constraint on {called[id(one)]}"
            diagnosis.suggest(text, change, arguments, effort=np.inf, known=True)
            found = True
    return found


def _each(whole: Constraints) -> Iterator[tuple[str, int, One]]:
    for kind in FIELDS:
        for k, one in enumerate(getattr(whole, kind)):
            yield kind, k, one


def without(whole: Constraints, kind: str, k: int) -> Constraints:
    """Return a copy of a failed request's constraints that omits one constraint, which is given by its kind
    and index.
    """
    kept = getattr(whole, kind)
    return replace(whole, **{kind: kept[:k] + kept[k + 1 :]})


def exchanged(whole: Constraints, old: One, new: One) -> Constraints:
    """Return the constraints of a failed request with one of them replaced by another constraint of the same
    kind.
    """
    return replace(
        whole, **{kind: tuple(new if c is old else c for c in getattr(whole, kind)) for kind in FIELDS}
    )


def _works(diagnosis: Diagnosis, put: Put, constraints: Constraints) -> bool:
    change, arguments = put(constraints)
    scene, request = change(diagnosis.scene, diagnosis.request, **arguments)
    return diagnosis.succeeds(scene, request, SHORT) is not None


def _suggest_scaled(diagnosis: Diagnosis, put: Put, whole: Constraints, one: One, called: str) -> bool:
    """Try a few larger tolerances for a constraint, and suggest the smallest one with which the failed
    request succeeds.
    """
    for factor in FACTORS:
        changed = scaled_constraint(one, factor)
        if changed is None:
            return False
        constraints = exchanged(whole, one, changed)
        if _works(diagnosis, put, constraints):
            change, arguments = put(constraints)
            text = f"widen the tolerance of {called} to {tolerance_text(changed)}"
            diagnosis.suggest(text, change, arguments, effort=factor, known=True)
            return True
    return False


MAX_GOALS = 3  # goals examined
LOOKED_AT = 40  # joint solutions examined per goal
MOVED = 10  # solutions to project onto the constraints
State = tuple[Array, list[ConstraintResidual]]


def explain_start_constraints(diagnosis: Diagnosis) -> None:
    """Explain which constraints the start of a request violates, and suggest a valid start or larger
    tolerances.
    """
    request = _request(diagnosis)
    errors = _violated(diagnosis, diagnosis.start)
    _tell(diagnosis, "at the start", errors)
    diagnosis.state = diagnosis.group_state(diagnosis.start)
    q = _moved(diagnosis, diagnosis.start)
    if q is not None:
        diagnosis.nearest = diagnosis.group_state(q)
        report_distance(diagnosis, "the nearest start found that keeps to them", diagnosis.start, q)
        step = text_format.joint_steps(diagnosis.scene.model, diagnosis.joint_names, q - diagnosis.start)
        diagnosis.suggest(f"start {step} from here, which keeps to the constraints", change_start,
                     {"state": diagnosis.nearest},
                      effort=float(np.linalg.norm(q - diagnosis.start)))  # fmt: skip
    ends = [state for goal in request.goals for state in _goal_states(diagnosis, goal)]
    _suggest_wider(diagnosis, [*errors, *(min(ends, key=_amount)[1] if ends else [])])
    _left_out(diagnosis, errors)


def explain_goal_constraints(diagnosis: Diagnosis) -> None:
    """Explain which constraints each goal of a request violates, and suggest valid goals or larger
    tolerances.
    """
    for number, goal in enumerate(_request(diagnosis).goals[:MAX_GOALS]):
        states = _goal_states(diagnosis, goal)
        if not states or not states[0][1]:
            continue
        q, errors = states[0]
        _tell(diagnosis, "at the goal", errors)
        diagnosis.state = diagnosis.state or diagnosis.group_state(q)
        _nearest_goal(diagnosis, number, goal, [q for q, _ in states[:MOVED]])
        _suggest_wider(diagnosis, errors)
        _left_out(diagnosis, errors)


def _request(diagnosis: Diagnosis) -> PlanRequest:
    assert isinstance(diagnosis.request, PlanRequest)
    return diagnosis.request


def _violated(diagnosis: Diagnosis, q: Array) -> list[ConstraintResidual]:
    request = _request(diagnosis)
    errors = constraint_errors(diagnosis.start_scene, request.group, request.path_constraints, q)
    return [e for e in errors if not e.ok]


def _tell(diagnosis: Diagnosis, where: str, errors: list[ConstraintResidual]) -> None:
    for error in errors:
        diagnosis.add_finding(f"{where} {error.words}")
    diagnosis.data.setdefault("violated", {}).update(
        {constraint_label(e.constraint): float(np.max(e.excess)) for e in errors}
    )


def _moved(diagnosis: Diagnosis, q: Array) -> Array | None:
    """Project joint positions q (n,) onto violated path constraints to suggest valid ones; return None if the
    result is not collision-free.
    """
    request, model = _request(diagnosis), diagnosis.scene.model
    manifold = make_manifold(diagnosis.start_scene, request.group, request.path_constraints)
    low = np.maximum(model.lower[diagnosis.columns], manifold.lower)
    high = np.minimum(model.upper[diagnosis.columns], manifold.upper)
    if np.any(low > high):
        return None
    found = manifold.project(q, low, high)
    return None if found is None or not diagnosis.checker.is_free(found) else found


def _goal_states(diagnosis: Diagnosis, goal: Goal) -> list[State]:
    """List states that reach a goal, each with the constraints that it violates. The state with the smallest
    violation comes first.

    States that are sampled for a goal are collision-free. The only state of a joint goal or named goal may be
    in collision.
    """
    if isinstance(goal, JointGoal | NamedGoal):
        wanted = wanted_joints(diagnosis, goal)
        return [] if wanted is None else [(wanted, _violated(diagnosis, wanted))]
    some = islice(
        sample_goal_positions(
            diagnosis.start_scene, diagnosis.request.group, goal, diagnosis.rng, diagnosis.deadline
        ),
        LOOKED_AT,
    )
    return sorted(((q, _violated(diagnosis, q)) for q in some if diagnosis.checker.is_free(q)), key=_amount)


def _amount(state: State) -> float:
    return max((float(np.max(e.excess)) for e in state[1]), default=0.0)


def _nearest_goal(diagnosis: Diagnosis, number: int, goal: Goal, states: list[Array]) -> None:
    """Suggest changing a goal so that it satisfies the path constraints.

    The new goal is the first of the given goal states that can be projected onto the constraints without
    causing a collision.
    """
    both = next(((q, m) for q in states if (m := _moved(diagnosis, q)) is not None), None)
    if both is None:
        diagnosis.add_finding("no free state near the goal was found that keeps to the constraints")
        return
    q, moved = both
    diagnosis.nearest = diagnosis.nearest or diagnosis.group_state(moved)
    report_distance(diagnosis, "the nearest goal found that keeps to them", q, moved)
    if isinstance(goal, PoseGoal):
        moved_frame = MovedFrame(diagnosis.start_scene, diagnosis.request.group, goal.link)
        pose = moved_frame.pose(moved)
        step, turn = goal.T_world_link.distance_to(pose)
        changed: Goal = PoseGoal(pose, goal.link, goal.position_tolerance, goal.orientation_tolerance)
        away = f"{text_format.length(step)} and {text_format.angle(turn)} away"
        text = f"take the pose {away}, which keeps to the constraints"
    else:
        changed = JointGoal(JointState(diagnosis.joint_names, moved))
        steps = text_format.joint_steps(diagnosis.scene.model, diagnosis.joint_names, moved - q)
        text = f"change the goal: {steps}, which keeps to the constraints"
    effort = float(np.linalg.norm(moved - q))
    diagnosis.suggest(text, change_goal, {"number": number, "goal": changed}, effort=effort)


def _suggest_wider(diagnosis: Diagnosis, errors: list[ConstraintResidual]) -> None:
    """Suggest tolerances that are wide enough for all constraint errors of the start or the goal."""
    wide: dict[int, tuple[One, One]] = {}  # by identity: the constraint and its widened copy
    for error in errors:
        first = error.constraint
        wide[id(first)] = (first, widened_constraint(wide.get(id(first), (first, first))[1], error))
    constraints = _request(diagnosis).path_constraints
    for first, changed in wide.values():
        constraints = exchanged(constraints, first, changed)
    parts = " and ".join(
        f"{constraint_label(one)} to {tolerance_text(changed)}" for one, changed in wide.values()
    )
    effort = max(float(np.max(e.excess)) for e in errors)
    diagnosis.suggest(
        f"widen the tolerance of {parts}", change_request, {"path_constraints": constraints}, effort=effort
    )


def _left_out(diagnosis: Diagnosis, errors: list[ConstraintResidual]) -> None:
    whole = _request(diagnosis).path_constraints
    gone = {id(e.constraint) for e in errors}
    kept = Constraints(
        tuple(c for c in whole.joints if id(c) not in gone),
        tuple(c for c in whole.positions if id(c) not in gone),
        tuple(c for c in whole.orientations if id(c) not in gone),
        whole.name,
        tuple(c for c in whole.visibilities if id(c) not in gone),
    )
    names = " and ".join(constraint_label(e.constraint) for e in errors)
    diagnosis.suggest(
        f"leave out the constraint on {names}", change_request, {"path_constraints": kept}, effort=np.inf
    )
