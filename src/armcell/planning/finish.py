"""From waypoints to a proven, timed motion: round the corners, certify, parameterise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.collision import Certificate
from armcell.collision.kernel.checker import KernelChecker
from armcell.collision.resting import clearance_from_rest
from armcell.core import SE3, InputError, JointTrajectory
from armcell.kinematics import InverseDynamics
from armcell.model import Inertial, RobotModel
from armcell.scene import PlanningScene, solid_inertia
from armcell.timing import (
    BlendedPath,
    TimingSettings,
    TorqueModel,
    jerk_limited,
    parameterize,
    smoothing_departure,
)

Array = NDArray[np.float64]

SAGITTA = 2e-4
"""[rad] by which the certified chords may differ from the rounded path."""
ROUNDINGS = (1.0, 0.3, 0.09, 0.0)
"""Shares of the rounding of corners, the largest tried first."""
ROOMY = 2  # so many of them are tried for room; sharper ones cost more time than it is worth


@dataclass(frozen=True, eq=False)
class Finished:
    """A certified motion, or the certificate that says where it touches."""

    certificate: Certificate
    trajectory: JointTrajectory | None = None
    path: BlendedPath | None = None
    roomy: bool = False  # the padding is kept as well


class Certifier(Protocol):
    """What proves motions: the exact checker or the kernel."""

    model: RobotModel
    joint_names: tuple[str, ...]

    def certify(
        self, waypoints: ArrayLike, slack: ArrayLike | None = None, *, evidence: bool = True
    ) -> Certificate: ...


def finish(
    checker: Certifier,
    waypoints: ArrayLike,
    velocity_scaling: float,
    acceleration_scaling: float,
    timing: TimingSettings = TimingSettings(),
    torque: TorqueModel | None = None,
    jerk_limits: bool = False,
    with_room: Callable[[Array, Array | None], bool] | None = None,
) -> Finished:
    """Blend, certify and time a path (k, n).

    Corners whose rounding touches something are cut less, at last not at all (the motion stops there).

    Args:
        with_room: whether a polyline (m, n), which joints may leave by a slack (n,), keeps the padding too.
            A rounding with which it does is taken before a larger one with which it only does not touch.
        torque: torque limits to be kept, see `torque_model`.
        jerk_limits: keep the model's jerk limits (not scaled), exactly on the path.
    Raises:
        InputError: a limit is missing, or both torque and jerk limits are asked for.
        TorqueLimitError: a joint is too weak to hold still somewhere on the path.
    """
    if torque is not None and jerk_limits:
        raise InputError("torque limits and jerk limits cannot be kept together", cure="ask for one of them")
    points = np.asarray(waypoints, dtype=float)
    names = checker.joint_names
    velocity = checker.model.limits(names, "velocity") * velocity_scaling
    acceleration = checker.model.limits(names, "acceleration") * acceleration_scaling

    def timed(path: BlendedPath) -> JointTrajectory:
        if jerk_limits:
            jerk = checker.model.limits(names, "jerk")
            return jerk_limited(path, names, velocity, acceleration, jerk, timing)
        return parameterize(path, names, velocity, acceleration, timing, torque)

    # What the timed motion may differ from the certified chords: the chords' own error, and what the
    # smoothing of the accelerations leaves the path by.
    slack = np.full(len(names), SAGITTA)
    if not jerk_limits:
        slack += smoothing_departure(acceleration, timing)
    shares = ROUNDINGS if len(points) > 2 else ROUNDINGS[:1]
    rounded: dict[float, tuple[BlendedPath, Array]] = {}

    def at(share: float) -> tuple[BlendedPath, Array, Array | None]:
        if share not in rounded:
            path = BlendedPath(points, share * timing.max_deviation, smooth=jerk_limits)
            rounded[share] = path, path.polyline(SAGITTA)
        path, chords = rounded[share]
        return path, chords, slack if path.length > 0 else None

    for share in shares[:ROOMY]:
        path, chords, room = at(share)
        if with_room is not None and with_room(chords, room):
            return Finished(Certificate(True), timed(path), path, roomy=True)
    for share in shares:
        path, chords, room = at(share)
        certificate = checker.certify(chords, room, evidence=False)
        if certificate.free:
            return Finished(certificate, timed(path), path)
    # A start or goal within the slack of something cannot be proven with it: the bare edges can.
    path = BlendedPath(points, 0.0)
    certificate = checker.certify(path.points, evidence=False)
    if not certificate.free:
        return Finished(certificate)
    return Finished(certificate, timed(path), path)


def torque_model(scene: PlanningScene, joint_names: tuple[str, ...]) -> InverseDynamics:
    """The torques of a group's joints in a scene: the robot's links and what is attached to them."""
    payloads = []
    for body in scene.attached.values():
        centre, inertia = solid_inertia(body.object.shapes, body.object.mass_kg)
        pose = body.T_link_object @ SE3.from_xyz(*centre)
        payloads.append((body.link, Inertial(body.object.mass_kg, pose, inertia)))
    return InverseDynamics(scene.model, joint_names, scene.positions, payloads)


def clearance_along(checker: KernelChecker, trajectory: JointTrajectory) -> float:
    """Distance [m] that a motion is proven to keep, see `KernelChecker.clearance`; at most 0.25.

    A pair in resting contact at the start counts from where it no longer moves apart.
    """
    return clearance_from_rest(checker, trajectory.positions)
