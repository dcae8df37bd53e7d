"""Planning of a Cartesian path: the tip moves on straight lines through waypoints."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.collision import Certificate
from armcell.collision.kernel.checker import KernelChecker
from armcell.collision.resting_contact import certify_from_rest, resting_contacts
from armcell.core import SE3, CartesianRequest, ErrorCode, InputError, JointPath, JointTrajectory, PlanResult
from armcell.kinematics import IKSolver, ik_solver
from armcell.planning.cartesian.line_following import (
    COLLISION,
    LEAD_OUT,
    LineFollower,
    RestingStartRule,
    StopReason,
    collision_stop,
    constraint_stop,
    relative_jump,
)
from armcell.planning.certify import certify_and_time, clearance_along
from armcell.planning.constraints.constraint_validation import check_constraints
from armcell.planning.constraints.manifold import ConstraintManifold
from armcell.planning.constraints.plan import chords, warm_up_constraints
from armcell.planning.constraints.visibility_manifold import make_manifold
from armcell.planning.diagnosis import with_explanation
from armcell.planning.moved_frame import MovedFrame, check_cartesian_speed, limit_cartesian_speed
from armcell.planning.start_in_contact import reject_deep_contacts
from armcell.scene import PlanningScene
from armcell.timing import TimingSettings, check_scaling

Array = NDArray[np.float64]

MOST_STEPS = 100_000  # steps of one line
ROTATION_STEP = 0.05  # [rad] between checked poses
FEWEST = 10  # smallest number of steps for the relative jump test, as in MoveIt


def poses_between(start: SE3, request: CartesianRequest) -> list[list[SE3]]:
    """Interpolate the tip poses along the straight segments of a Cartesian plan. The first pose is not
    included.
    """
    legs, at = [], start
    least = FEWEST if request.relative_jump_threshold > 0 else 1
    for waypoint in request.waypoints:
        meters, radians = at.distance_to(waypoint)
        count = max(int(np.ceil(max(meters / request.max_step, radians / ROTATION_STEP))), least)
        if count > MOST_STEPS:
            raise InputError(
                f"max_step of {request.max_step:g} m divides a line of {meters:.3g} m into {count} steps",
                hint=f"at most {MOST_STEPS} are allowed; 0.005 m is usual",
            )
        legs.append(at.interpolated(waypoint, ((k + 1) / count for k in range(count))))
        at = waypoint
    return legs


def waypoints_by_offsets(
    scene: PlanningScene, group: str, offsets: Sequence[SE3], link: str | None = None, frame: str = "link"
) -> tuple[SE3, ...]:
    """Compute the waypoints of a Cartesian plan: start at the current pose of a link and add the given
    offsets one after the other.

    Args:
        offsets: motions in the link's own axes (`frame="link"`), or about the link's origin in the axes of
            a frame of the scene ("world", a link, an object).
    Raises:
        UnknownNameError: the group, link or frame does not exist.
    """
    at = scene.frame_pose(MovedFrame(scene, group, link).name)
    axes = None if frame == "link" else scene.frame_pose(frame).rotation
    found = []
    for offset in offsets:
        if axes is None:
            at = at @ offset
        else:
            turn = axes @ offset.rotation @ axes.inverse()
            at = SE3(turn @ at.rotation, at.translation + axes.matrix @ offset.translation)
        found.append(at)
    return tuple(found)


TIMINGS = (TimingSettings(max_deviation=2e-3), TimingSettings(max_deviation=5e-4, smoothing=4e-3))
"""Small corner deviations [rad], so that the tip keeps its line; the second is used if the first
violates the path constraints."""

CORRIDOR_SHARE, CORRIDOR_ROOM = 0.1, 5e-3  # share of a joint's corridor, and [rad or m], free at its edges


@with_explanation(CartesianRequest)
def plan_cartesian(
    scene: PlanningScene, request: CartesianRequest, cancel: threading.Event | None = None
) -> PlanResult:
    """Plan a Cartesian path, on which a link moves on straight lines through the waypoints of the request.

    Args:
        cancel: set this event from another thread to stop; the result is then PREEMPTED.
    Returns:
        SUCCESS with `fraction` 1, or a code with the feasible part (fraction < 1), its path and trajectory,
        and in the message where and why the path stops. With fraction 0 there is no path and no trajectory.
        Evidence of a stop: `cause`, `stops_at` (the link's pose), `positions` (n,) at the stop, `waypoint`
        (number of the next waypoint, from 1), and by cause: `contacts`; `joint` and `step` of a jump;
        `joints_at_limit`, `missing_m`, `missing_rad`, `least_singular_value`; `violations` of path
        constraints.
    Raises:
        InputError: no waypoints, a step that is zero or too small, unknown group or link, scaling outside
            (0, 1], contradictory path constraints.
    """
    _check(request)
    if request.start is not None:
        scene = replace(scene, positions=scene.state.updated(request.start).positions)
    ik = ik_solver(scene.model, request.group, request.link)
    if request.path_constraints:
        check_constraints(scene, request.group, request.path_constraints)
        warm_up_constraints()
    began = time.monotonic()
    try:
        scene.model.check_positions(scene.positions, margin=1e-3)
    except InputError as error:
        return _refused(ErrorCode.START_STATE_INVALID, f"start: {error}", {})
    checker = KernelChecker(scene, ik.joint_names)
    start = scene.positions[ik.columns]
    resting = None
    if request.avoid_collisions and checker.touches(start):
        if (refusal := reject_deep_contacts(resting_contacts(checker, start))) is not None:
            return _refused(refusal.code, refusal.message, refusal.evidence)
        resting = RestingStartRule(checker, start)
    checker.relax_margins(start)
    manifold = None
    if request.path_constraints:
        manifold = make_manifold(scene, request.group, request.path_constraints)
        if found := manifold.violations(start):
            text = "start violates the path constraints: " + "; ".join(v.text for v in found[:3])
            return _refused(ErrorCode.START_STATE_VIOLATES_PATH_CONSTRAINTS, text, {"violations": found})
        manifold.relax_boundary([start])
    line = _CartesianProblem(scene, request, ik, checker, manifold, cancel or threading.Event(), resting)
    result = _along(line, start)
    return replace(result, planning_time=time.monotonic() - began)


def _check(request: CartesianRequest) -> None:
    check_scaling(request.velocity_scaling, "velocity scaling")
    check_scaling(request.acceleration_scaling, "acceleration scaling")
    if not request.waypoints:
        raise InputError("the Cartesian path has no waypoints")
    if not (np.isfinite(request.max_step) and request.max_step > 0):
        raise InputError(f"max_step is {request.max_step:g} m, it must be positive")
    for name in ("jump_threshold", "prismatic_jump_threshold", "relative_jump_threshold"):
        if not getattr(request, name) >= 0:
            raise InputError(f"{name} is {getattr(request, name):g}, it must not be below zero")
    check_cartesian_speed(request.max_cartesian_speed)


def _refused(code: ErrorCode, text: str, evidence: dict[str, Any]) -> PlanResult:
    return PlanResult(code, text, evidence, planner_id="cartesian", fraction=0.0)


class _CartesianProblem:
    """Data for planning one Cartesian path: the request with its IK solver, collision checker and
    constraints.
    """

    def __init__(
        self, scene: PlanningScene, request: CartesianRequest, ik: IKSolver, checker: KernelChecker,
        manifold: ConstraintManifold | None, cancel: threading.Event, resting: RestingStartRule | None,
    ):  # fmt: skip
        self.cancel, self.resting = cancel, resting
        self.scene, self.request, self.ik = scene, request, ik
        self.checker, self.manifold = checker, manifold
        self.legs = poses_between(scene.frame_pose(ik.tip_link), request)
        self.total = sum(len(leg) for leg in self.legs)

    def follow(self, start: Array) -> tuple[Array, StopReason | None]:
        """Follow all straight segments of a Cartesian path by inverse kinematics.

        Return joint positions (k, n) of the feasible steps and the reason for a stop.
        """
        bounds = np.column_stack([self.ik.lower, self.ik.upper])
        if self.manifold is not None:  # corridors of joints are limits, which redundant joints help to keep
            low, high = self.manifold.lower, self.manifold.upper
            room = np.minimum(CORRIDOR_SHARE * (high - low), CORRIDOR_ROOM)  # for the deviation of the timing
            bounds[:, 0] = np.minimum(np.maximum(bounds[:, 0], low + room), start)
            bounds[:, 1] = np.maximum(np.minimum(bounds[:, 1], high - room), start)
        checker = self.checker if self.request.avoid_collisions else None
        follower = LineFollower(
            self.request, self.ik, checker, self.manifold, self.scene.positions, bounds, self.cancel,
            self.resting,
        )  # fmt: skip
        path, stop = [start], None
        for poses in self.legs:
            leg = follower.follow(poses, path[-1])
            path += leg.path
            stop = leg.stop
            if stop is not None:
                break
        points = np.array(path)
        factor = self.request.relative_jump_threshold
        jump = relative_jump(points, self.ik.joint_names, follower.slides, factor)
        if jump is not None:
            points, stop = points[: jump[0] + 1], jump[1]
        return points, None if stop is None else stop.explain()

    def proven_part(self, path: Array, reason: StopReason | None) -> tuple[Array, StopReason | None]:
        """Return the part of a Cartesian plan that is proven valid,
        and the reason why the rest is not proven.
        """
        if self.request.avoid_collisions and len(path) > 1:
            certificate = self.certify(path)
            while not certificate.free and len(path) > 1:
                path = path[: min(int(certificate.at * (len(path) - 1)), len(path) - 2) + 1]
                contacts = [] if certificate.contact is None else [certificate.contact]
                # The remaining part of a line out of contact may end while still in contact.
                certificate = Certificate(True) if self.resting is None else self.certify(path)
                reason = collision_stop(contacts)
        if (
            self.manifold is not None
            and len(path) > 1
            and (edge := self.manifold.first_unproven_edge(path)) >= 0
        ):
            reason = constraint_stop(self.manifold, path[edge + 1])
            path = path[: edge + 1]
        return path, reason

    def certify(self, path: Array, slack: Array | None = None) -> Certificate:
        if self.resting is None:
            return self.checker.certify(path, slack)
        return certify_from_rest(self.checker, path, slack)

    def timed(self, path: Array) -> JointTrajectory | None:
        request, checker = self.request, self.checker
        # A line out of contact is proven with its timing: its first steps are too near for the slack that
        # proves a path before it is timed.
        strict = request.avoid_collisions and self.resting is None
        for timing in TIMINGS:
            trajectory = certify_and_time(
                checker if strict else _AcceptAll(checker), path,
                request.velocity_scaling, request.acceleration_scaling, timing,
            ).trajectory  # fmt: skip
            if trajectory is None:
                return None
            if self.resting is not None and not self.certify(*chords(trajectory)).free:
                continue
            if self.manifold is not None and self.manifold.first_unproven_edge(*chords(trajectory)) >= 0:
                continue
            if request.max_cartesian_speed is None:
                return trajectory
            moved_frame = MovedFrame(checker.scene, request.group, request.link)
            return limit_cartesian_speed(trajectory, moved_frame, request.max_cartesian_speed)
        return None

    def stop_evidence(self, path: Array) -> dict[str, Any]:
        """Collect evidence about the pose and the joint positions at which a Cartesian plan stops."""
        full = self.scene.positions.copy()
        full[self.ik.columns] = path[-1]
        ends = np.cumsum([len(leg) for leg in self.legs])
        number = min(int(np.searchsorted(ends, len(path) - 1, side="right")), len(ends) - 1)
        return {
            "stops_at": self.ik.tree.link_pose(full, self.ik.tip_link),
            "positions": path[-1],
            "waypoint": number + 1,
        }


def _along(line: _CartesianProblem, start: Array) -> PlanResult:
    found = line.follow(start)
    if line.cancel.is_set():
        return _refused(ErrorCode.PREEMPTED, "cancelled", {})
    path, reason = line.proven_part(*found)
    fraction, trajectory = (len(path) - 1) / line.total, None
    if len(path) > 1:
        trajectory = line.timed(path)
        if trajectory is None and reason is None:
            what = "free" if line.manifold is None else "free and within its path constraints"
            text = f"the timed motion could not be proven {what}"
            return _refused(ErrorCode.INVALID_MOTION_PLAN, text, {})
    code, message, evidence = ErrorCode.SUCCESS, "", {}
    if reason is not None:
        code = reason.code
        message = f"stops at {fraction:.0%} ({len(path) - 1} of {line.total} steps): {reason.text}"
        if line.resting is not None and reason.cause == COLLISION and len(path) == 1:
            message += f"; {LEAD_OUT}"
        evidence = {**reason.evidence, "cause": reason.cause, **line.stop_evidence(path)}
    return PlanResult(
        code,
        message,
        evidence,
        path=JointPath(line.ik.joint_names, path) if len(path) > 1 else None,
        trajectory=trajectory,
        planner_id="cartesian",
        fraction=float(fraction),
        clearance=partial(clearance_along, line.checker, trajectory) if trajectory is not None else None,
    )


class _AcceptAll:
    """Certifier for Cartesian plans that checks no collisions and accepts every motion.

    It is for paths that need no collision check or are proven after timing.
    """

    def __init__(self, checker: KernelChecker):
        self.model, self.joint_names = checker.model, checker.joint_names

    def certify(
        self, waypoints: ArrayLike, slack: ArrayLike | None = None, *, evidence: bool = True
    ) -> Certificate:
        return Certificate(True)
