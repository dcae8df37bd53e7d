"""Estimates of the time from an arm's state to grasps, to sort equally good grasps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armcell.core import SE3
from armcell.grasping import Grasp
from armcell.kinematics import IKSolver, ik_solver
from armcell.model import Gripper
from armcell.planning import synchronized_profile
from armcell.scene import PlanningScene
from armcell.tasks.settings import Speed

Array = NDArray[np.float64]

ALIKE = 0.02  # score difference below which grasps count as equally good


@dataclass(frozen=True, eq=False)
class ReachEstimate:
    """Estimate of how an arm reaches a grasp: its joint positions (n,) before the approach,
    and the travel time to them.

    The time ignores obstacles.
    """

    grasp: Grasp
    q: Array | None  # None: unreachable
    seconds: float  # [s]


@dataclass(frozen=True, eq=False)
class ReachEstimator:
    """Estimator of the time that an arm needs to reach grasps and placements, without regard to obstacles."""

    scene: PlanningScene
    gripper: Gripper
    distance: float  # [m] before the grasp, along its approach, where the motion ends
    seed: int = 0

    @property
    def ik(self) -> IKSolver:
        return ik_solver(self.scene.model, self.gripper.arm_group, self.gripper.tcp_link)

    def nearest_first(
        self, T_world_object: SE3, grasps: Sequence[Grasp], q: Array, speed: Speed
    ) -> list[ReachEstimate]:
        """Sort grasps of about equal quality by the time that the arm needs to reach them, nearest first.

        On a cube, for example, the grasps on its four sides are equally good.

        Args:
            q: start positions (n,) of the arm.
        """
        found = []
        for grasp in grasps:
            if grasp.score <= grasps[0].score - ALIKE:
                break
            back = SE3.from_xyz(0.0, 0.0, -self.distance)
            at = self.ik_near(T_world_object @ grasp.T_object_tcp @ back, q)
            found.append(
                ReachEstimate(grasp, at, np.inf if at is None else round(self.seconds(q, at, speed), 3))
            )
        return sorted(found, key=lambda reach: reach.seconds)

    def ik_near(self, T_world_tcp: SE3, q: Array) -> Array | None:
        """Return joint positions (n,) near q (n,) with which the arm
        reaches the TCP pose of a grasp, or None.

        The result is None if the pose is unreachable.
        """
        reference = self.scene.positions.copy()
        reference[self.ik.columns] = q
        rng = np.random.default_rng(self.seed)
        return next(self.ik.solutions(T_world_tcp, reference, rng), None)

    def seconds(self, q: Array, to: Array, speed: Speed) -> float:
        """Return the minimum time [s] in which a straight joint-space motion can bring the arm to a grasp, at
        given fractions of its speed limits.
        """
        if not np.any(to != q):
            return 0.0
        model, names = self.scene.model, self.ik.joint_names
        acceleration = model.limits(names, "acceleration") * speed.acceleration
        velocity = model.limits(names, "velocity") * speed.velocity
        return synchronized_profile(to - q, velocity, acceleration, acceleration).duration
