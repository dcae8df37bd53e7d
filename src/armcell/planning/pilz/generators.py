"""Motion generators: PTP (synchronous joints), LIN (tip on a line) and CIRC (tip on an arc)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from armcell.core import WORLD, ErrorCode, InputError, Outcome
from armcell.core.checks import float_array, require
from armcell.planning.moved_frame import MovedFrame
from armcell.planning.pilz.command import AT_GOAL, GeneratedMotion, MotionCommand, time_curve
from armcell.planning.pilz.motion_checks import check_joint_limits
from armcell.planning.pilz.paths import (
    JointLine,
    Line,
    TipPath,
    arc_around,
    arc_through,
    follow_path,
    solver_for,
)
from armcell.planning.pilz.settings import AUXILIARY
from armcell.planning.pilz.velocity_profile import Profile, Trapezoid
from armcell.planning.planners.registry import PILZ, pipelines
from armcell.planning.request import ValidatedRequest

Array = NDArray[np.float64]


def synchronized_profile(step: Array, velocity: Array, acceleration: Array, deceleration: Array) -> Trapezoid:
    """Compute the fastest trapezoidal velocity profile that all joints of a PTP motion can share, for joint
    steps (n,).

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


def auxiliary_point(validated: ValidatedRequest) -> tuple[str, Array, str | None]:
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


def _place(validated: ValidatedRequest, constraint: Any) -> tuple[Array, str | None]:
    if len(constraint.region) != 1:
        raise InputError("the region of CIRC's auxiliary point is not one shape", hint=_CURE)
    if constraint.link is not None:
        MovedFrame(validated.scene, validated.request.group, constraint.link)  # an unknown link raises
    pose = validated.scene.transform(WORLD, constraint.frame) @ constraint.region[0][1]
    return pose.translation, constraint.link


_CURE = (
    "give parameters={'interim': (x, y, z)} or {'center': (x, y, z)}, "
    "or path constraints of one of these names with one position constraint"
)
