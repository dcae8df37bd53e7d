"""Diagnosis of a Cartesian path that stops before its last waypoint.

The diagnosis explains where and why the path stops, and finds the smallest change that completes it.
"""

from __future__ import annotations

import time
from dataclasses import replace
from itertools import islice

import numpy as np

from armcell.core import SE3, SO3, CartesianRequest, ErrorCode
from armcell.kinematics import IKSolver, ik_solver
from armcell.planning.diagnosis import text_format
from armcell.planning.diagnosis.changes import (
    change_request,
    change_start,
    change_waypoints,
    replace_by_free_motion,
)
from armcell.planning.diagnosis.constraints import diagnose_path_constraints
from armcell.planning.diagnosis.contacts import suggest_freeing_objects
from armcell.planning.diagnosis.diagnosis import CLOSE_TO_LIMIT, Diagnosis, report_limit_margins
from armcell.planning.diagnosis.nearest_free import ANGLES, DIRECTIONS, DISTANCES
from armcell.planning.diagnosis.unreachable_pose import explain_pose

BRANCHES = 24  # joint solutions of the start pose to try
HALVINGS = 6
DETOURS = (0.05, 0.1, 0.2, 0.4)  # [m] distances of detours from the stop
SHARE = 0.4  # share of the remaining time for the search of another last waypoint


def explain_cartesian_stop(diagnosis: Diagnosis) -> None:
    """Explain where and why a Cartesian path stops, and find changes with which it can be completed."""
    request, result = diagnosis.request, diagnosis.result
    assert isinstance(request, CartesianRequest)
    report_limit_margins(diagnosis)
    ik = ik_solver(diagnosis.scene.model, request.group, request.link)
    here = diagnosis.start_scene.frame_pose(ik.tip_link)
    number, pose = result.evidence.get("waypoint", 1) - 1, result.evidence.get("stops_at", here)
    _report_place(diagnosis, request, number, pose)
    diagnosis.contacts = [c for c in result.evidence.get("contacts", []) if c is not None]
    if result.code is ErrorCode.NO_IK_SOLUTION:
        _report_reach(diagnosis, request, ik)
    if result.path is not None:
        diagnosis.state = diagnosis.group_state(result.path.waypoints[-1])
    jumps = result.code is ErrorCode.PLANNING_FAILED and "joint" in result.evidence
    if "violations" in result.evidence:
        diagnose_path_constraints(diagnosis)
    # If smaller steps complete the line, the line is feasible as requested: try no other line.
    if not (jumps and _jump(diagnosis, request)):
        _other_start(diagnosis, request, ik, here)
        _smaller_turn(diagnosis, request, here)
        _aside(diagnosis, request, ik)
        _around(diagnosis, request, ik, number, pose)
    if diagnosis.contacts and result.path is not None:
        last = result.path.waypoints[-1]
        there = next(iter(ik.nearest(request.waypoints[-1], _full(diagnosis, last), diagnosis.rng, 4)), last)
        suggest_freeing_objects(diagnosis, [there, diagnosis.start], diagnosis.contacts, padded=True)
    if _can_stand(diagnosis, request, request.waypoints[-1], ik):
        diagnosis.suggest(
            "go there freely instead of on a straight line", replace_by_free_motion, effort=np.inf
        )
    _shorter(diagnosis, request, number, pose)


def _report_place(diagnosis: Diagnosis, request: CartesianRequest, number: int, pose: SE3) -> None:
    goal = request.waypoints[-1]
    meters, radians = pose.distance_to(goal)
    x, y, z = pose.translation
    diagnosis.add_finding(
        f"it stops at {diagnosis.result.fraction:.0%}, at ({x:.3f}, {y:.3f}, {z:.3f}) on the way to waypoint "
        f"{number + 1} of {len(request.waypoints)}; "
        f"{text_format.length(meters)} and {text_format.angle(radians)} are left"
    )
    diagnosis.data |= {"fraction": diagnosis.result.fraction, "stops_at": pose, "waypoint": number + 1}


def _report_reach(diagnosis: Diagnosis, request: CartesianRequest, ik: IKSolver) -> None:
    """Report whether the last waypoint of a Cartesian path is unreachable, or reachable but not along a
    straight line from where the path stops.
    """
    path = diagnosis.result.path
    q = diagnosis.start if path is None else path.waypoints[-1]
    found = explain_pose(diagnosis.start_scene, request.group, request.waypoints[-1], request.link)
    if not found.branches:
        diagnosis.add_finding(f"the last waypoint is out of reach: {found.summary}")
    else:
        free = sum(b.free for b in found.branches)
        diagnosis.add_finding(
            f"other joint solutions reach the last waypoint ({free} of {len(found.branches)} joint "
            "solutions are free), but not on a straight line from here"
        )
    margins = np.minimum(q - ik.lower, ik.upper - q)
    for k in np.flatnonzero(margins < CLOSE_TO_LIMIT):
        name = ik.joint_names[k]
        margin = text_format.joint_value(diagnosis.scene.model, name, margins[k])
        diagnosis.add_finding(f"there {name} is {margin} from its limit")
    evidence = diagnosis.result.evidence
    diagnosis.data["least_singular_value"] = evidence["least_singular_value"]
    if evidence["near_singularity"]:
        least = evidence["least_singular_value"]
        diagnosis.add_finding(f"there the arm is near a singularity (smallest singular value {least:.3f})")


def _jump(diagnosis: Diagnosis, request: CartesianRequest) -> bool:
    """Suggest smaller steps or a larger jump threshold if a joint jumps on a Cartesian path.

    Returns:
        whether smaller steps complete the path.
    """
    for k in range(1, 6):
        step = request.max_step / 2**k
        changed = replace(request, max_step=step)
        if diagnosis.succeeds(diagnosis.scene, changed) is not None:
            diagnosis.suggest(
                f"take steps of {text_format.length(step)}", change_request, {"max_step": step}, known=True
            )
            return True
    name = diagnosis.result.evidence["field"]
    for factor in (1.5, 2.0, 4.0, 10.0, 100.0):
        threshold = getattr(request, name) * factor
        if diagnosis.succeeds(diagnosis.scene, replace(request, **{name: threshold})) is not None:
            text = f"allow larger joint steps: {name} {threshold:.3g}"
            diagnosis.suggest(text, change_request, {name: threshold}, known=True)
            break
    return False


def _other_start(diagnosis: Diagnosis, request: CartesianRequest, ik: IKSolver, here: SE3) -> None:
    """Suggest starting a Cartesian path from another joint solution of the same start pose, from which the
    line is feasible.

    The solution is on another branch, or has another elbow position of a redundant arm.
    """
    tried = []
    for q in islice(ik.solutions(here, diagnosis.start_scene.positions, diagnosis.rng), BRANCHES):
        if np.abs(q - diagnosis.start).max() > 1e-3 and (
            not request.avoid_collisions or diagnosis.checker.is_free(q)
        ):
            tried.append(q)
    tried.sort(key=lambda q: float(np.linalg.norm(q - diagnosis.start)))
    diagnosis.data["other_starts"] = len(tried)
    for q in tried:
        state = diagnosis.group_state(q)
        if diagnosis.succeeds(diagnosis.scene, change_start(diagnosis.scene, request, state)[1]) is not None:
            step = text_format.joint_steps(diagnosis.scene.model, diagnosis.joint_names, q - diagnosis.start)
            diagnosis.nearest = state
            diagnosis.suggest(
                f"begin at the same pose with another joint solution: {step}",
                change_start,
                {"state": state},
                effort=float(np.linalg.norm(q - diagnosis.start)),
                known=True,
            )
            return
    diagnosis.add_finding(f"none of {len(tried)} other joint solutions of the start pose completes the line")


def _smaller_turn(diagnosis: Diagnosis, request: CartesianRequest, here: SE3) -> None:
    """Suggest a smaller tip rotation on the last line of a Cartesian path, with which the path is feasible.

    Bisection finds the largest such rotation. The position of the last waypoint does not change. There is no
    suggestion if the path fails even without this rotation.
    """
    before = [here, *request.waypoints][-2]
    goal = request.waypoints[-1]
    total = before.distance_to(goal)[1]
    if total < np.deg2rad(1.0):
        return

    def changed(share: float) -> tuple[SE3, ...]:
        rotation = before.interpolate(goal, share).rotation
        return (*request.waypoints[:-1], SE3(rotation, goal.translation))

    def completes(share: float) -> bool:
        return diagnosis.succeeds(diagnosis.scene, replace(request, waypoints=changed(share))) is not None

    if not completes(0.0):
        return
    low, high = 0.0, 1.0
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        low, high = (middle, high) if completes(middle) else (low, middle)
    text = f"turn {text_format.angle(low * total)} instead of {text_format.angle(total)}"
    diagnosis.suggest(
        text, change_waypoints, {"waypoints": changed(low)}, effort=(1 - low) * total, known=True
    )


def _aside(diagnosis: Diagnosis, request: CartesianRequest, ik: IKSolver) -> None:
    """Suggest a translation and a rotation of a Cartesian path's last waypoint that each make the path
    feasible. Each search tries 26 directions.
    """
    goal, rest = request.waypoints[-1], request.waypoints[:-1]

    def shifted(step: np.ndarray) -> SE3:
        return SE3(goal.rotation, goal.translation + step)

    def turned(step: np.ndarray) -> SE3:
        return SE3(goal.rotation @ SO3.exp(step), goal.translation)

    for sizes, pose, tell in (
        (DISTANCES[DISTANCES < 0.2], shifted, lambda v: f"move the last waypoint {text_format.offset(v)}"),
        (ANGLES[ANGLES < 1.0], turned, lambda v: f"turn the last waypoint {text_format.turn(v)}"),
    ):
        step = _first(diagnosis, request, rest, sizes, pose, ik)
        if step is not None:
            diagnosis.suggest(
                tell(step),
                change_waypoints,
                {"waypoints": (*rest, pose(step))},
                effort=float(np.linalg.norm(step)),
                known=True,
            )


def _first(diagnosis: Diagnosis, request: CartesianRequest, rest, sizes, pose, ik):
    """Find the smallest change (3,) to the goal of a Cartesian path that makes the whole line feasible.
    Return None if none is found.
    """
    until = time.monotonic() + SHARE * max(diagnosis.time_left, 0.0)
    for size in sizes:
        for direction in DIRECTIONS:
            if time.monotonic() > until:
                return None
            step = size * direction
            if not _can_stand(diagnosis, request, pose(step), ik):
                continue
            if (
                diagnosis.succeeds(diagnosis.scene, replace(request, waypoints=(*rest, pose(step))))
                is not None
            ):
                return _least(diagnosis, request, rest, step, pose)
    return None


def _least(diagnosis: Diagnosis, request: CartesianRequest, rest, step: np.ndarray, pose) -> np.ndarray:
    """Find by bisection the smallest translation or rotation (3,) of the last waypoint, in the direction of
    `step`, that makes the Cartesian path feasible.
    """
    low, high = 0.5, 1.0
    for _ in range(4):
        middle = (low + high) / 2
        found = diagnosis.succeeds(diagnosis.scene, replace(request, waypoints=(*rest, pose(middle * step))))
        low, high = (middle, high) if found is None else (low, middle)
    return high * step


def _around(diagnosis: Diagnosis, request: CartesianRequest, ik: IKSolver, number: int, stop: SE3) -> None:
    """Suggest an additional waypoint for a Cartesian path beside the pose at which the path stops."""
    if not _can_stand(diagnosis, request, request.waypoints[-1], ik):
        return
    until = time.monotonic() + SHARE * max(diagnosis.time_left, 0.0)
    for size in DETOURS:
        for direction in DIRECTIONS:
            if time.monotonic() > until:
                return
            by = SE3(stop.rotation, stop.translation + size * direction)
            waypoints = (*request.waypoints[:number], by, *request.waypoints[number:])
            if not _can_stand(diagnosis, request, by, ik):
                continue
            if diagnosis.succeeds(diagnosis.scene, replace(request, waypoints=waypoints)) is not None:
                text = f"go round by a waypoint {text_format.offset(size * direction)} of where it stops"
                diagnosis.suggest(text, change_waypoints, {"waypoints": waypoints}, effort=size, known=True)
                return


def _full(diagnosis: Diagnosis, q: np.ndarray) -> np.ndarray:
    """Return the joint positions (dof,) of the whole robot in which the group is at q (n,), for the diagnosis
    of a Cartesian path.
    """
    full = diagnosis.start_scene.positions.copy()
    full[diagnosis.columns] = q
    return full


def _can_stand(diagnosis: Diagnosis, request: CartesianRequest, pose: SE3, ik: IKSolver) -> bool:
    """Return whether the arm can reach a pose of a Cartesian path without collision.
    This test is faster than testing the whole line.
    """
    some = islice(ik.solutions(pose, diagnosis.start_scene.positions, diagnosis.rng), 8)
    return any(not request.avoid_collisions or diagnosis.checker.is_free(q) for q in some)


def _shorter(diagnosis: Diagnosis, request: CartesianRequest, number: int, pose: SE3) -> None:
    """Suggest a shorter Cartesian path, which ends where the arm cannot follow the requested line further."""
    if diagnosis.result.path is None or diagnosis.result.fraction <= 0:
        return
    waypoints = (*request.waypoints[:number], pose)
    meters, radians = pose.distance_to(request.waypoints[-1])
    left = f"{text_format.length(meters)} and {text_format.angle(radians)}"
    diagnosis.suggest(
        f"end where it stops, {left} before the goal",
        change_waypoints,
        {"waypoints": waypoints},
        effort=np.inf,
    )
