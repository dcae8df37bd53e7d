"""A straight line that stops: where, why, and the nearest change that would complete it."""

from __future__ import annotations

import time
from dataclasses import replace
from itertools import islice

import numpy as np

from armcell.core import SE3, SO3, CartesianRequest, ErrorCode
from armcell.kinematics import IKSolver, ik_solver
from armcell.planning.explanation import words
from armcell.planning.explanation.case import CLOSE_TO_LIMIT, Case, tell_margins
from armcell.planning.explanation.changes import change_request, change_start, change_waypoints, go_freely
from armcell.planning.explanation.constraints import too_constrained
from armcell.planning.explanation.contacts import free_objects
from armcell.planning.explanation.nearest import ANGLES, DIRECTIONS, DISTANCES
from armcell.planning.explanation.pose import explain_pose

BRANCHES = 24  # of the start pose that are tried
HALVINGS = 6
DETOURS = (0.05, 0.1, 0.2, 0.4)  # [m] beside the place where it stops
SHARE = 0.4  # of the time left goes to the search for another last waypoint


def line_stops(case: Case) -> None:
    request, result = case.request, case.result
    assert isinstance(request, CartesianRequest)
    tell_margins(case)
    ik = ik_solver(case.scene.model, request.group, request.link)
    here = case.started.frame_pose(ik.tip_link)
    number, pose = result.evidence.get("waypoint", 1) - 1, result.evidence.get("stops_at", here)
    _tell_place(case, request, number, pose)
    case.contacts = [c for c in result.evidence.get("contacts", []) if c is not None]
    if result.code is ErrorCode.NO_IK_SOLUTION:
        _tell_reach(case, request, ik)
    if result.path is not None:
        case.state = case.group_state(result.path.waypoints[-1])
    if result.code is ErrorCode.PLANNING_FAILED and "joint" in result.evidence:
        _jump(case, request)
    if "violations" in result.evidence:
        too_constrained(case)
    _other_start(case, request, ik, here)
    _smaller_turn(case, request, here)
    _aside(case, request, ik)
    _around(case, request, ik, number, pose)
    if case.contacts and result.path is not None:
        last = result.path.waypoints[-1]
        there = next(iter(ik.nearest(request.waypoints[-1], _full(case, last), case.rng, 4)), last)
        free_objects(case, [there, case.start], case.contacts, padded=True)
    if _can_stand(case, request, request.waypoints[-1], ik):
        case.suggest("go there freely instead of on a straight line", go_freely, effort=np.inf)
    _shorter(case, request, number, pose)


def _tell_place(case: Case, request: CartesianRequest, number: int, pose: SE3) -> None:
    goal = request.waypoints[-1]
    metres, radians = pose.distance_to(goal)
    x, y, z = pose.translation
    case.say(
        f"it stops at {case.result.fraction:.0%}, at ({x:.3f}, {y:.3f}, {z:.3f}) on the way to waypoint "
        f"{number + 1} of {len(request.waypoints)}; "
        f"{words.length(metres)} and {words.angle(radians)} are left"
    )
    case.data |= {"fraction": case.result.fraction, "stops_at": pose, "waypoint": number + 1}


def _tell_reach(case: Case, request: CartesianRequest, ik: IKSolver) -> None:
    """Whether the last waypoint is out of reach, or only this way to it; and how singular the arm stands."""
    path = case.result.path
    q = case.start if path is None else path.waypoints[-1]
    found = explain_pose(case.started, request.group, request.waypoints[-1], request.link)
    if not found.branches:
        case.say(f"the last waypoint is out of reach: {found.summary}")
    else:
        free = sum(b.free for b in found.branches)
        case.say(
            f"the last waypoint can be reached with the arm otherwise ({free} of {len(found.branches)} joint "
            "solutions are free), but not on a straight line from here"
        )
    margins = np.minimum(q - ik.lower, ik.upper - q)
    for k in np.flatnonzero(margins < CLOSE_TO_LIMIT):
        name = ik.joint_names[k]
        case.say(f"there {name} is {words.joint_value(case.scene.model, name, margins[k])} from its limit")
    evidence = case.result.evidence
    case.data["least_singular_value"] = evidence["least_singular_value"]
    if evidence["near_singularity"]:
        least = evidence["least_singular_value"]
        case.say(f"there the arm is near a singularity (smallest singular value {least:.3f})")


def _jump(case: Case, request: CartesianRequest) -> None:
    """A threshold below what an ordinary step takes, or steps too long."""
    for k in range(1, 6):
        step = request.max_step / 2**k
        changed = replace(request, max_step=step)
        if case.succeeds(case.scene, changed) is not None:
            case.suggest(
                f"take steps of {words.length(step)}", change_request, {"max_step": step}, known=True
            )
            return
    name = case.result.evidence["field"]
    for factor in (1.5, 2.0, 4.0, 10.0, 100.0):
        threshold = getattr(request, name) * factor
        if case.succeeds(case.scene, replace(request, **{name: threshold})) is not None:
            text = f"allow larger joint steps: {name} {threshold:.3g}"
            case.suggest(text, change_request, {name: threshold}, known=True)
            return


def _other_start(case: Case, request: CartesianRequest, ik: IKSolver, here: SE3) -> None:
    """The same start pose with the arm otherwise: another branch, or, of a redundant arm, another elbow."""
    tried = []
    for q in islice(ik.solutions(here, case.started.positions, case.rng), BRANCHES):
        if np.abs(q - case.start).max() > 1e-3 and (not request.avoid_collisions or case.checker.is_free(q)):
            tried.append(q)
    tried.sort(key=lambda q: float(np.linalg.norm(q - case.start)))
    case.data["other_starts"] = len(tried)
    for q in tried:
        state = case.group_state(q)
        if case.succeeds(case.scene, change_start(case.scene, request, state)[1]) is not None:
            step = words.joint_steps(case.scene.model, case.joint_names, q - case.start)
            case.nearest = state
            case.suggest(
                f"begin at the same pose with the arm otherwise: {step}",
                change_start,
                {"state": state},
                effort=float(np.linalg.norm(q - case.start)),
                known=True,
            )
            return
    case.say(f"none of {len(tried)} other ways to stand at the start pose completes the line")


def _smaller_turn(case: Case, request: CartesianRequest, here: SE3) -> None:
    """The largest part of the last rotation with which the line is completed."""
    before = [here, *request.waypoints][-2]
    goal = request.waypoints[-1]
    total = before.distance_to(goal)[1]
    if total < np.deg2rad(1.0):
        return

    def changed(share: float) -> tuple[SE3, ...]:
        rotation = before.interpolate(goal, share).rotation
        return (*request.waypoints[:-1], SE3(rotation, goal.translation))

    def completes(share: float) -> bool:
        return case.succeeds(case.scene, replace(request, waypoints=changed(share))) is not None

    if not completes(0.0):
        return
    low, high = 0.0, 1.0
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        low, high = (middle, high) if completes(middle) else (low, middle)
    text = f"turn {words.angle(low * total)} instead of {words.angle(total)}"
    case.suggest(text, change_waypoints, {"waypoints": changed(low)}, effort=(1 - low) * total, known=True)


def _aside(case: Case, request: CartesianRequest, ik: IKSolver) -> None:
    """The last waypoint moved a little, then turned a little, in 26 directions."""
    goal, rest = request.waypoints[-1], request.waypoints[:-1]

    def shifted(step: np.ndarray) -> SE3:
        return SE3(goal.rotation, goal.translation + step)

    def turned(step: np.ndarray) -> SE3:
        return SE3(goal.rotation @ SO3.exp(step), goal.translation)

    for sizes, pose, tell in (
        (DISTANCES[DISTANCES < 0.2], shifted, lambda v: f"move the last waypoint {words.offset(v)}"),
        (ANGLES[ANGLES < 1.0], turned, lambda v: f"turn the last waypoint {words.turn(v)}"),
    ):
        step = _first(case, request, rest, sizes, pose, ik)
        if step is not None:
            case.suggest(
                tell(step),
                change_waypoints,
                {"waypoints": (*rest, pose(step))},
                effort=float(np.linalg.norm(step)),
                known=True,
            )


def _first(case: Case, request: CartesianRequest, rest, sizes, pose, ik):
    """The smallest change (3,) of the goal with which the line is completed, or None."""
    until = time.monotonic() + SHARE * max(case.time_left, 0.0)
    for size in sizes:
        for direction in DIRECTIONS:
            if time.monotonic() > until:
                return None
            step = size * direction
            if not _can_stand(case, request, pose(step), ik):
                continue
            if case.succeeds(case.scene, replace(request, waypoints=(*rest, pose(step)))) is not None:
                return _least(case, request, rest, step, pose)
    return None


def _least(case: Case, request: CartesianRequest, rest, step: np.ndarray, pose) -> np.ndarray:
    """As little of a change (3,) as completes the line, between half of it and all of it."""
    low, high = 0.5, 1.0
    for _ in range(4):
        middle = (low + high) / 2
        found = case.succeeds(case.scene, replace(request, waypoints=(*rest, pose(middle * step))))
        low, high = (middle, high) if found is None else (low, middle)
    return high * step


def _around(case: Case, request: CartesianRequest, ik: IKSolver, number: int, stop: SE3) -> None:
    """One more waypoint, beside the place where it stops."""
    if not _can_stand(case, request, request.waypoints[-1], ik):
        return
    until = time.monotonic() + SHARE * max(case.time_left, 0.0)
    for size in DETOURS:
        for direction in DIRECTIONS:
            if time.monotonic() > until:
                return
            by = SE3(stop.rotation, stop.translation + size * direction)
            waypoints = (*request.waypoints[:number], by, *request.waypoints[number:])
            if not _can_stand(case, request, by, ik):
                continue
            if case.succeeds(case.scene, replace(request, waypoints=waypoints)) is not None:
                text = f"go round by a waypoint {words.offset(size * direction)} of where it stops"
                case.suggest(text, change_waypoints, {"waypoints": waypoints}, effort=size, known=True)
                return


def _full(case: Case, q: np.ndarray) -> np.ndarray:
    """All joints (dof,) with the group's at q (n,)."""
    full = case.started.positions.copy()
    full[case.columns] = q
    return full


def _can_stand(case: Case, request: CartesianRequest, pose: SE3, ik: IKSolver) -> bool:
    """Whether any free configuration is at the pose at all: cheaper than a line."""
    some = islice(ik.solutions(pose, case.started.positions, case.rng), 8)
    return any(not request.avoid_collisions or case.checker.is_free(q) for q in some)


def _shorter(case: Case, request: CartesianRequest, number: int, pose: SE3) -> None:
    """The part that can be done, as a request of its own."""
    if case.result.path is None or case.result.fraction <= 0:
        return
    waypoints = (*request.waypoints[:number], pose)
    metres, radians = pose.distance_to(request.waypoints[-1])
    left = f"{words.length(metres)} and {words.angle(radians)}"
    case.suggest(
        f"end where it stops, {left} before the goal",
        change_waypoints,
        {"waypoints": waypoints},
        effort=np.inf,
    )
