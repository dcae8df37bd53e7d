"""Diagnosis of an unreachable pose, with evidence for every joint solution."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import islice

import numpy as np

from armcell.collision import ExactChecker
from armcell.core import SE3, Contact
from armcell.kinematics import IKSettings, IKSolver, ik_solver
from armcell.model import RobotModel
from armcell.planning.diagnosis import text_format
from armcell.scene import PlanningScene

MAX_BRANCHES = 16
MAX_OUTSIDE = 8
OUTSIDE = IKSettings(seeds=60)


@dataclass(frozen=True, eq=False)
class IKBranch:
    """IK solution of a possibly unreachable pose, with its contacts and the amounts by which it violates
    joint limits.

    Attributes:
        positions: (n,) joint positions of the solution.
        contacts: contacts of the solution, including pairs within the padding.
        beyond: amount by which joints are outside their limits [rad or m].
    """

    positions: np.ndarray
    contacts: list[Contact]
    beyond: Mapping[str, float] = field(default_factory=dict)

    @property
    def free(self) -> bool:
        """Return whether an IK solution of a possibly unreachable pose respects the joint limits and has no
        contact.
        """
        return not self.contacts and not self.beyond

    def reason(self, model: RobotModel) -> str:
        """Describe why an IK solution of an unreachable pose is invalid: by its limit violations, or else by
        its contacts. Return "free" for a solution without either.
        """
        outside = [
            f"{n} {text_format.joint_value(model, n, v)} beyond its limit" for n, v in self.beyond.items()
        ]
        return "; ".join(outside) or text_format.contacts(self.contacts) or "free"


@dataclass(frozen=True, eq=False)
class PoseExplanation:
    """Explanation of why an arm cannot reach a pose, with all joint solutions of this pose.

    Attributes:
        branches: solutions within limits; free ones first, then by depth of contact.
        outside: solutions that only joint limits forbid, smallest violation first.
        distance, reach: distance of the pose from the first joint, and the arm's reach [m].
    """

    reachable: bool
    summary: str
    joint_names: tuple[str, ...]
    branches: list[IKBranch] = field(default_factory=list)
    start_contacts: list[Contact] = field(default_factory=list)
    position_error: float = 0.0  # [m] of the closest pose, if there is no solution
    rotation_error: float = 0.0  # [rad]
    joints_at_limit: list[str] = field(default_factory=list)
    outside: list[IKBranch] = field(default_factory=list)
    closest: np.ndarray | None = None  # (n,) if there is no solution
    distance: float | None = None
    reach: float | None = None


def explain_pose(
    scene: PlanningScene, group: str, target: SE3, link: str | None = None, seed: int = 0
) -> PoseExplanation:
    """Explain why a link (by default, the tip of the group) cannot reach a pose, by examining every joint
    solution of the pose.
    """
    ik = ik_solver(scene.model, group, link)
    checker = ExactChecker(scene, ik.joint_names)
    start = checker.contacts(scene.positions[ik.columns], padded=False)
    rng = np.random.default_rng(seed)
    branches = []
    for q in ik.solutions(target, scene.positions, rng):
        branches.append(IKBranch(q, checker.contacts(q)))
        if len(branches) >= MAX_BRANCHES:
            break
    branches.sort(key=lambda b: (not b.free, -min((c.distance for c in b.contacts), default=0.0)))
    outside = solutions_beyond_limits(scene, group, target, link, seed)
    if not branches:
        result = ik.solve(target, scene.positions, rng=rng)
        return PoseExplanation(
            False,
            result.message,
            ik.joint_names,
            [],
            start,
            result.position_error,
            result.rotation_error,
            result.evidence.get("joints_at_limit", []),
            outside,
            result.positions,
            result.evidence.get("distance_m"),
            result.evidence.get("reach_m"),
        )
    free = sum(b.free for b in branches)
    if free:
        summary = f"{free} of {len(branches)} joint solutions are free"
    else:
        worst = branches[0].contacts[0]
        summary = (
            f"each of {len(branches)} joint solutions touches something; in the best one {worst.describe()}"
        )
    if start:
        summary += f"; but the start is in collision: {start[0].describe()}"
    return PoseExplanation(free > 0, summary, ik.joint_names, branches, start, outside=outside)


def solutions_beyond_limits(
    scene: PlanningScene, group: str, target: SE3, link: str | None = None, seed: int = 0
) -> list[IKBranch]:
    """Find the joint solutions of a pose that are excluded only by joint limits; the smallest violation comes
    first.
    """
    ik = ik_solver(scene.model, group, link)
    rng = np.random.default_rng(seed)
    found = []
    for q in islice(_without_limits(scene.model, group, link).solutions(target, scene.positions, rng),
                    MAX_BRANCHES):  # fmt: skip
        at = _turned_in(ik, q)
        over = np.maximum(np.maximum(ik.lower - at, at - ik.upper), 0.0)
        if over.max() > 1e-6:
            beyond = {n: float(v) for n, v in zip(ik.joint_names, over, strict=True) if v > 1e-6}
            found.append(IKBranch(at, [], beyond))
    found.sort(key=lambda b: sum(b.beyond.values()))
    return found[:MAX_OUTSIDE]


def _turned_in(ik: IKSolver, q: np.ndarray) -> np.ndarray:
    """Rotate the revolute joints in an IK solution of an unreachable pose by full turns, so that they exceed
    their limits as little as possible.
    """
    at = q.copy()
    for k, name in enumerate(ik.joint_names):
        if ik.model.joint(name).type != "prismatic":
            values = q[k] + 2 * np.pi * np.arange(-2, 3)
            at[k] = min(values, key=lambda v, k=k: max(ik.lower[k] - v, v - ik.upper[k], 0.0))
    return at


@lru_cache(maxsize=8)
def _without_limits(model: RobotModel, group: str, link: str | None) -> IKSolver:
    """Create an IK solver without limits for revolute joints, which shows whether only joint limits make a
    pose unreachable.
    """
    joints = {
        name: replace(joint, limits=replace(joint.limits, lower=-np.inf, upper=np.inf))
        if joint.type == "revolute"
        else joint
        for name, joint in model.joints.items()
    }
    kind = type(ik_solver(model, group, link))
    return kind(replace(model, joints=joints), group, link, OUTSIDE)
