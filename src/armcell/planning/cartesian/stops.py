"""Why a line stops: the cause, in words and as evidence."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armcell.core import SE3, Contact, ErrorCode
from armcell.kinematics import IKSolver
from armcell.planning.constraints.description import Manifold, Violation

Array = NDArray[np.float64]

SINGULAR = 0.05  # smallest singular value of the Jacobian [m, rad]: far below what working arms have

COLLISION, CONSTRAINT, JUMP, LIMIT, REACH, SINGULARITY, BRANCH = (
    "collision", "path constraint", "jump", "joint limit", "out of reach", "singularity", "no way on",
)  # fmt: skip


LEAD_OUT = (
    "the line begins in contact and does not lead out of it: begin with a waypoint a few millimeters off "
    "what it touches, or allow the contact"
)

TURNING, SLIDING, RELATIVE = "jump_threshold", "prismatic_jump_threshold", "relative_jump_threshold"
"""The thresholds of a request."""


@dataclass(frozen=True, eq=False)
class Stop:
    """The first step that cannot be taken.

    Attributes:
        tell: works out the cause, its words, code and evidence; only asked for the best of all attempts.
    """

    tell: Callable[[], Told]


@dataclass(frozen=True, eq=False)
class Told:
    """`cause` is one of the words above."""

    cause: str
    text: str
    code: ErrorCode
    evidence: dict[str, Any] = field(default_factory=dict)


def collided(contacts: list[Contact]) -> Told:
    text = "; ".join(c.describe() for c in contacts[:3]) or "in collision"
    return Told(COLLISION, text, ErrorCode.INVALID_MOTION_PLAN, {"contacts": contacts})


def jumped(joint: str, step: float, threshold: float, field: str, unit: str) -> Told:
    """Args:
    threshold: of the request, [unit] or a factor. field: its name there.
    """
    what = f"{threshold:g} times the mean step" if field == RELATIVE else f"threshold {threshold:g}"
    text = f"{joint} would jump {step:.2f} {unit} ({what})"
    return Told(JUMP, text, ErrorCode.PLANNING_FAILED, {"joint": joint, "step": step, "field": field})


def at_violation(manifold: Manifold, q: Array) -> list[Violation]:
    """What q (n,) does not keep to, or keeps to by so little that no motion there could be proven."""
    return manifold.violations(q, inside=manifold.allowance == 0.0)


def violated(manifold: Manifold, q: Array) -> Told:
    found = at_violation(manifold, q)
    words = [
        v.text if v.amount > manifold.edge else f"{v.name} comes to the edge of its {v.kind} constraint"
        for v in found[:3]
    ]
    text = "; ".join(words) or "the way between two steps leaves the path constraints"
    evidence = {"violations": found, "constraints": [v.name for v in found]}
    return Told(CONSTRAINT, text, ErrorCode.INVALID_MOTION_PLAN, evidence)


def unreached(
    ik: IKSolver, pose: SE3, before: Array, closest: Array, short: tuple[float, float], limits: list[str]
) -> Told:
    """Args:
    before: (dof,) where it stands. closest: (dof,) the nearest to the pose that it gets from there.
    short: [m], [rad] that are missing there. limits: joints at their limits there.
    """
    J = ik.tree.jacobian(closest, ik.tip_link, ik.joint_names)
    least = float(np.linalg.svd(J, compute_uv=False)[-1])
    evidence: dict[str, Any] = {
        "joints_at_limit": limits,
        "missing_m": short[0],
        "missing_rad": short[1],
        "least_singular_value": least,
        "near_singularity": least < SINGULAR,
    }
    if limits:
        cause, text = LIMIT, f"{', '.join(limits)} at the limit"
    elif next(iter(ik.solutions(pose, before)), None) is None:
        cause, text = REACH, "out of reach"
        evidence["reach_m"] = ik.prepared.chain.reach
    elif least < SINGULAR:
        cause, text = SINGULARITY, f"singular (smallest singular value {least:.3f})"
    else:
        cause, text = BRANCH, "the pose can be reached with the arm otherwise, but not from here"
    missing = f"{short[0] * 1000:.1f} mm, {np.rad2deg(short[1]):.1f} deg short"
    return Told(cause, f"{text} ({missing})", ErrorCode.NO_IK_SOLUTION, evidence)
