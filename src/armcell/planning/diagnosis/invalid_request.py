"""Diagnosis of invalid requests: names that do not exist, impossible numbers."""

from __future__ import annotations

import difflib
from dataclasses import replace

import numpy as np

from armcell.core import (
    CartesianRequest,
    ErrorCode,
    InputError,
    JointGoal,
    JointState,
    NamedGoal,
    PlanRequest,
    PlanResult,
    PoseGoal,
    UnknownNameError,
)
from armcell.planning.diagnosis.changes import change_goal, change_request, change_waypoints
from armcell.planning.diagnosis.diagnosis import Diagnosis
from armcell.planning.planners.registry import normalized_planner_id

CODES = (  # kind of name, MoveIt's error code
    ("planning group", ErrorCode.INVALID_GROUP_NAME),
    ("link", ErrorCode.INVALID_LINK_NAME),
    ("object", ErrorCode.INVALID_OBJECT_NAME),
    ("frame", ErrorCode.FRAME_TRANSFORM_FAILURE),
    ("named state", ErrorCode.INVALID_GOAL_CONSTRAINTS),
    ("joint", ErrorCode.INVALID_ROBOT_STATE),
    ("actuated joint", ErrorCode.INVALID_ROBOT_STATE),
)
MOVEIT_SCALING = 0.1  # MoveIt's own default
LIKELY_PERCENT = 100.0


def code_of(error: InputError) -> ErrorCode:
    """Return MoveIt's error code for an unknown name in a request, such as the name of a link.
    Return FAILURE for other errors.
    """
    if isinstance(error, UnknownNameError):
        return next((code for kind, code in CODES if error.kind.startswith(kind)), ErrorCode.FAILURE)
    return ErrorCode.FAILURE


def diagnose_invalid_request(diagnosis: Diagnosis, error: InputError) -> None:
    """Diagnose misuse in an invalid request: suggest known names similar to an unknown one, and numbers
    within their range.
    """
    diagnosis.data["error"] = str(error)
    if isinstance(error, UnknownNameError):
        diagnosis.data |= {"kind": error.kind, "name": str(error.name), "known": error.known}
        wrong = str(error.name)
        likely = _like(wrong, error.known)
        if not any(_rename(diagnosis, wrong, name) for name in likely or error.known[:3]) and likely:
            _rename(diagnosis, wrong, likely[0], anyway=True)
        return
    _numbers(diagnosis)
    if (
        isinstance(diagnosis.request, PlanRequest)
        and diagnosis.request.torque_limits
        and diagnosis.request.jerk_limits
    ):
        diagnosis.suggest("ask for torque limits only", change_request, {"jerk_limits": False})
        diagnosis.suggest("ask for jerk limits only", change_request, {"torque_limits": False})
    _goal_without_tip(diagnosis)


def _like(name: str, known: list[str]) -> list[str]:
    """List the known names that are similar to an unknown name in an invalid request, most similar name
    first.
    """
    folded = {k.lower(): k for k in known}
    like = difflib.get_close_matches(name.lower(), folded, n=3, cutoff=0.5)
    within = [k for k in known if name.lower() in k.lower() and k.lower() not in like]
    return [*(folded[k] for k in like), *within[:3]]


def _rename(diagnosis: Diagnosis, wrong: str, right: str, anyway: bool = False) -> bool:
    """Suggest replacing a wrong name in an invalid planning request with an existing name."""
    request = diagnosis.request
    fields = [f for f in ("group", "link", "planner_id", "pipeline_id") if getattr(request, f, None) == wrong]
    planner = getattr(request, "planner_id", "")
    if not fields and planner and normalized_planner_id(planner) == wrong:
        fields = ["planner_id"]
    if fields:
        return diagnosis.suggest(
            f"name {right!r} as {fields[0]}", change_request, {fields[0]: right}, anyway=anyway
        )
    if request.start is not None and wrong in request.start.joint_names:
        start = _renamed(request.start, wrong, right)
        return start is not None and diagnosis.suggest(
            f"name joint {right!r} in the start", change_request, {"start": start}, anyway=anyway
        )
    for number, goal in enumerate(getattr(request, "goals", ())):
        changed = None
        if isinstance(goal, NamedGoal) and goal.name == wrong:
            changed = NamedGoal(right)
        elif isinstance(goal, PoseGoal) and goal.link == wrong:
            changed = replace(goal, link=right)
        elif isinstance(goal, JointGoal) and wrong in goal.state.joint_names:
            state = _renamed(goal.state, wrong, right)
            changed = replace(goal, state=state) if state is not None else None
        if changed is not None:
            return diagnosis.suggest(
                f"name {right!r} instead of {wrong!r} in the goal",
                change_goal,
                {"number": number, "goal": changed},
                anyway=anyway,
            )
    return False


def _renamed(state: JointState, wrong: str, right: str) -> JointState | None:
    if right in state.joint_names:
        return None
    return JointState(tuple(right if n == wrong else n for n in state.joint_names), state.positions)


def _numbers(diagnosis: Diagnosis) -> None:
    """Suggest valid numbers for an invalid request: scaling factors, times and step sizes within their
    ranges.
    """
    request = diagnosis.request
    changes: dict[str, float] = {}
    for name in ("velocity_scaling", "acceleration_scaling"):
        value = getattr(request, name)
        if not (np.isfinite(value) and 0 < value <= 1):
            percent = np.isfinite(value) and 1 < value <= LIKELY_PERCENT
            changes[name] = value / 100 if percent and value > 2 else 1.0 if percent else MOVEIT_SCALING
            if percent and value > 2:
                diagnosis.add_finding(
                    f"{name} is a share of the limits: {value:g} percent are {value / 100:g}"
                )
    positive = {"planning_time": 5.0, "max_step": 0.005, "max_cartesian_speed": None}
    for name, usual in positive.items():
        value = getattr(request, name, None)
        if value is not None and not (np.isfinite(value) and value > 0):
            changes[name] = usual  # type: ignore[assignment]
    if changes:
        text = ", ".join(f"{k} {'not given' if v is None else f'{v:g}'}" for k, v in changes.items())
        diagnosis.suggest(f"give {text}", change_request, changes, anyway=True)
    if isinstance(request, CartesianRequest) and not request.waypoints:
        tip = request.link or diagnosis.scene.model.group(request.group).tip_link
        if tip is not None:
            up = diagnosis.start_scene.frame_pose(tip).shifted(z=0.05)
            diagnosis.suggest("give a waypoint, say 50 mm up", change_waypoints, {"waypoints": (up,)})


def _goal_without_tip(diagnosis: Diagnosis) -> None:
    """Suggest another planning group if a request has a pose goal for a group without a tip link."""
    request, model = diagnosis.request, diagnosis.scene.model
    group = model.groups.get(request.group)
    if group is None or group.tip_link is not None:
        return
    for name, other in model.groups.items():
        fits = other.tip_link is not None and set(other.joint_names) <= set(group.joint_names)
        if fits and diagnosis.suggest(
            f"plan for group {name!r}, which has a tip", change_request, {"group": name}
        ):
            return


def missing_result(error: InputError) -> PlanResult:
    """Create the failed planning result for an invalid request from the `InputError` that it raised."""
    return PlanResult(code_of(error), str(error))
