"""Planning of a sequence of motions as one trajectory, with blends instead of stops.

A blend follows MoveIt's transition window: inside a sphere around the corner both motions run at once, and a
quintic of time moves the pose from one motion to the other (trajectory_blender_transition_window.cpp). The
motion that is longer inside the sphere sets the window's length; the end of the other motion waits in the
corner.
"""

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
from armcell.kinematics import IKSolver
from armcell.planning.adapters import normalize_adapter_names
from armcell.planning.certify import clearance_along
from armcell.planning.diagnosis.pilz import explain_blend
from armcell.planning.moved_frame import MovedFrame, peak_cartesian_speed, with_joint_positions
from armcell.planning.pilz.paths import JointSpline, check_joint_limits, prove_motion_free, solver_for
from armcell.planning.pilz.velocity_profile import CLOSE, SAMPLE_TIME
from armcell.planning.pipeline import plan
from armcell.planning.planners.registry import PILZ, normalized_pipeline_id
from armcell.planning.request import Workspace, validate_request
from armcell.scene import PlanningScene
from armcell.timing import (
    concatenate_trajectories,
    stationary_trajectory,
    trajectory_section,
    with_resting_joints,
)

Array = NDArray[np.float64]

GRID = 0.002  # [s] between inverse kinematics solutions
BISECTIONS = 40


@dataclass(frozen=True, eq=False)
class Blend:
    """Blend between two consecutive motions of a sequence.

    The blend replaces the end of the first motion and the beginning of the second motion.

    Attributes:
        leaves: time [s] in the first motion at which the blend begins.
        joins: time [s] in the second motion at which the blend ends.
        curve: joint curve over the window's time [s].
    """

    leaves: float
    joins: float
    curve: JointSpline
    trajectory: JointTrajectory


def blend_motions(
    first: JointTrajectory, second: JointTrajectory, radius: float, moved_frame: MovedFrame, ik: IKSolver
) -> Blend | Outcome:
    """Blend one motion of a sequence into the next, inside a sphere of `radius` [m] around the corner between
    them.
    """
    corner = moved_frame.pose(first.positions[-1]).translation

    def outside(trajectory: JointTrajectory, t: float) -> bool:
        at = moved_frame.pose(trajectory.sample(t)[0]).translation
        return bool(np.linalg.norm(at - corner) > radius)

    entering = [t for t in first.times if outside(first, t)]
    leaving = [t for t in second.times if outside(second, t)]
    if not entering or not leaving:
        which = "first" if not entering else "second"
        text = f"the blend radius of {radius * 1000:.0f} mm is too large: the {which} motion is all inside it"
        return Outcome(ErrorCode.INVALID_MOTION_PLAN, text, {"radius": radius})
    leaves = _border(lambda t: outside(first, t), entering[-1], first.duration)
    joins = _border(lambda t: outside(second, t), leaving[0], 0.0)
    return _window(first, second, leaves, joins, moved_frame, ik)


def _border(outside, far: float, near: float) -> float:
    """Find the time, between two given times, at which the tip crosses the sphere around a blend of a
    sequence.
    """
    for _ in range(BISECTIONS):
        middle = (far + near) / 2
        far, near = (middle, near) if outside(middle) else (far, middle)
    return far


def _window(
    first: JointTrajectory,
    second: JointTrajectory,
    leaves: float,
    joins: float,
    moved_frame: MovedFrame,
    ik: IKSolver,
) -> Blend | Outcome:
    duration = max(first.duration - leaves, joins)
    count = max(int(np.ceil(duration / GRID)), 8)
    moments = np.linspace(0.0, duration, count + 1)
    points = []
    for t in moments:
        qa, qb = first.sample(leaves + t)[0], second.sample(t - (duration - joins))[0]
        s = t / duration
        share = s**3 * (10.0 + s * (6.0 * s - 15.0))
        pose = moved_frame.pose(qa).interpolate(moved_frame.pose(qb), share)
        q = moved_frame.full(qa + share * (qb - qa))  # near the solution, and on it at both ends
        meters, radians, ok = ik.descend(q, moved_frame.link_target(pose))
        if not ok:
            text = f"out of reach or singular ({meters * 1000:.1f} mm, {np.rad2deg(radians):.1f} deg short)"
            return Outcome(ErrorCode.NO_IK_SOLUTION, text, {"joints_at_limit": ik.at_limit(q[ik.columns])})
        points.append(q[ik.columns].copy())
    (qa, va, aa), (qb, vb, ab) = first.sample(leaves), second.sample(joins)
    points[0], points[-1] = qa, qb
    curve = JointSpline(moments, np.array(points), np.array([va, vb]))
    times = np.linspace(0.0, duration, max(int(np.ceil(duration / SAMPLE_TIME)), 4) + 1)
    q, v, a = curve.at(times)
    a[0], a[-1] = aa, ab  # the window's weights begin and end with zero speed and acceleration
    return Blend(leaves, joins, curve, JointTrajectory(first.joint_names, times, q, v, a))


PLANNER_ID = "sequence"
SPEED_ROUNDING = 1.001


@dataclass(frozen=True, eq=False)
class _Item:
    """Planned motion in a sequence of PTP, LIN and CIRC motions, with the scene at its beginning."""

    scene: PlanningScene
    request: PlanRequest
    radius: float  # [m] blend radius at the end of the motion
    result: PlanResult
    trajectory: JointTrajectory


def plan_sequence(
    scene: PlanningScene, sequence: SequenceRequest, cancel: threading.Event | None = None
) -> PlanResult:
    """Plan a sequence of motions, with optional blends between them, as one certified motion.

    Requests may use any pipeline. The robot stops between motions of different groups; the trajectory has
    the joints of all groups.

    Returns:
        SUCCESS with path and trajectory; in the evidence `items` (planner, begin and end [s] of each motion)
        and `blends` (begin and end [s]). Otherwise the code, message and evidence of the motion that fails
        (number `evidence["item"]`, from 0) or of the blend after this motion.
    Raises:
        InputError: no request, a radius below 0 or after the last request or at a change of group, a start
            state other than in the first request of its group; everything that `plan` raises.
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
        at = with_joint_positions(at, result.trajectory.joint_names, result.trajectory.positions[-1])
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
    """Check a motion sequence for invalid requests before planning begins."""
    items = sequence.items
    if not items:
        raise InputError("the sequence has no requests")
    seen = set()
    for number, (request, radius) in enumerate(items):
        name = f"request {number + 1} of {len(items)}"
        if not (np.isfinite(radius) and radius >= 0):
            raise InputError(f"{name} has blend radius {radius:g} m, it must be zero or positive")
        validate_request(scene, request)
        if "timing" not in normalize_adapter_names(request.adapters):
            raise InputError(f"{name} leaves out adapter 'timing', which a sequence needs")
        if request.start is not None and request.group in seen:
            raise InputError(
                f"{name} has a start state, but begins where the one before of {request.group!r} ends",
                hint="only the first request of a group may have one",
            )
        seen.add(request.group)
    if items[-1][1] != 0:
        raise InputError(f"the last request has blend radius {items[-1][1]:g} m, it must be 0")
    for number, ((a, radius), (b, _)) in enumerate(pairwise(items)):
        if radius > 0 and a.group != b.group:
            raise InputError(
                f"request {number + 1} has blend radius {radius:g} m, but the next one moves "
                f"group {b.group!r} instead of {a.group!r}",
                hint="give radius 0 where the group changes",
            )
        if radius > 0:
            _placed(scene, a)  # raises if the group has no tip
            _check_kept(a, f"request {number + 1}")
            _check_kept(b, f"request {number + 2}")


def _check_kept(request: PlanRequest, name: str) -> None:
    """Raise an InputError if a motion to be blended in a Pilz sequence has path constraints, torque limits or
    jerk limits, because a blend does not keep them.
    """
    is_pilz = (
        normalized_pipeline_id(request.pipeline_id) == PILZ
    )  # path constraints define CIRC's auxiliary point
    kept = {
        "path constraints": bool(request.path_constraints) and not is_pilz,
        "torque_limits": request.torque_limits,
        "jerk_limits": request.jerk_limits,
    }
    for what, asked in kept.items():
        if asked:
            raise InputError(f"{name} has {what}, which a blend does not keep", hint="give blend radius 0")


def _placed(scene: PlanningScene, request: PlanRequest) -> MovedFrame:
    """Return the frame to which the blend radius of a sequence refers: the link of the goal, or the tip of
    the group.
    """
    named = [goal.link for goal in request.goals if isinstance(goal, PoseGoal)]
    return MovedFrame(scene, request.group, named[0] if named else None)


def _blends(items: list[_Item]) -> list[Blend | None] | Outcome:
    """Compute and certify the blends between the motions of a sequence, or report which blend is invalid."""
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
            )  # arcs and joint motions may return to an earlier point
        blends.append(made)
    return blends


def _overlap(items: list[_Item]) -> Outcome | None:
    """Return an Outcome if the spheres around two consecutive blends in a sequence overlap, else None."""
    for number, (a, b) in enumerate(pairwise(items)):
        if a.radius == 0 or b.radius == 0:
            continue
        moved_frame = _placed(b.scene, b.request)
        corners = [moved_frame.pose(item.trajectory.positions[-1]).translation for item in (a, b)]
        apart = float(np.linalg.norm(corners[1] - corners[0]))
        if apart <= a.radius + b.radius:
            text = (
                f"the blend radii of motions {number + 1} ({a.radius * 1000:.0f} mm) and {number + 2} "
                f"({b.radius * 1000:.0f} mm) overlap: their ends are {apart * 1000:.0f} mm apart"
            )
            return Outcome(ErrorCode.INVALID_MOTION_PLAN, text, {"item": number, "apart": apart})
    return None


def _blend(first: _Item, second: _Item, number: int) -> Blend | Outcome:
    moved_frame = _placed(second.scene, first.request)
    ik = solver_for(moved_frame, first.request.group)
    made = blend_motions(first.trajectory, second.trajectory, first.radius, moved_frame, ik)
    if isinstance(made, Outcome):
        return made
    beyond = check_joint_limits(second.scene.model, made.trajectory, None)
    if beyond is not None:
        return beyond
    checker = KernelChecker(second.scene, first.trajectory.joint_names)
    checker.relax_margins(second.trajectory.positions[0])
    points = prove_motion_free(checker, made.curve, moved_frame, "it touches")
    if isinstance(points, Outcome):
        return points
    for item in (first, second):
        if (why := _forbidden(item, made, points)) is not None:
            return why
    return made


def _forbidden(item: _Item, made: Blend, points: Array) -> Outcome | None:
    """Check whether a blend of a Pilz sequence keeps the Cartesian speed limit and the workspace of one of
    its two motions. Return the failure, or None.
    """
    request, speed = item.request, item.request.max_cartesian_speed
    if speed is not None:
        moved_frame = MovedFrame(item.scene, request.group, request.speed_link)
        peak = peak_cartesian_speed(made.trajectory, moved_frame)
        if peak > speed * SPEED_ROUNDING:
            text = f"{moved_frame.name} would move at {peak:.3g} m/s, max_cartesian_speed is {speed:.3g} m/s"
            return Outcome(ErrorCode.PLANNING_FAILED, text, {"speed": peak})
    if request.workspace is not None:
        workspace = Workspace(item.scene, request)
        if (q := workspace.first_outside(points)) is not None:
            return Outcome(ErrorCode.INVALID_MOTION_PLAN, workspace.describe(q), {"positions": q})
    return None


def _joined(
    scene: PlanningScene, items: list[_Item], blends: list[Blend | None]
) -> tuple[JointTrajectory, dict]:
    """Join the motions and blends of a sequence into one trajectory.

    Return it with the start and end [s] of each motion and blend.
    """
    moved = {name for item in items for name in item.trajectory.joint_names}
    names = tuple(name for name in scene.model.joint_names if name in moved)
    state = JointState(scene.model.joint_names, items[0].scene.positions)
    for item in items[::-1]:  # each group begins at the start of its first motion
        state = state.updated(item.trajectory.start)
    state = state.reindexed(names)
    parts = [stationary_trajectory(names, state.positions)]
    clock, evidence = 0.0, {"items": [], "blends": []}

    def append(trajectory: JointTrajectory, begin: float, end: float) -> dict[str, float]:
        nonlocal clock, state
        started = clock
        if end > begin:
            part = trajectory_section(trajectory, begin, end, CLOSE)
            parts.append(with_resting_joints(part, state, names))
            state = state.updated(part.end)
            clock += end - begin
        return {"begin": float(started), "end": float(clock)}

    for number, item in enumerate(items):
        blend = blends[number] if number < len(blends) else None
        before = blends[number - 1] if number else None
        begin = before.joins if before else 0.0
        end = blend.leaves if blend else item.trajectory.duration
        span = append(item.trajectory, begin, end)
        evidence["items"].append({"planner_id": item.result.planner_id, **span})
        if blend is not None:
            evidence["blends"].append(append(blend.trajectory, 0.0, blend.trajectory.duration))
    return concatenate_trajectories(*parts), evidence


def _clearance(scene: PlanningScene, trajectory: JointTrajectory) -> float:
    start = with_joint_positions(scene, trajectory.joint_names, trajectory.positions[0])
    return clearance_along(KernelChecker(start, trajectory.joint_names), trajectory)
