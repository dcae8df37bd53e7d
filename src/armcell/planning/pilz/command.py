"""Input and output of the PTP, LIN and CIRC generators: motion command and generated motion."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armcell.collision.kernel.checker import KernelChecker
from armcell.core import SE3, ErrorCode, JointGoal, JointTrajectory, NamedGoal, Outcome, PlanRequest, PoseGoal
from armcell.planning.moved_frame import MovedFrame
from armcell.planning.pilz.paths import Curve, JointLine
from armcell.planning.pilz.settings import PilzSettings
from armcell.planning.pilz.velocity_profile import Profile, Trapezoid
from armcell.planning.request import ValidatedRequest
from armcell.timing import stationary_trajectory

Array = NDArray[np.float64]

AT_GOAL = 1e-9  # [m, rad or joint units] shorter motions count as standstill


@dataclass(frozen=True, eq=False)
class MotionCommand:
    """Pilz motion command (PTP, LIN or CIRC), which leads from joint positions (n,) to the goal of the
    request.
    """

    validated: ValidatedRequest
    checker: KernelChecker
    start: Array
    goal: Array

    @property
    def request(self) -> PlanRequest:
        return self.validated.request

    @property
    def settings(self) -> PilzSettings:
        return self.validated.choice.settings

    def moved_frame(self, link: str | None = None) -> MovedFrame:
        """Return the frame that a Pilz motion command moves: the link of the goal, or the tip of the
        group.
        """
        wanted = self.request.goals[0]
        named = wanted.link if isinstance(wanted, PoseGoal) else link
        return MovedFrame(self.validated.scene, self.request.group, named)

    def goal_pose(self, moved_frame: MovedFrame) -> SE3:
        """Compute the pose T_world_tip to which a Pilz motion command moves its frame."""
        wanted = self.request.goals[0]
        return wanted.T_world_link if isinstance(wanted, PoseGoal) else moved_frame.pose(self.goal)

    @property
    def goal_joints(self) -> Array | None:
        """Joint positions (n,) to which a Pilz motion command leads if it has a joint goal, else None."""
        return self.goal if isinstance(self.request.goals[0], JointGoal | NamedGoal) else None

    def stationary_motion(self) -> GeneratedMotion:
        """Generate a motion with a single trajectory point for a Pilz motion command whose goal is the
        current position.
        """
        trajectory = stationary_trajectory(self.validated.joint_names, self.start)
        return GeneratedMotion(JointLine(self.start, self.start), trajectory)

    def stopped(self) -> Outcome | None:
        """Return the outcome if a Pilz motion command must stop because it is canceled or its time is up,
        else None.
        """
        if self.validated.cancel.is_set():
            return Outcome(ErrorCode.PREEMPTED, f"{self.validated.planner_id}: cancelled")
        if time.monotonic() > self.validated.deadline:
            return Outcome(ErrorCode.TIMED_OUT, f"{self.validated.planner_id}: the time is over")
        return None

    def tip_profile(self, length: float, angle: float) -> Profile:
        """Compute the velocity profile of a Pilz motion command along a tip path of given length [m] and
        rotation [rad], as a function of s in 0..1.

        The profile accelerates and brakes the longer of length and angle (scaled by the equivalent radius),
        like KDL's paths, which MoveIt uses.
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
class GeneratedMotion:
    """Motion that was generated from a Pilz motion command and is not yet certified.

    It has a joint curve, a trajectory and the frame of its tip (if any).
    """

    curve: Curve
    trajectory: JointTrajectory
    moved_frame: MovedFrame | None = None


Generator = Callable[[MotionCommand], GeneratedMotion | Outcome]


def time_curve(curve: Curve, profile: Profile, joint_names: tuple[str, ...]) -> JointTrajectory:
    """Turn the joint curve of a Pilz motion command into a trajectory, with the timing that a velocity
    profile defines.
    """
    times = profile.times()
    s, speed, acceleration = profile.at(times)
    s[0], speed[0], acceleration[0] = 0.0, 0.0, 0.0
    s[-1], speed[-1], acceleration[-1] = 1.0, 0.0, 0.0
    q, first, second = curve.at(s)
    v = first * speed[:, None]
    a = second * speed[:, None] ** 2 + first * acceleration[:, None]
    return JointTrajectory(joint_names, times, q, v, a)
