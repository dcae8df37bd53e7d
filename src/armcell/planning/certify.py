"""Certification and timing of a path.

The functions round the path's corners, prove the path collision-free, compute its timing and add the lead-in.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.collision import Certificate
from armcell.collision.kernel.checker import KernelChecker
from armcell.collision.resting_contact import certify_from_rest, clearance_from_rest
from armcell.core import SE3, ErrorCode, InputError, JointTrajectory, Outcome
from armcell.kinematics import InverseDynamics
from armcell.model import Inertial, RobotModel
from armcell.planning.moved_frame import MovedFrame, limit_cartesian_speed
from armcell.planning.request import ValidatedRequest
from armcell.scene import PlanningScene, solid_inertia
from armcell.timing import (
    BlendedPath,
    TimingSettings,
    TorqueLimitError,
    TorqueModel,
    checked_limits,
    concatenate_trajectories,
    jerk_limited,
    parameterize,
    smoothing_deviation,
)

Array = NDArray[np.float64]

SAGITTA = 2e-4
"""[rad] deviation of the certified chords from the rounded path."""
ROUNDINGS = (1.0, 0.3, 0.09, 0.0)
"""Shares of the corner rounding, largest first."""
PADDED_ROUNDINGS = (
    2  # roundings tested with padding; sharper corners cost more time than the padding is worth
)


@dataclass(frozen=True, eq=False)
class CertifiedMotion:
    """Result of certifying a planned path. It contains the certificate and, if the path is collision-free,
    the timed motion. A failed certificate names the contact.
    """

    certificate: Certificate
    trajectory: JointTrajectory | None = None
    path: BlendedPath | None = None
    padded_motion: bool = False  # the motion also keeps the padding


class Certifier(Protocol):
    """Protocol of a collision checker that can certify planned motions: the exact checker or the fast kernel
    checker.
    """

    model: RobotModel
    joint_names: tuple[str, ...]

    def certify(
        self, waypoints: ArrayLike, slack: ArrayLike | None = None, *, evidence: bool = True
    ) -> Certificate: ...


def certify_and_time(
    checker: Certifier,
    waypoints: ArrayLike,
    velocity_scaling: float,
    acceleration_scaling: float,
    timing: TimingSettings = TimingSettings(),
    torque: TorqueModel | None = None,
    jerk_limits: bool = False,
    keeps_padding: Callable[[Array, Array | None], bool] | None = None,
) -> CertifiedMotion:
    """Turn a planned path (k, n) into a motion: round its corners, certify that it is collision-free, and
    compute its timing.

    Corners whose rounding touches an obstacle are rounded less and in the end remain sharp: the motion then
    stops at the corner.

    Args:
        keeps_padding: returns whether a polyline (m, n) keeps the padding if each joint may deviate by a
            slack (n,). A rounding that keeps the padding is preferred to a larger rounding that is only
            free of contact.
        torque: torque limits to respect, see `torque_model`.
        jerk_limits: respect the model's jerk limits (not scaled) and follow the path exactly.
    Raises:
        InputError: a limit is missing, or both torque and jerk limits are requested.
        TorqueLimitError: a joint is too weak to hold still somewhere on the path.
    """
    if torque is not None and jerk_limits:
        raise InputError("torque limits and jerk limits cannot be kept together", hint="ask for one of them")
    points = np.asarray(waypoints, dtype=float)
    names = checker.joint_names
    velocity, acceleration = (
        checked_limits(checker.model.limits(names, kind) * share, kind, names)
        for kind, share in (("velocity", velocity_scaling), ("acceleration", acceleration_scaling))
    )

    def timed(path: BlendedPath) -> JointTrajectory:
        if jerk_limits:
            jerk = checker.model.limits(names, "jerk")
            return jerk_limited(path, names, velocity, acceleration, jerk, timing)
        return parameterize(path, names, velocity, acceleration, timing, torque)

    # The timed motion may differ from the certified chords by the chords' own error and by the
    # deviation that smoothing the accelerations causes.
    slack = np.full(len(names), SAGITTA)
    if not jerk_limits:
        slack += smoothing_deviation(acceleration, timing)
    shares = ROUNDINGS if len(points) > 2 else ROUNDINGS[:1]
    rounded: dict[float, tuple[BlendedPath, Array]] = {}

    def at(share: float) -> tuple[BlendedPath, Array, Array | None]:
        if share not in rounded:
            path = BlendedPath(points, share * timing.max_deviation, smooth=jerk_limits)
            rounded[share] = path, path.polyline(SAGITTA)
        path, chords = rounded[share]
        return path, chords, slack if path.length > 0 else None

    for share in shares[:PADDED_ROUNDINGS]:
        path, chords, room = at(share)
        if keeps_padding is not None and keeps_padding(chords, room):
            return CertifiedMotion(Certificate(True), timed(path), path, padded_motion=True)
    for share in shares:
        path, chords, room = at(share)
        certificate = checker.certify(chords, room, evidence=False)
        if certificate.free:
            return CertifiedMotion(certificate, timed(path), path)
    # With slack, a start or goal very close to an obstacle cannot be proven; the bare edges can.
    path = BlendedPath(points, 0.0)
    certificate = checker.certify(path.points, evidence=False)
    if not certificate.free:
        return CertifiedMotion(certificate)
    return CertifiedMotion(certificate, timed(path), path)


def torque_model(scene: PlanningScene, joint_names: tuple[str, ...]) -> InverseDynamics:
    """Build the inverse dynamics model with which certified paths are timed within torque limits. The model
    includes the links of the group and attached objects.
    """
    payloads = []
    for body in scene.attached.values():
        center, inertia = solid_inertia(body.object.shapes, body.object.mass_kg)
        pose = body.T_link_object @ SE3.from_xyz(*center)
        payloads.append((body.link, Inertial(body.object.mass_kg, pose, inertia)))
    return InverseDynamics(scene.model, joint_names, scene.positions, payloads)


def clearance_along(checker: KernelChecker, trajectory: JointTrajectory) -> float:
    """Compute the distance [m] that a certified motion is proven to keep from obstacles. The result is at
    most 0.25 m.

    See `KernelChecker.clearance`. A pair in resting contact at the start counts from the point where it no
    longer moves apart.
    """
    return clearance_from_rest(checker, trajectory.positions)


@dataclass(frozen=True, eq=False)
class PlannedMotion:
    """Planned path (k, n) with a certified trajectory along it, or the reason why it could not be
    certified.
    """

    waypoints: Array
    trajectory: JointTrajectory | None = None
    certified: bool = False
    reason: str = ""
    note: str = ""  # information for the caller about a certified motion
    padded_motion: bool = True  # the motion keeps the scene's padding everywhere, not only at samples


def certify_request_motion(
    validated: ValidatedRequest, checker: KernelChecker, waypoints: Array
) -> PlannedMotion | Outcome:
    """Certify a path (k, n) for a planning request and compute its timing.

    Return an Outcome if no other path can succeed either.
    """
    request = validated.request
    if validated.workspace is not None and (q := validated.workspace.first_outside(waypoints)) is not None:
        return PlannedMotion(
            waypoints, reason=f"the paths found leave the workspace: {validated.workspace.describe(q)}"
        )
    torque = torque_model(validated.scene, validated.joint_names) if request.torque_limits else None
    padded = validated.scene.padding > 0 or any(p > 0 for p in validated.scene.link_padding.values())
    try:
        finished = certify_and_time(
            checker, waypoints, request.velocity_scaling, request.acceleration_scaling,
            torque=torque, jerk_limits=request.jerk_limits,
            keeps_padding=partial(_certify_padded, checker) if padded else None,
        )  # fmt: skip
    except TorqueLimitError as error:
        evidence = {"joint": error.joint, "torque": error.torque, "limit": error.limit}
        return Outcome(ErrorCode.PLANNING_FAILED, str(error), evidence)
    if finished.trajectory is None:
        return PlannedMotion(waypoints)
    made = complete_motion(validated, checker, waypoints, finished.trajectory)
    return replace(made, padded_motion=finished.padded_motion or not padded)


def _certify_padded(checker: KernelChecker, chords: Array, slack: Array | None) -> bool:
    return checker.certify(chords, slack, padded=True, evidence=False).free


def complete_motion(
    validated: ValidatedRequest, checker: KernelChecker, waypoints: Array, trajectory: JointTrajectory
) -> PlannedMotion:
    """Prepend the short motion from the robot's actual state to a certified motion, and limit the Cartesian
    speed of the result.
    """
    request, note = validated.request, ""
    if validated.lead_in is not None:
        lead = time_lead_in(validated, checker)
        if lead is None:
            note = "the motion begins at the start within limits; the lead-in to it is not free"
        else:
            waypoints = np.vstack([validated.lead_in[:-1], waypoints])
            trajectory = concatenate_trajectories(lead, trajectory)
            note = contact_note(validated)
    elif "start_repaired" in validated.evidence:
        note = "the motion begins at the repaired start, not where the robot is"
    if request.max_cartesian_speed is not None:
        moved_frame = MovedFrame(validated.scene, request.group, request.speed_link)
        trajectory = limit_cartesian_speed(trajectory, moved_frame, request.max_cartesian_speed)
    timing = "timing" in validated.adapters
    return PlannedMotion(waypoints, trajectory if timing else None, certified=True, note=note)


def contact_note(validated: ValidatedRequest) -> str:
    """Return a note on a certified motion that starts in contact: the note names the contacts that end when
    the motion begins.

    The note is part of the plan's message. It is empty if the start was not in contact.
    """
    contacts = validated.evidence.get("start_repaired", {}).get("contacts", ())
    return "the motion first leaves contact: " + "; ".join(c.describe() for c in contacts) if contacts else ""


def time_lead_in(validated: ValidatedRequest, checker: KernelChecker) -> JointTrajectory | None:
    """Certify and time the lead-in, the motion from the robot's actual state to the start of the certified
    path.

    Return None if the motion is not proven collision-free.
    """
    lead = validated.lead_in
    if lead is None:
        return None
    checker = (
        checker.without_arm_clearance or checker
    )  # the lead-in need not keep the clearance between arms yet
    if not certify_from_rest(checker, lead, deepest=np.inf, evidence=False).free:
        return None
    names, request = validated.joint_names, validated.request
    velocity = checker.model.limits(names, "velocity") * request.velocity_scaling
    acceleration = checker.model.limits(names, "acceleration") * request.acceleration_scaling
    path = BlendedPath(lead, 0.0)
    if request.jerk_limits:
        return jerk_limited(path, names, velocity, acceleration, checker.model.limits(names, "jerk"))
    torque = torque_model(validated.scene, names) if request.torque_limits else None
    return parameterize(path, names, velocity, acceleration, TimingSettings(), torque)
