"""Why not? The evidence behind a pose that cannot be reached, one joint solution at a time."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from armcell.collision import ExactChecker
from armcell.core import SE3, Contact
from armcell.kinematics import ik_solver
from armcell.scene import PlanningScene

MAX_BRANCHES = 16


@dataclass(frozen=True, eq=False)
class Branch:
    """One joint solution (n,) of a pose and what touches there (or is within the padding)."""

    positions: np.ndarray
    contacts: list[Contact]

    @property
    def free(self) -> bool:
        return not self.contacts


@dataclass(frozen=True, eq=False)
class PoseExplanation:
    """What stands between an arm and a pose."""

    reachable: bool
    summary: str
    joint_names: tuple[str, ...]
    branches: list[Branch] = field(default_factory=list)
    start_contacts: list[Contact] = field(default_factory=list)
    position_error: float = 0.0  # [m] of the closest pose, where there is no solution
    rotation_error: float = 0.0  # [rad]
    joints_at_limit: list[str] = field(default_factory=list)


def explain_pose(
    scene: PlanningScene, group: str, target: SE3, link: str | None = None, seed: int = 0
) -> PoseExplanation:
    """Look at every joint solution found for a pose of a link (the group's tip by default)."""
    ik = ik_solver(scene.model, group, link)
    checker = ExactChecker(scene, ik.joint_names)
    start = checker.contacts(scene.positions[ik.columns], padded=False)
    rng = np.random.default_rng(seed)
    branches = []
    for q in ik.solutions(target, scene.positions, rng):
        branches.append(Branch(q, checker.contacts(q)))
        if len(branches) >= MAX_BRANCHES:
            break
    branches.sort(key=lambda b: (not b.free, -min((c.distance for c in b.contacts), default=0.0)))
    if not branches:
        result = ik.solve(target, scene.positions, rng=rng)
        limits = result.evidence.get("joints_at_limit", [])
        return PoseExplanation(
            False,
            result.message,
            ik.joint_names,
            [],
            start,
            result.position_error,
            result.rotation_error,
            limits,
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
    return PoseExplanation(free > 0, summary, ik.joint_names, branches, start)
