"""Checks of generated motions: joint velocity and acceleration limits, and collisions."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from armcell.collision.kernel.checker import KernelChecker
from armcell.core import Contact, ErrorCode, JointTrajectory, Outcome, PlanRequest
from armcell.model import RobotModel
from armcell.planning.moved_frame import MovedFrame
from armcell.planning.pilz.paths import Curve
from armcell.timing.moving_average import peaks

Array = NDArray[np.float64]

ROUNDING = 1e-6
SPARE = 1.02  # safety factor of the suggested slowdown


def check_joint_limits(
    model: RobotModel, trajectory: JointTrajectory, request: PlanRequest | None, what: str = ""
) -> Outcome | None:
    """Check whether a PTP, LIN or CIRC motion respects the joint limits. Return None if it does, else the
    worst joint and the slowdown that would help.

    The limits are the joints' own: the request's scalings apply to the tip, as in MoveIt.

    Args:
        request: request whose scalings define the motion; None if two scalings cannot describe the motion.
    """
    names = trajectory.joint_names
    velocity, acceleration = model.limits(names, "velocity"), model.limits(names, "acceleration")
    q, v, a = trajectory.positions, trajectory.velocities, trajectory.accelerations
    assert v is not None and a is not None
    peak_v, peak_a = peaks(trajectory.times, q, v, a, velocity, acceleration)
    if peak_v <= 1.0 + ROUNDING and peak_a <= 1.0 + ROUNDING:
        return None
    slower = max(peak_v, float(np.sqrt(peak_a)))
    by_velocity = peak_v >= np.sqrt(peak_a)
    ratios = np.abs(v) / velocity if by_velocity else np.abs(a) / acceleration
    row, joint = (int(i) for i in np.unravel_index(np.argmax(ratios), ratios.shape))
    kind, unit = ("velocity", "rad/s") if by_velocity else ("acceleration", "rad/s^2")
    if model.joint(names[joint]).type == "prismatic":
        unit = unit.replace("rad", "m")
    limit = float((velocity if by_velocity else acceleration)[joint])
    needed = limit * float(peak_v if by_velocity else peak_a)
    at = float(trajectory.times[row] / trajectory.duration)
    text = (
        f"{what}{names[joint]} would need a {kind} of {needed:.3g} {unit} at {at:.0%} of the time, "
        f"its limit is {limit:.3g}: it has to be {slower:.3g} times slower"
    )
    evidence = {"joint": names[joint], kind: needed, "limit": limit, "slower": slower, "fraction": at}
    if request is not None:
        v_scale = request.velocity_scaling / (slower * SPARE)
        a_scale = request.acceleration_scaling / (slower * SPARE) ** 2
        text += f" (velocity_scaling {v_scale:.3g} with acceleration_scaling {a_scale:.3g} would do)"
        evidence |= {"velocity_scaling": v_scale, "acceleration_scaling": a_scale}
    return Outcome(ErrorCode.PLANNING_FAILED, text, evidence)


SAGITTAS = (2e-4, 1e-5)
"""[rad or m] deviation of the proven chords from the motion; the second if the first is too coarse."""

BETWEEN_POINTS = 1e-7  # [rad or m] deviation of the interpolation between trajectory points from the curve
TOUCH_STEP = 0.005  # [rad or m] resolution of the first contact
PADDING_STEP = 0.03  # [rad] between padding checks


def prove_motion_free(
    checker: KernelChecker, curve: Curve, moved_frame: MovedFrame | None, what: str
) -> Array | Outcome:
    """Prove that a PTP, LIN or CIRC motion is collision-free, and return its points (k, n).
    The proof ignores the padding, which is checked only at samples of the motion.

    If the motion is not free, return the contact.
    """
    points = np.empty((0, 0))
    certificate = None
    for sagitta in SAGITTAS:
        points, slack = curve.polyline(sagitta)
        certificate = checker.certify(points, slack + BETWEEN_POINTS, evidence=sagitta == SAGITTAS[-1])
        if certificate.free:
            break
    assert certificate is not None
    if not certificate.free:
        at, q = _first_touching(checker, points, certificate.at)
        contacts = checker.exact.contacts(q, padded=False) or [c for c in [certificate.contact] if c]
        return _touches(what, at, q, contacts, moved_frame)
    for k, (a, b) in enumerate(pairwise(points)):
        if not checker.edge_is_free(a, b, PADDING_STEP):
            q, share = _first_padded(checker, a, b)
            return _touches(what, (k + share) / (len(points) - 1), q, checker.exact.contacts(q), moved_frame)
    return points


def _between(points: Array, at: float) -> Array:
    place = at * (len(points) - 1)
    k = min(int(place), len(points) - 2)
    return points[k] + (place - k) * (points[k + 1] - points[k])


def _first_touching(checker: KernelChecker, points: Array, at: float) -> tuple[float, Array]:
    """Find the first contact on a PTP, LIN or CIRC motion,
    given a later point of the motion at which there is a contact.

    The certification does not test a motion from its start to its end.
    """
    length = float(np.abs(np.diff(points, axis=0)).max(axis=1).sum())
    for share in np.linspace(0.0, at, max(int(np.ceil(length * at / TOUCH_STEP)), 1), endpoint=False):
        if checker.touches(q := _between(points, float(share))):
            return float(share), q
    return at, _between(points, at)


def _first_padded(checker: KernelChecker, a: Array, b: Array) -> tuple[Array, float]:
    count = max(int(np.ceil(np.max(np.abs(b - a)) / PADDING_STEP)), 1)
    for share in np.linspace(0.0, 1.0, count + 1):
        if not checker.is_free(a + share * (b - a)):
            return a + share * (b - a), float(share)
    return b, 1.0


def _touches(
    what: str, at: float, q: Array, contacts: list[Contact], moved_frame: MovedFrame | None
) -> Outcome:
    where = ""
    if moved_frame is not None:
        where = (
            f", {moved_frame.name} at ("
            + ", ".join(f"{v:.3f}" for v in moved_frame.pose(q).translation)
            + ")"
        )
    text = "; ".join(c.describe() for c in contacts[:3]) or "it cannot be proven free"
    evidence = {"contacts": contacts, "fraction": at, "positions": q}
    return Outcome(ErrorCode.INVALID_MOTION_PLAN, f"{what} at {at:.0%} of the path{where}: {text}", evidence)
