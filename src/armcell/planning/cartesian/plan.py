"""Straight lines of the tip: approach, retreat, lift. Says how far it comes, and why not farther."""

from __future__ import annotations

import threading
import time
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.collision import Certificate
from armcell.collision.kernel.checker import KernelChecker
from armcell.collision.resting import certify_from_rest
from armcell.core import CartesianRequest, ErrorCode, InputError, JointPath, JointTrajectory, PlanResult
from armcell.kinematics import IKSolver, ik_solver
from armcell.planning.cartesian.follow import Follower, Resting, relative_jump
from armcell.planning.cartesian.poses import poses_between
from armcell.planning.cartesian.stops import COLLISION, LEAD_OUT, Told, collided, violated
from armcell.planning.constraint_sense import check_constraints
from armcell.planning.constraints.description import Manifold
from armcell.planning.constraints.timed import chords
from armcell.planning.constraints.views import manifold_of
from armcell.planning.constraints.warm_up import warm_up_constraints
from armcell.planning.departure import too_deep
from armcell.planning.explanation import explained
from armcell.planning.finish import clearance_along, finish
from armcell.planning.placed import Placed
from armcell.planning.speed import check_speed, slowed
from armcell.scene import PlanningScene
from armcell.timing import TimingSettings, check_scaling

Array = NDArray[np.float64]

TIMINGS = (TimingSettings(max_deviation=2e-3), TimingSettings(max_deviation=5e-4, smoothing=4e-3))
"""Corners between the small steps are hardly cut [rad]: the tip keeps its line. The second where the first
does not keep to the path constraints."""

CORRIDOR_SHARE, CORRIDOR_ROOM = 0.1, 5e-3  # of a joint's corridor, and [rad or m], kept free at its edges


@explained(CartesianRequest)
def plan_cartesian(
    scene: PlanningScene, request: CartesianRequest, cancel: threading.Event | None = None
) -> PlanResult:
    """A straight-line motion of a link through the poses of the request.

    Args:
        cancel: set it from another thread to stop: the result is PREEMPTED.
    Returns:
        SUCCESS with `fraction` 1, or a code with the part that can be done (fraction < 1), its path and
        trajectory, and in the message where it stops and why. Fraction 0 has neither. Evidence of a stop:
        `cause`, `stops_at` (the link's pose), `positions` (n,) there, `waypoint` it was on the way to (from
        1), and by cause: `contacts`; `joint` and `step` of a jump; `joints_at_limit`, `missing_m`,
        `missing_rad`, `least_singular_value`; `violations` of path constraints.
    Raises:
        InputError: no waypoints, a zero step or one too small, unknown group or link, scaling outside
            (0, 1], path constraints that cannot be meant.
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
        resting = Resting(checker, start)
        if (refusal := too_deep(resting.contacts)) is not None:
            return _refused(refusal.code, refusal.message, refusal.evidence)
    checker.relax_margins(start)
    manifold = None
    if request.path_constraints:
        manifold = manifold_of(scene, request.group, request.path_constraints)
        if found := manifold.violations(start):
            text = "start violates the path constraints: " + "; ".join(v.text for v in found[:3])
            return _refused(ErrorCode.START_STATE_VIOLATES_PATH_CONSTRAINTS, text, {"violations": found})
        manifold.allow_edges([start])
    line = _Line(scene, request, ik, checker, manifold, cancel or threading.Event(), resting)
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
    check_speed(request.max_cartesian_speed)


def _refused(code: ErrorCode, text: str, evidence: dict[str, Any]) -> PlanResult:
    return PlanResult(code, text, evidence, planner_id="cartesian", fraction=0.0)


class _Line:
    """One request with what answers it."""

    def __init__(
        self, scene: PlanningScene, request: CartesianRequest, ik: IKSolver, checker: KernelChecker,
        manifold: Manifold | None, cancel: threading.Event, resting: Resting | None,
    ):  # fmt: skip
        self.cancel, self.resting = cancel, resting
        self.scene, self.request, self.ik = scene, request, ik
        self.checker, self.manifold = checker, manifold
        self.legs = poses_between(scene.frame_pose(ik.tip_link), request)
        self.total = sum(len(leg) for leg in self.legs)

    def follow(self, start: Array) -> tuple[Array, Told | None]:
        """Joint positions (k, n) of the steps that can be taken, and why there are no more."""
        bounds = np.column_stack([self.ik.lower, self.ik.upper])
        if self.manifold is not None:  # corridors of joints are limits, which spare joints help to keep
            low, high = self.manifold.lower, self.manifold.upper
            room = np.minimum(CORRIDOR_SHARE * (high - low), CORRIDOR_ROOM)  # for what the timing cuts
            bounds[:, 0] = np.minimum(np.maximum(bounds[:, 0], low + room), start)
            bounds[:, 1] = np.maximum(np.minimum(bounds[:, 1], high - room), start)
        checker = self.checker if self.request.avoid_collisions else None
        follower = Follower(
            self.request, self.ik, checker, self.manifold, self.scene.positions, bounds, self.cancel,
            self.resting,
        )  # fmt: skip
        path, stop = [start], None
        for poses in self.legs:
            leg = follower.leg(poses, path[-1])
            path += leg.path
            stop = leg.stop
            if stop is not None:
                break
        points = np.array(path)
        factor = self.request.relative_jump_threshold
        jump = relative_jump(points, self.ik.joint_names, follower.slides, factor)
        if jump is not None:
            points, stop = points[: jump[0] + 1], jump[1]
        return points, None if stop is None else stop.tell()

    def proven(self, path: Array, told: Told | None) -> tuple[Array, Told | None]:
        """The part of a path whose steps are proven, and why it is not all of it."""
        if self.request.avoid_collisions and len(path) > 1:
            certificate = self.certify(path)
            while not certificate.free and len(path) > 1:
                path = path[: min(int(certificate.at * (len(path) - 1)), len(path) - 2) + 1]
                contacts = [] if certificate.contact is None else [certificate.contact]
                # What is left of a line out of contact may end while it still touches.
                certificate = Certificate(True) if self.resting is None else self.certify(path)
                told = collided(contacts)
        if self.manifold is not None and len(path) > 1 and (edge := self.manifold.leaves(path)) >= 0:
            told = violated(self.manifold, path[edge + 1])
            path = path[: edge + 1]
        return path, told

    def certify(self, path: Array, slack: Array | None = None) -> Certificate:
        if self.resting is None:
            return self.checker.certify(path, slack)
        return certify_from_rest(self.checker, path, slack)

    def timed(self, path: Array) -> JointTrajectory | None:
        request, checker = self.request, self.checker
        # A line out of contact is proven as it is timed: its first steps are too near for the slack that
        # proves a path before it is timed.
        strict = request.avoid_collisions and self.resting is None
        for timing in TIMINGS:
            trajectory = finish(
                checker if strict else _Blind(checker), path,
                request.velocity_scaling, request.acceleration_scaling, timing,
            ).trajectory  # fmt: skip
            if trajectory is None:
                return None
            if self.resting is not None and not self.certify(*chords(trajectory)).free:
                continue
            if self.manifold is not None and self.manifold.leaves(*chords(trajectory)) >= 0:
                continue
            if request.max_cartesian_speed is None:
                return trajectory
            placed = Placed(checker.scene, request.group, request.link)
            return slowed(trajectory, placed, request.max_cartesian_speed)
        return None

    def place(self, path: Array) -> dict[str, Any]:
        """Evidence of where it stops."""
        full = self.scene.positions.copy()
        full[self.ik.columns] = path[-1]
        ends = np.cumsum([len(leg) for leg in self.legs])
        number = min(int(np.searchsorted(ends, len(path) - 1, side="right")), len(ends) - 1)
        return {
            "stops_at": self.ik.tree.link_pose(full, self.ik.tip_link),
            "positions": path[-1],
            "waypoint": number + 1,
        }


def _along(line: _Line, start: Array) -> PlanResult:
    found = line.follow(start)
    if line.cancel.is_set():
        return _refused(ErrorCode.PREEMPTED, "cancelled", {})
    path, told = line.proven(*found)
    fraction, trajectory = (len(path) - 1) / line.total, None
    if len(path) > 1:
        trajectory = line.timed(path)
        if trajectory is None and told is None:
            what = "free" if line.manifold is None else "free and within its path constraints"
            text = f"the timed motion could not be proven {what}"
            return _refused(ErrorCode.INVALID_MOTION_PLAN, text, {})
    code, message, evidence = ErrorCode.SUCCESS, "", {}
    if told is not None:
        code = told.code
        message = f"stops at {fraction:.0%} ({len(path) - 1} of {line.total} steps): {told.text}"
        if line.resting is not None and told.cause == COLLISION and len(path) == 1:
            message += f"; {LEAD_OUT}"
        evidence = {**told.evidence, "cause": told.cause, **line.place(path)}
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


class _Blind:
    """Proves everything, for avoid_collisions=False and what is proven after it was timed."""

    def __init__(self, checker: KernelChecker):
        self.model, self.joint_names = checker.model, checker.joint_names

    def certify(
        self, waypoints: ArrayLike, slack: ArrayLike | None = None, *, evidence: bool = True
    ) -> Certificate:
        return Certificate(True)
