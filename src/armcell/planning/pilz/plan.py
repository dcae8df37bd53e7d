"""Planning of one PTP, LIN or CIRC motion: check, generate and certify it, without a search."""

from __future__ import annotations

import time
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from armcell.collision.kernel.checker import KernelChecker
from armcell.core import ErrorCode, InputError, JointPath, Outcome, PlanResult
from armcell.planning.certify import clearance_along, complete_motion
from armcell.planning.pilz.command import Generator, MotionCommand
from armcell.planning.pilz.generators import auxiliary_point
from armcell.planning.pilz.motion_checks import prove_motion_free
from armcell.planning.planners.registry import PILZ, pipelines
from armcell.planning.request import ValidatedRequest

Array = NDArray[np.float64]

STANDING = 1e-8  # [rad/s or m/s] largest start velocity that counts as rest (MoveIt's VELOCITY_TOLERANCE)


def validate_pilz_request(validated: ValidatedRequest) -> None:
    """Check a request for a PTP, LIN or CIRC motion, and raise an InputError for options that are not
    supported.
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
    validated: ValidatedRequest, checker: KernelChecker, start: Array, goals: tuple[Array, ...]
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
