"""Planning of one PTP, LIN or CIRC motion: motion command, generators, checks and certification.

PTP moves the joints synchronously, LIN moves the tip on a line, CIRC moves the tip on an arc. There is
no search.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armcell.collision.kernel.checker import KernelChecker
from armcell.core import (
    SE3,
    WORLD,
    ErrorCode,
    InputError,
    JointGoal,
    JointPath,
    JointTrajectory,
    NamedGoal,
    Outcome,
    PlanRequest,
    PlanResult,
    PoseGoal,
)
from armcell.core.checks import float_array, require
from armcell.planning.certify import clearance_along, complete_motion
from armcell.planning.moved_frame import MovedFrame
from armcell.planning.pilz.paths import (
    Curve,
    JointLine,
    Line,
    TipPath,
    arc_around,
    arc_through,
    check_joint_limits,
    follow_path,
    prove_motion_free,
    solver_for,
)
from armcell.planning.pilz.settings import AUXILIARY, PilzSettings
from armcell.planning.pilz.velocity_profile import Profile, Trapezoid
from armcell.planning.planners.registry import PILZ, pipelines
from armcell.planning.request import ValidatedRequest
from armcell.timing import stationary_trajectory

F64 = NDArray[np.float64]

AT_GOAL = 1e-9  # [m, rad or joint units] shorter motions count as standstill
_CURE = (
    "give parameters={'interim': (x, y, z)} or {'center': (x, y, z)}, "
    "or path constraints of one of these names with one position constraint"
)
STANDING = 1e-8  # [rad/s or m/s] largest start velocity that counts as rest (MoveIt's VELOCITY_TOLERANCE)


@dataclass(frozen=True, eq=False)
class MotionCommand:
    """Command from which a Pilz motion (PTP, LIN or CIRC) is generated. It leads from joint positions (n,) to
    the goal of the request.
    """

    validated: ValidatedRequest
    checker: KernelChecker
    start: F64
    goal: F64

    @property
    def request(self) -> PlanRequest:
        return self.validated.request

    @property
    def settings(self) -> PilzSettings:
        return self.validated.choice.settings

    def moved_frame(self, link: str | None = None) -> MovedFrame:
        """Return the frame that a Pilz motion command moves: the link that the goal names or, by default, the
        tip of the group.
        """
        wanted = self.request.goals[0]
        named = wanted.link if isinstance(wanted, PoseGoal) else link
        return MovedFrame(self.validated.scene, self.request.group, named)

    def goal_pose(self, moved_frame: MovedFrame) -> SE3:
        """Compute the pose T_world_tip to which a Pilz motion command moves its frame."""
        wanted = self.request.goals[0]
        return wanted.T_world_link if isinstance(wanted, PoseGoal) else moved_frame.pose(self.goal)

    @property
    def goal_joints(self) -> F64 | None:
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
        """Choose the velocity profile for generating a LIN or CIRC motion, from the command's scaling factors
        and the length [m] and rotation angle [rad] of the tip path. The profile runs over the path parameter
        s (0 to 1).

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
    """Generate the trajectory of a Pilz motion command from its joint curve, with the timing that a velocity
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


def synchronized_profile(step: F64, velocity: F64, acceleration: F64, deceleration: F64) -> Trapezoid:
    """Choose the velocity profile for generating a PTP motion with joint steps (n,): the fastest trapezoid
    that all joints can share.

    MoveIt applies the group's strictest limits to every joint. Here each joint has its own limits: if all
    limits are equal, the motion equals MoveIt's; otherwise it is at least as fast.

    Args:
        velocity, acceleration, deceleration: limits (n,) [rad/s, rad/s² or m/s, m/s²].
    Raises:
        InputError: wrong shapes, values that are not finite, or no joint moves.
    """
    steps = np.abs(float_array(step, (None,), "step"))
    moving = steps > 0.0
    require(bool(moving.any()), "no joint moves")
    named = {"velocity": velocity, "acceleration": acceleration, "deceleration": deceleration}
    limits = (float_array(limit, steps.shape, name) for name, limit in named.items())
    return Trapezoid.fastest(1.0, *(float(np.min(limit[moving] / steps[moving])) for limit in limits))


@pipelines[PILZ].register("PTP")
def ptp(command: MotionCommand) -> GeneratedMotion | Outcome:
    """Generate a PTP motion, in which all joints accelerate, cruise and brake at the same times."""
    if np.max(np.abs(command.goal - command.start)) <= AT_GOAL:
        return command.stationary_motion()
    names, request = command.validated.joint_names, command.request
    model = command.validated.scene.model
    curve = JointLine(command.start, command.goal)
    velocity = model.limits(names, "velocity") * request.velocity_scaling
    acceleration = model.limits(names, "acceleration") * request.acceleration_scaling
    profile = Profile(
        synchronized_profile(curve.step, velocity, acceleration, acceleration), command.settings.smoothing
    )
    tip = model.group(request.group).tip_link
    return GeneratedMotion(
        curve, time_curve(curve, profile, names), None if tip is None else command.moved_frame()
    )


@pipelines[PILZ].register("LIN")
def lin(command: MotionCommand) -> GeneratedMotion | Outcome:
    """Generate a LIN motion, in which the tip moves on a straight line and rotates evenly."""
    moved_frame = command.moved_frame()
    line = Line(moved_frame.pose(command.start), command.goal_pose(moved_frame))
    if max(line.length, line.angle) > AT_GOAL:
        return generate_along_path(command, line, moved_frame)
    joints = command.goal_joints
    if joints is None or np.max(np.abs(joints - command.start)) <= AT_GOAL:
        return command.stationary_motion()
    text = (
        f"has nowhere to go: the goal has {moved_frame.name} where it is, "
        "with other joint positions (use PTP)"
    )
    return Outcome(ErrorCode.PLANNING_FAILED, text, {"fraction": 0.0})


def generate_along_path(
    command: MotionCommand, path: TipPath, moved_frame: MovedFrame
) -> GeneratedMotion | Outcome:
    """Generate a LIN or CIRC motion in which the tip follows its path within the joint limits."""
    ik = solver_for(moved_frame, command.request.group)
    curve = follow_path(path, moved_frame, ik, command.start, command.goal_joints, command.stopped)
    if isinstance(curve, Outcome):
        return curve
    names = command.validated.joint_names
    trajectory = time_curve(curve, command.tip_profile(path.length, path.angle), names)
    beyond = check_joint_limits(command.validated.scene.model, trajectory, command.request)
    return GeneratedMotion(curve, trajectory, moved_frame) if beyond is None else beyond


@pipelines[PILZ].register("CIRC")
def circ(command: MotionCommand) -> GeneratedMotion | Outcome:
    """Generate a CIRC motion, in which the tip moves on an arc through an interim point or around a
    center.
    """
    kind, point, link = auxiliary_point(command.validated)
    moved_frame = command.moved_frame(link)
    start, goal = moved_frame.pose(command.start), command.goal_pose(moved_frame)
    arc = arc_through(start, goal, point) if kind == "interim" else arc_around(start, goal, point)
    if isinstance(arc, Outcome):
        return arc
    return generate_along_path(command, arc, moved_frame)


def auxiliary_point(validated: ValidatedRequest) -> tuple[str, F64, str | None]:
    """Return the auxiliary point that defines the arc of a CIRC motion: its kind, its world position (3,) [m]
    and its link.

    The link is None if the request does not specify it. The point is a parameter, or, as in MoveIt, the
    position of the first shape of the single position constraint in path constraints named after the kind of
    point.

    Raises:
        InputError: none or two points, or constraints of another form.
    """
    constraints, given = validated.request.path_constraints, validated.choice.settings.auxiliary
    if not constraints:
        if given is None:
            raise InputError("CIRC has no auxiliary point", hint=_CURE)
        return given[0], np.array(given[1]), None
    if given is not None:
        raise InputError(f"CIRC is given {given[0]} as a parameter and path constraints", hint=_CURE)
    if constraints.name not in AUXILIARY:
        raise InputError(
            f"the path constraints of CIRC are named {constraints.name!r}, not 'interim' or 'center'",
            hint=_CURE,
        )
    if len(constraints.positions) != 1 or constraints.orientations or constraints.joints:
        raise InputError(f"the {constraints.name} point of CIRC is not one position constraint", hint=_CURE)
    return constraints.name, *_place(validated, constraints.positions[0])


def _place(validated: ValidatedRequest, constraint: Any) -> tuple[F64, str | None]:
    if len(constraint.region) != 1:
        raise InputError("the region of CIRC's auxiliary point is not one shape", hint=_CURE)
    if constraint.link is not None:
        MovedFrame(validated.scene, validated.request.group, constraint.link)  # an unknown link raises
    pose = validated.scene.transform(WORLD, constraint.frame) @ constraint.region[0][1]
    return pose.translation, constraint.link


def validate_pilz_request(validated: ValidatedRequest) -> None:
    """Check a request before its PTP, LIN or CIRC motion is generated, and raise an InputError for options
    that are not supported.
    """
    request = validated.request
    if request.torque_limits or request.jerk_limits:
        asked = "torque_limits" if request.torque_limits else "jerk_limits"
        raise InputError(f"pipeline 'pilz' does not keep {asked}", hint="pipeline_id='native' does")
    if validated.planner_id == "CIRC":
        auxiliary_point(validated)
    elif request.path_constraints:
        raise InputError(
            f"{validated.planner_id} takes no path constraints",
            hint="pipeline_id='native' with planner_id='RRTConnect' keeps them",
        )


def plan_pilz(
    validated: ValidatedRequest, checker: KernelChecker, start: F64, goals: tuple[F64, ...]
) -> PlanResult:
    """Plan one PTP, LIN or CIRC motion: generate and certify it, or report the failure.

    Args:
        start: (n,), free of contact. goals: (n,) free positions of the goal, nearest first.
    """
    if (refusal := _refused(validated)) is not None:
        return validated.failed(refusal)
    command = MotionCommand(validated, checker, start, goals[0])
    generator: Generator = pipelines[PILZ][validated.planner_id]
    made = generator(command)
    if isinstance(made, Outcome):
        return validated.failed(replace(made, message=_named(validated.planner_id, made.message)))
    points = prove_motion_free(checker, made.curve, made.moved_frame, f"{validated.planner_id} touches")
    if isinstance(points, Outcome):
        return validated.failed(points)
    if validated.workspace is not None and (q := validated.workspace.first_outside(points)) is not None:
        text = f"{validated.planner_id} leaves the workspace: {validated.workspace.describe(q)}"
        return validated.failed(Outcome(ErrorCode.INVALID_MOTION_PLAN, text, {"positions": q}))
    motion = complete_motion(validated, checker, points, made.trajectory)
    ignored = validated.choice.without_effect
    return PlanResult(
        ErrorCode.SUCCESS,
        motion.note,
        {**validated.evidence, **({"settings_without_effect": ignored} if ignored else {})},
        path=JointPath(validated.joint_names, motion.waypoints),
        trajectory=motion.trajectory,
        planner_id=validated.planner_id,
        planning_time=time.monotonic() - validated.began,
        clearance=None if motion.trajectory is None else partial(clearance_along, checker, motion.trajectory),
    )


def _refused(validated: ValidatedRequest) -> Outcome | None:
    request = validated.request
    if len(request.goals) != 1:
        text = f"{len(request.goals)} goals are given, {validated.planner_id} takes exactly one"
        return Outcome(ErrorCode.INVALID_GOAL_CONSTRAINTS, text)
    if request.start is not None and request.start.velocities is not None:
        for name, speed in zip(request.start.joint_names, request.start.velocities, strict=True):
            if name in validated.joint_names and abs(speed) > STANDING:
                text = f"{validated.planner_id} begins at rest, but {name} starts with {speed:.3g}"
                return Outcome(ErrorCode.INVALID_ROBOT_STATE, text, {"joint": name})
    return None


def _named(planner_id: str, message: str) -> str:
    return message if message.startswith(planner_id) else f"{planner_id} {message}"
