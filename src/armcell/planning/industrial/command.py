"""What PTP, LIN and CIRC are given, and what they make of it."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armcell.collision.kernel.checker import KernelChecker
from armcell.core import SE3, ErrorCode, JointGoal, JointTrajectory, NamedGoal, Outcome, PlanRequest, PoseGoal
from armcell.planning.industrial.curves import Curve, JointLine
from armcell.planning.industrial.profile import Profile, Trapezoid
from armcell.planning.industrial.settings import IndustrialSettings
from armcell.planning.placed import Placed
from armcell.planning.question import Question

Array = NDArray[np.float64]

AT_GOAL = 1e-9  # [m, rad or joint units] less than this is no motion


@dataclass(frozen=True, eq=False)
class Command:
    """One motion to make: from joint positions (n,) to others, found for the request's goal."""

    question: Question
    checker: KernelChecker
    start: Array
    goal: Array

    @property
    def request(self) -> PlanRequest:
        return self.question.request

    @property
    def settings(self) -> IndustrialSettings:
        return self.question.choice.settings

    def placed(self, link: str | None = None) -> Placed:
        """What is moved along a way: the link that the goal is for, or the group's tip."""
        wanted = self.request.goals[0]
        named = wanted.link if isinstance(wanted, PoseGoal) else link
        return Placed(self.question.scene, self.request.group, named)

    def goal_pose(self, placed: Placed) -> SE3:
        """T_world_tip of the goal."""
        wanted = self.request.goals[0]
        return wanted.T_world_link if isinstance(wanted, PoseGoal) else placed.pose(self.goal)

    @property
    def goal_joints(self) -> Array | None:
        """(n,) where the goal was given as joint positions."""
        return self.goal if isinstance(self.request.goals[0], JointGoal | NamedGoal) else None

    def standing(self) -> Made:
        """No motion: one point, for a goal where the robot is."""
        zero = np.zeros((1, len(self.start)))
        names = self.question.joint_names
        trajectory = JointTrajectory(names, np.zeros(1), self.start[None], zero, zero)
        return Made(JointLine(self.start, self.start), trajectory)

    def stopped(self) -> Outcome | None:
        if self.question.cancel.is_set():
            return Outcome(ErrorCode.PREEMPTED, f"{self.question.planner_id}: cancelled")
        if time.monotonic() > self.question.deadline:
            return Outcome(ErrorCode.TIMED_OUT, f"{self.question.planner_id}: the time is over")
        return None

    def along(self, length: float, angle: float) -> Profile:
        """The profile for a way of the tip [m], [rad] within the Cartesian limits, over s in 0..1.

        The longer of length and angle (by the equivalent radius) is what is accelerated and braked, as in
        KDL's paths, which MoveIt uses.
        """
        limits, request = self.settings.limits, self.request
        way = max(length, angle * limits.equivalent_radius)
        faster = request.acceleration_scaling
        trapezoid = Trapezoid.fastest(
            1.0, request.velocity_scaling * limits.max_trans_vel / way,
            faster * limits.max_trans_acc / way, faster * limits.max_trans_dec / way,
        )  # fmt: skip
        return Profile(trapezoid, self.settings.smoothing)


@dataclass(frozen=True, eq=False)
class Made:
    """A motion before it is proven: its curve and its trajectory, and where its tip is (if it has one)."""

    curve: Curve
    trajectory: JointTrajectory
    placed: Placed | None = None


Generator = Callable[[Command], Made | Outcome]


def timed(curve: Curve, profile: Profile, joint_names: tuple[str, ...]) -> JointTrajectory:
    """A curve run through by a profile over its parameter."""
    times = profile.times()
    s, speed, acceleration = profile.at(times)
    s[0], speed[0], acceleration[0] = 0.0, 0.0, 0.0
    s[-1], speed[-1], acceleration[-1] = 1.0, 0.0, 0.0
    q, first, second = curve.at(s)
    v = first * speed[:, None]
    a = second * speed[:, None] ** 2 + first * acceleration[:, None]
    return JointTrajectory(joint_names, times, q, v, a)
