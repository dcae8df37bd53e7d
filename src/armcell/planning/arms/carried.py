"""An object in two hands: where both arms' joints are for a pose of it, each arm near where it was."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from armcell.core import SE3
from armcell.kinematics import ik_solver
from armcell.scene import PlanningScene

Array = NDArray[np.float64]

JUMP = 0.2  # [rad] of a joint: more than that between two near poses is another branch


@dataclass(frozen=True, eq=False)
class Carried:
    """An object in two hands: by group, the pose of the hand's tcp in the object's frame."""

    name: str
    grasps: Mapping[str, SE3]  # T_object_tcp
    tips: Mapping[str, str]  # by group, the tcp link

    @property
    def radius(self) -> float:
        """[m] of a hand from the object's origin, at most: what a turn of the object moves a hand by."""
        return max(0.1, *(float(np.linalg.norm(T.translation)) for T in self.grasps.values()))


@dataclass(frozen=True)
class Stuck:
    """Why an arm cannot follow."""

    group: str
    share: float  # of the way
    jumps: bool  # else it does not reach

    def __str__(self) -> str:
        at = f"{100 * self.share:.0f} %"
        if self.jumps:
            return f"{self.group} would have to change its posture at {at}"
        return f"{self.group} does not reach {at} of it"


class Hands:
    """Inverse kinematics of both arms with the grasps fixed. Positions `q` are of all joints (dof,)."""

    def __init__(self, scene: PlanningScene, carried: Carried):
        self.carried = carried
        self.solvers = {g: ik_solver(scene.model, g, carried.tips[g]) for g in carried.grasps}

    def at(self, T: SE3, last: Array, share: float = 0.0, jump: float = JUMP) -> Array | Stuck:
        """Positions with the object at T (T_world_object), of the branch that `last` is on."""
        new = last.copy()
        for group, ik in self.solvers.items():
            near = ik.nearest(T @ self.carried.grasps[group], last, among=8)
            if not near:
                return Stuck(group, share, False)
            if np.max(np.abs(near[0] - last[ik.columns])) > jump:
                return Stuck(group, share, True)
            new[ik.columns] = near[0]
        return new

    def along(self, poses: Sequence[SE3], shares: Array, q: Array) -> Array | Stuck:
        """Positions (k, dof) for poses at shares of a way, each of which is near the one before."""
        rows, last = [], q
        for T, share in zip(poses, shares, strict=True):
            last = self.at(T, last, float(share))
            if isinstance(last, Stuck):
                return last
            rows.append(last)
        return np.array(rows)

    def postures(self, T: SE3, q: Array) -> list[Array] | Stuck:
        """Positions with the object at T, of whatever branches, the nearest to q first."""
        options = []
        for group, ik in self.solvers.items():
            options.append(ik.nearest(T @ self.carried.grasps[group], q, among=8))
            if not options[-1]:
                return Stuck(group, 1.0, False)
        found = []
        for choice in product(*options):
            new = q.copy()
            for ik, own in zip(self.solvers.values(), choice, strict=True):
                new[ik.columns] = own
            found.append(new)
        return sorted(found, key=lambda p: float(np.abs(p - q).max()))
