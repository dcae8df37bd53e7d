"""How far an arm is from grasps, by the time that it takes; of grasps that are alike the nearest first."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armcell.core import SE3
from armcell.grasping import Grasp
from armcell.kinematics import IKSolver, ik_solver
from armcell.model import Gripper
from armcell.planning.industrial.ptp import synchronous
from armcell.scene import PlanningScene
from armcell.tasks.settings import Speed

Array = NDArray[np.float64]

ALIKE = 0.02  # of score that grasps may be worse than the best and are as good: the arm takes the nearest


@dataclass(frozen=True, eq=False)
class Reach:
    """A grasp, and the arm's positions (n,) before its approach; the time to there in empty space."""

    grasp: Grasp
    q: Array | None  # None: out of reach
    seconds: float  # [s]


@dataclass(frozen=True, eq=False)
class Reaching:
    """An arm on its ways from where it is to grasps and places, as if nothing stood between."""

    scene: PlanningScene
    gripper: Gripper
    distance: float  # [m] before a grasp, along its approach, where the way ends
    seed: int = 0

    @property
    def ik(self) -> IKSolver:
        return ik_solver(self.scene.model, self.gripper.arm_group, self.gripper.tcp_link)

    def nearest_first(
        self, T_world_object: SE3, grasps: Sequence[Grasp], q: Array, speed: Speed
    ) -> list[Reach]:
        """Those of the grasps, the best first, that are alike: a cube has them on four sides.

        Args:
            q: positions (n,) of the arm that the way begins at.
        """
        found = []
        for grasp in grasps:
            if grasp.score <= grasps[0].score - ALIKE:
                break
            back = SE3.from_xyz(0.0, 0.0, -self.distance)
            at = self.to(T_world_object @ grasp.T_object_tcp @ back, q)
            found.append(Reach(grasp, at, np.inf if at is None else round(self.seconds(q, at, speed), 3)))
        return sorted(found, key=lambda reach: reach.seconds)

    def to(self, T_world_tcp: SE3, q: Array) -> Array | None:
        """Positions (n,) of the arm with its tcp at a pose, near those (n,) it has; None if out of reach."""
        reference = self.scene.positions.copy()
        reference[self.ik.columns] = q
        rng = np.random.default_rng(self.seed)
        return next(self.ik.solutions(T_world_tcp, reference, rng), None)

    def seconds(self, q: Array, to: Array, speed: Speed) -> float:
        """The least time [s] of a motion straight in the joints' space, at shares of their limits."""
        if not np.any(to != q):
            return 0.0
        model, names = self.scene.model, self.ik.joint_names
        acceleration = model.limits(names, "acceleration") * speed.acceleration
        velocity = model.limits(names, "velocity") * speed.velocity
        return synchronous(to - q, velocity, acceleration, acceleration).duration
