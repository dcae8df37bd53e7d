"""Straight lines of the tip: approach, retreat, lift. Says how far it comes, and why not farther."""

from __future__ import annotations

import time
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.collision import Certificate
from armcell.collision.kernel.checker import KernelChecker
from armcell.core import SE3, CartesianRequest, ErrorCode, InputError, JointPath, PlanResult
from armcell.kinematics import IKSolver, ik_solver
from armcell.planning.explanation import explained
from armcell.planning.finish import clearance_along, finish
from armcell.planning.placed import Placed
from armcell.planning.speed import check_speed, slowed
from armcell.scene import PlanningScene
from armcell.timing import TimingSettings, check_scaling

Array = NDArray[np.float64]

ROTATION_STEP = 0.05  # [rad] between checked poses
DEVIATION = 2e-3  # [rad] the tip keeps its line: corners between the small steps are hardly cut


@explained(CartesianRequest)
def plan_cartesian(scene: PlanningScene, request: CartesianRequest) -> PlanResult:
    """A straight-line motion of a link through the poses of the request.

    Returns:
        SUCCESS with `fraction` 1, or a code with the part that can be done (fraction < 1), its path and
        trajectory, and in the message where it stops and why. Fraction 0 has neither.
    Raises:
        InputError: no waypoints, zero step, unknown group or link, scaling outside (0, 1].
    """
    began = time.monotonic()
    check_scaling(request.velocity_scaling, "velocity scaling")
    check_scaling(request.acceleration_scaling, "acceleration scaling")
    if not request.waypoints:
        raise InputError("the Cartesian path has no waypoints")
    if not (np.isfinite(request.max_step) and request.max_step > 0):
        raise InputError(f"max_step is {request.max_step:g} m, it must be positive")
    check_speed(request.max_cartesian_speed)
    if request.start is not None:
        scene = replace(scene, positions=scene.state.updated(request.start).positions)
    try:
        scene.model.check_positions(scene.positions, margin=1e-3)
    except InputError as error:
        text = f"start: {error}"
        return PlanResult(ErrorCode.START_STATE_INVALID, text, planner_id="cartesian", fraction=0.0)
    ik = ik_solver(scene.model, request.group, request.link)
    checker = KernelChecker(scene, ik.joint_names)
    checker.relax_margins(scene.positions[ik.columns])
    path, wanted, stop = _follow(scene, request, ik, checker)
    fraction = (len(path) - 1) / wanted if wanted else 1.0
    code, message, evidence = (ErrorCode.SUCCESS, "", {}) if stop is None else stop
    trajectory = None
    if len(path) > 1:
        if request.avoid_collisions:
            certificate = checker.certify(path)
            if not certificate.free:
                keep = int(certificate.at * (len(path) - 1))
                contact = certificate.contact
                code, fraction = ErrorCode.INVALID_MOTION_PLAN, keep / wanted
                message = f"stops at {fraction:.0%}: {contact.describe() if contact else 'in collision'}"
                evidence = {"contacts": [contact]}
                path = path[: keep + 1]
        trajectory = _timed(checker, request, path) if len(path) > 1 else None
    if trajectory is None and stop is None and wanted and len(path) > 1:
        code, message, fraction = (
            ErrorCode.INVALID_MOTION_PLAN,
            "the timed motion could not be proven free",
            0.0,
        )
    spent = time.monotonic() - began
    return PlanResult(
        code,
        message,
        evidence,
        path=JointPath(ik.joint_names, path) if len(path) > 1 else None,
        trajectory=trajectory,
        planner_id="cartesian",
        planning_time=spent,
        fraction=float(fraction),
        clearance=partial(clearance_along, checker, trajectory) if trajectory is not None else None,
    )


def _timed(checker: KernelChecker, request: CartesianRequest, path: Array):
    finished = finish(
        checker if request.avoid_collisions else _Blind(checker), path,
        request.velocity_scaling, request.acceleration_scaling, TimingSettings(max_deviation=DEVIATION),
    )  # fmt: skip
    trajectory = finished.trajectory
    if trajectory is None or request.max_cartesian_speed is None:
        return trajectory
    return slowed(trajectory, Placed(checker.scene, request.group, request.link), request.max_cartesian_speed)


class _Blind:
    """Proves everything, for avoid_collisions=False."""

    def __init__(self, checker: KernelChecker):
        self.model, self.joint_names = checker.model, checker.joint_names

    def certify(
        self, waypoints: ArrayLike, slack: ArrayLike | None = None, *, evidence: bool = True
    ) -> Certificate:
        return Certificate(True)


def _follow(scene: PlanningScene, request: CartesianRequest, ik: IKSolver, checker: KernelChecker):
    """Joint positions step by step, the number of steps wanted, and why it stopped (or None)."""
    poses = _interpolated(scene.frame_pose(ik.tip_link), request)
    q = scene.positions.copy()
    path = [q[ik.columns].copy()]
    total = len(poses)
    for k, pose in enumerate(poses):
        position, angle, ok = ik.descend(q, pose)
        at = f"at {k / total:.0%} ({k} of {total} steps)"
        if not ok:
            limits = ik.at_limit(q[ik.columns])
            why = f"{', '.join(limits)} at the limit" if limits else "out of reach or singular"
            text = f"stops {at}: {why} ({position * 1000:.1f} mm, {np.rad2deg(angle):.1f} deg short)"
            return np.array(path), total, (ErrorCode.NO_IK_SOLUTION, text, {"joints_at_limit": limits})
        step = np.abs(q[ik.columns] - path[-1])
        if 0 < request.jump_threshold < step.max():  # 0 switches the test off, as in MoveIt
            joint = ik.joint_names[int(np.argmax(step))]
            text = (
                f"stops {at}: {joint} would jump {step.max():.2f} rad (threshold {request.jump_threshold:g})"
            )
            return np.array(path), total, (ErrorCode.PLANNING_FAILED, text, {"joint": joint})
        if request.avoid_collisions and not checker.is_free(q[ik.columns]):
            contacts = checker.exact.contacts(q[ik.columns])
            text = f"stops {at}: " + "; ".join(c.describe() for c in contacts[:3])
            return np.array(path), total, (ErrorCode.INVALID_MOTION_PLAN, text, {"contacts": contacts})
        path.append(q[ik.columns].copy())
    return np.array(path), total, None


def _interpolated(start: SE3, request: CartesianRequest) -> list[SE3]:
    poses, at = [], start
    for waypoint in request.waypoints:
        metres, radians = at.distance_to(waypoint)
        count = max(int(np.ceil(max(metres / request.max_step, radians / ROTATION_STEP))), 1)
        poses += [at.interpolate(waypoint, (k + 1) / count) for k in range(count)]
        at = waypoint
    return poses
