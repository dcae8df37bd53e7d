"""Several motions one after the other as one, with blends instead of stops where a radius is given."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from armcell.collision.kernel.checker import KernelChecker
from armcell.core import (
    ErrorCode,
    InputError,
    JointPath,
    JointState,
    JointTrajectory,
    Outcome,
    PlanRequest,
    PlanResult,
    PoseGoal,
    SequenceRequest,
)
from armcell.planning.adapters import normalized_adapters
from armcell.planning.finish import clearance_along
from armcell.planning.industrial.blend import Blend, blended
from armcell.planning.industrial.explain import explain_blend
from armcell.planning.industrial.follow import solver_for
from armcell.planning.industrial.limits import within_limits
from armcell.planning.industrial.profile import CLOSE
from armcell.planning.industrial.proof import proven
from armcell.planning.pipeline import plan
from armcell.planning.placed import Placed, positioned
from armcell.planning.problem import INDUSTRIAL, normalized_pipeline_id
from armcell.planning.question import ask
from armcell.planning.speed import peak_speed
from armcell.planning.workspace import Workspace
from armcell.scene import PlanningScene

Array = NDArray[np.float64]

PLANNER_ID = "sequence"
SPEED_ROUNDING = 1.001


@dataclass(frozen=True, eq=False)
class _Item:
    """One motion that was planned, and the scene at its begin."""

    scene: PlanningScene
    request: PlanRequest
    radius: float  # [m] of the blend at its end
    result: PlanResult
    trajectory: JointTrajectory


def plan_sequence(
    scene: PlanningScene, sequence: SequenceRequest, cancel: threading.Event | None = None
) -> PlanResult:
    """One certified motion through all requests of a sequence, each beginning where the one before ends.

    Any pipeline may be named in the requests. Between motions of different groups the robot stands still;
    the trajectory has the joints of all groups.

    Returns:
        SUCCESS with path and trajectory; in the evidence `items` (planner, begin and end [s] of each) and
        `blends` (begin and end [s]). Else the code, message and evidence of the motion that fails, which
        `evidence["item"]` counts from 0, or of the blend after it.
    Raises:
        InputError: no request, a radius below 0 or after the last one or at a change of the group, a start
            state in another than the first request of its group; and whatever `plan` raises.
    """
    began = time.monotonic()
    _check(scene, sequence)
    items: list[_Item] = []
    at = scene
    for number, (request, radius) in enumerate(sequence.items):
        result = plan(at, request, cancel)
        if not result.ok or result.trajectory is None:
            text = f"motion {number + 1} of {len(sequence.items)}: {result.message}"
            return replace(
                result, message=text, evidence={**result.evidence, "item": number}, path=None,
                planning_time=time.monotonic() - began,
            )  # fmt: skip
        items.append(_Item(at, request, float(radius), result, result.trajectory))
        at = positioned(at, result.trajectory.joint_names, result.trajectory.positions[-1])
    blends = _blends(items)
    if isinstance(blends, Outcome):
        return PlanResult(
            blends.code,
            blends.message,
            blends.evidence,
            planner_id=PLANNER_ID,
            planning_time=time.monotonic() - began,
            explainer=partial(explain_blend, scene, sequence, blends, plan_sequence),
        )
    trajectory, evidence = _joined(scene, items, blends)
    return PlanResult(
        ErrorCode.SUCCESS,
        "; ".join(item.result.message for item in items if item.result.message),
        evidence,
        path=JointPath(trajectory.joint_names, trajectory.positions),
        trajectory=trajectory,
        planner_id=PLANNER_ID,
        planning_time=time.monotonic() - began,
        clearance=partial(_clearance, scene, trajectory),
    )


def _check(scene: PlanningScene, sequence: SequenceRequest) -> None:
    """All that can be told to be wrong before anything is planned."""
    items = sequence.items
    if not items:
        raise InputError("the sequence has no requests")
    seen = set()
    for number, (request, radius) in enumerate(items):
        name = f"request {number + 1} of {len(items)}"
        if not (np.isfinite(radius) and radius >= 0):
            raise InputError(f"{name} has blend radius {radius:g} m, it must be zero or positive")
        ask(scene, request)
        if "timing" not in normalized_adapters(request.adapters):
            raise InputError(f"{name} leaves out adapter 'timing', which a sequence needs")
        if request.start is not None and request.group in seen:
            raise InputError(
                f"{name} has a start state, but begins where the one before of {request.group!r} ends",
                cure="only the first request of a group may have one",
            )
        seen.add(request.group)
    if items[-1][1] != 0:
        raise InputError(f"the last request has blend radius {items[-1][1]:g} m, it must be 0")
    for number, ((a, radius), (b, _)) in enumerate(pairwise(items)):
        if radius > 0 and a.group != b.group:
            raise InputError(
                f"request {number + 1} has blend radius {radius:g} m, but the next one moves "
                f"group {b.group!r} instead of {a.group!r}",
                cure="give radius 0 where the group changes",
            )
        if radius > 0:
            _placed(scene, a)  # a group without a tip raises
            _check_kept(a, f"request {number + 1}")
            _check_kept(b, f"request {number + 2}")


def _check_kept(request: PlanRequest, name: str) -> None:
    """Raises InputError where a motion keeps what a blend into or out of it would not."""
    told = normalized_pipeline_id(request.pipeline_id) == INDUSTRIAL  # its constraints are CIRC's point
    kept = {
        "path constraints": bool(request.path_constraints) and not told,
        "torque_limits": request.torque_limits,
        "jerk_limits": request.jerk_limits,
    }
    for what, asked in kept.items():
        if asked:
            raise InputError(f"{name} has {what}, which a blend does not keep", cure="give blend radius 0")


def _placed(scene: PlanningScene, request: PlanRequest) -> Placed:
    """What the radius is for: the link of the motion's goal, or the group's tip."""
    named = [goal.link for goal in request.goals if isinstance(goal, PoseGoal)]
    return Placed(scene, request.group, named[0] if named else None)


def _blends(items: list[_Item]) -> list[Blend | None] | Outcome:
    """Those after each motion but the last, proven; or what is wrong with one of them."""
    if (overlap := _overlap(items)) is not None:
        return overlap
    blends: list[Blend | None] = []
    for number, (first, second) in enumerate(pairwise(items)):
        if first.radius == 0:
            blends.append(None)
            continue
        made = _blend(first, second, number)
        if isinstance(made, Outcome):
            between = f"the blend between motions {number + 1} and {number + 2}"
            evidence = {**made.evidence, "item": number, "radius": first.radius}
            return replace(made, message=f"{between}: {made.message}", evidence=evidence)
        before = blends[-1].joins if blends and blends[-1] else 0.0
        if made.leaves < before:
            text = f"motion {number + 1} is left before the blend with the one before it has ended"
            return Outcome(
                ErrorCode.INVALID_MOTION_PLAN, text, {"item": number, "radius": first.radius}
            )  # arcs and joint motions may come back to where they were
        blends.append(made)
    return blends


def _overlap(items: list[_Item]) -> Outcome | None:
    """Whether the spheres of two blends after each other meet."""
    for number, (a, b) in enumerate(pairwise(items)):
        if a.radius == 0 or b.radius == 0:
            continue
        placed = _placed(b.scene, b.request)
        corners = [placed.pose(item.trajectory.positions[-1]).translation for item in (a, b)]
        apart = float(np.linalg.norm(corners[1] - corners[0]))
        if apart <= a.radius + b.radius:
            text = (
                f"the blend radii of motions {number + 1} ({a.radius * 1000:.0f} mm) and {number + 2} "
                f"({b.radius * 1000:.0f} mm) overlap: their ends are {apart * 1000:.0f} mm apart"
            )
            return Outcome(ErrorCode.INVALID_MOTION_PLAN, text, {"item": number, "apart": apart})
    return None


def _blend(first: _Item, second: _Item, number: int) -> Blend | Outcome:
    placed = _placed(second.scene, first.request)
    ik = solver_for(placed, first.request.group)
    made = blended(first.trajectory, second.trajectory, first.radius, placed, ik)
    if isinstance(made, Outcome):
        return made
    beyond = within_limits(second.scene.model, made.trajectory, None)
    if beyond is not None:
        return beyond
    checker = KernelChecker(second.scene, first.trajectory.joint_names)
    checker.relax_margins(second.trajectory.positions[0])
    points = proven(checker, made.curve, placed, "it touches")
    if isinstance(points, Outcome):
        return points
    for item in (first, second):
        if (why := _forbidden(item, made, points)) is not None:
            return why
    return made


def _forbidden(item: _Item, made: Blend, points: Array) -> Outcome | None:
    """Whether a blend breaks what one of its motions is bound to: a speed of the tip, a workspace."""
    request, speed = item.request, item.request.max_cartesian_speed
    if speed is not None:
        placed = Placed(item.scene, request.group, request.speed_link)
        peak = peak_speed(made.trajectory, placed)
        if peak > speed * SPEED_ROUNDING:
            text = f"{placed.name} would move at {peak:.3g} m/s, max_cartesian_speed is {speed:.3g} m/s"
            return Outcome(ErrorCode.PLANNING_FAILED, text, {"speed": peak})
    if request.workspace is not None:
        workspace = Workspace(item.scene, request)
        if (q := workspace.left_at(points)) is not None:
            return Outcome(ErrorCode.INVALID_MOTION_PLAN, workspace.describe(q), {"positions": q})
    return None


def _joined(
    scene: PlanningScene, items: list[_Item], blends: list[Blend | None]
) -> tuple[JointTrajectory, dict]:
    """All motions with their blends as one trajectory, and when each begins and ends in it [s]."""
    model = scene.model
    moved = {name for item in items for name in item.trajectory.joint_names}
    names = tuple(name for name in model.joint_names if name in moved)
    state = JointState(model.joint_names, items[0].scene.positions)
    for item in items[::-1]:  # where each group begins: its first motion's start counts
        state = state.updated(item.trajectory.start)
    at = state.reindexed(names).positions
    rows: list[tuple[float, Array, Array, Array]] = [(0.0, at, np.zeros(len(names)), np.zeros(len(names)))]
    clock, evidence = 0.0, {"items": [], "blends": []}
    for number, item in enumerate(items):
        blend = blends[number] if number < len(blends) else None
        before = blends[number - 1] if number else None
        begin = before.joins if before else 0.0
        end = blend.leaves if blend else item.trajectory.duration
        started = clock
        clock = _append(rows, names, item.trajectory, begin, end, clock)
        evidence["items"].append(
            {"planner_id": item.result.planner_id, "begin": float(started), "end": float(clock)}
        )
        if blend is not None:
            started = clock
            clock = _append(rows, names, blend.trajectory, 0.0, blend.trajectory.duration, clock)
            evidence["blends"].append({"begin": float(started), "end": float(clock)})
    times, q, v, a = (np.array(column) for column in zip(*rows, strict=True))
    return JointTrajectory(names, times, q, v, a), evidence


def _append(
    rows: list, names: tuple[str, ...], trajectory: JointTrajectory, begin: float, end: float, clock: float
) -> float:
    """Add the points after `begin` up to `end` [s of the trajectory]; returns the time at the last one."""
    columns = [names.index(name) for name in trajectory.joint_names]
    inner = [t for t in trajectory.times if begin + CLOSE < t < end - CLOSE]
    for t in (*inner, *([end] if end > begin else [])):
        q, v, a = rows[-1][1].copy(), np.zeros(len(names)), np.zeros(len(names))
        if t == trajectory.duration:  # `sample` is at rest there, a blend is not
            at = trajectory.positions[-1], trajectory.velocities[-1], trajectory.accelerations[-1]  # type: ignore
        else:
            at = trajectory.sample(t)
        q[columns], v[columns], a[columns] = at
        rows.append((clock + t - begin, q, v, a))
    return clock + max(end - begin, 0.0)


def _clearance(scene: PlanningScene, trajectory: JointTrajectory) -> float:
    start = positioned(scene, trajectory.joint_names, trajectory.positions[0])
    return clearance_along(KernelChecker(start, trajectory.joint_names), trajectory)
