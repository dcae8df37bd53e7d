"""Two UR10 in their cell, poses of their tips, and an independent judge: coal on the whole scene."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

import armcell
from armcell.collision import ExactChecker
from armcell.collision.inter_arm_checker import without_arms
from armcell.core import SE3, JointTrajectory, PlanRequest, PoseGoal
from armcell.planning import RunningMotion, plan
from armcell.scene import PlanningScene

LEFT, RIGHT = "left_arm", "right_arm"
OTHER = {LEFT: RIGHT, RIGHT: LEFT}
FAST = {"velocity_scaling": 0.6, "acceleration_scaling": 0.25, "planning_time": 10.0}
SLOW = {"velocity_scaling": 0.3, "acceleration_scaling": 0.1}


@lru_cache(maxsize=1)
def scene() -> PlanningScene:
    return armcell.load("dual_ur10").scene()


def tip(x: float, y: float, z: float = 1.05, yaw: float = 0.0) -> PoseGoal:
    """A gripper that points down."""
    return PoseGoal(SE3.from_xyz_rpy((x, y, z), (np.pi, 0.0, yaw)))


def motion(at: PlanningScene, group: str, goal: PoseGoal, **speeds) -> JointTrajectory:
    """One arm alone to a pose."""
    result = plan(without_arms(at, OTHER[group]), PlanRequest(group, (goal,), **(speeds or FAST)))
    assert result.ok and result.trajectory is not None, result.message
    return result.trajectory


def with_tips(left: tuple, right: tuple) -> PlanningScene:
    """The scene with both tips somewhere."""
    at = scene()
    for group, xyz in ((LEFT, left), (RIGHT, right)):
        at = at.with_state(motion(at, group, tip(*xyz)).end)
    return at


class Judge:
    """Coal on all that the robot is made of: distances between links of different arms only."""

    def __init__(self, at: PlanningScene, group: str = "both_arms"):
        self.names = at.model.group(group).joint_names
        self.checker = ExactChecker(at, self.names)
        side = [g.body.split("_")[0] for g in self.checker.geometries]
        links = at.model.links
        bodies = [g.body in links or g.body in at.attached for g in self.checker.geometries]
        moved = [not g.body.endswith("base_link") for g in self.checker.geometries]
        self.pairs = np.array(
            [
                (a, b)
                for a, b in self.checker.pairs
                if bodies[a] and bodies[b] and moved[a] and moved[b] and side[a] != side[b]
            ]
        )

    def nearest(self, *motions: RunningMotion, step: float = 1e-3, cutoff: float = 0.05) -> float:
        """Smallest distance [m] over all samples of motions on one clock; at most `cutoff`."""
        best, end = cutoff, max(m.end for m in motions)
        columns = [[self.names.index(n) for n in m.trajectory.joint_names] for m in motions]
        q = np.zeros(len(self.names))
        for t in np.arange(min(m.start for m in motions), end + step, step):
            for m, at in zip(motions, columns, strict=True):
                q[at] = m.trajectory.sample(t - m.start)[0]
            self.checker.set_configuration(q)
            near = np.flatnonzero(self.checker.pair_gaps(self.pairs) < best)
            for a, b in self.pairs[near]:
                best = min(best, self.checker.pair_distance(int(a), int(b)))
        return best
