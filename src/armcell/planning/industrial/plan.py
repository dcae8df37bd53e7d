"""One industrial motion: checked, made, proven. Nothing is searched: it is free, or fails and says where."""

from __future__ import annotations

import time
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from armcell.collision.kernel.checker import KernelChecker
from armcell.core import ErrorCode, InputError, JointPath, Outcome, PlanResult
from armcell.planning.finish import clearance_along
from armcell.planning.industrial import lin, ptp  # noqa: F401  (they register themselves)
from armcell.planning.industrial.circ import auxiliary_point
from armcell.planning.industrial.command import Command, Generator
from armcell.planning.industrial.proof import proven
from armcell.planning.motion import completed
from armcell.planning.problem import INDUSTRIAL, pipelines
from armcell.planning.question import Question

Array = NDArray[np.float64]

STANDING = 1e-8  # [rad/s or m/s] start velocity that counts as none (MoveIt's VELOCITY_TOLERANCE)


def check_command(question: Question) -> None:
    """Raises InputError where a request asks what these motions cannot do."""
    request = question.request
    if request.torque_limits or request.jerk_limits:
        asked = "torque_limits" if request.torque_limits else "jerk_limits"
        raise InputError(f"pipeline 'pilz' does not keep {asked}", cure="pipeline_id='native' does")
    if question.planner_id == "CIRC":
        auxiliary_point(question)
    elif request.path_constraints:
        raise InputError(
            f"{question.planner_id} takes no path constraints",
            cure="pipeline_id='native' with planner_id='RRTConnect' keeps them",
        )


def plan_industrial(
    question: Question, checker: KernelChecker, start: Array, goals: tuple[Array, ...]
) -> PlanResult:
    """The motion that is asked for, certified; or the code, message and evidence of why it cannot be.

    Args:
        start: (n,), free of contact. goals: (n,) free ones that were found for the goal, the nearest first.
    """
    if (refusal := _refused(question)) is not None:
        return question.failed(refusal)
    command = Command(question, checker, start, goals[0])
    generator: Generator = pipelines[INDUSTRIAL][question.planner_id]
    made = generator(command)
    if isinstance(made, Outcome):
        return question.failed(replace(made, message=_named(question.planner_id, made.message)))
    points = proven(checker, made.curve, made.placed, f"{question.planner_id} touches")
    if isinstance(points, Outcome):
        return question.failed(points)
    if question.workspace is not None and (q := question.workspace.left_at(points)) is not None:
        text = f"{question.planner_id} leaves the workspace: {question.workspace.describe(q)}"
        return question.failed(Outcome(ErrorCode.INVALID_MOTION_PLAN, text, {"positions": q}))
    motion = completed(question, checker, points, made.trajectory)
    ignored = question.choice.without_effect
    return PlanResult(
        ErrorCode.SUCCESS,
        motion.words,
        {**question.evidence, **({"settings_without_effect": ignored} if ignored else {})},
        path=JointPath(question.joint_names, motion.waypoints),
        trajectory=motion.trajectory,
        planner_id=question.planner_id,
        planning_time=time.monotonic() - question.began,
        clearance=None if motion.trajectory is None else partial(clearance_along, checker, motion.trajectory),
    )


def _refused(question: Question) -> Outcome | None:
    request = question.request
    if len(request.goals) != 1:
        text = f"{len(request.goals)} goals are given, {question.planner_id} takes exactly one"
        return Outcome(ErrorCode.INVALID_GOAL_CONSTRAINTS, text)
    if request.start is not None and request.start.velocities is not None:
        for name, speed in zip(request.start.joint_names, request.start.velocities, strict=True):
            if name in question.joint_names and abs(speed) > STANDING:
                text = f"{question.planner_id} begins at rest, but {name} starts with {speed:.3g}"
                return Outcome(ErrorCode.INVALID_ROBOT_STATE, text, {"joint": name})
    return None


def _named(planner_id: str, message: str) -> str:
    return message if message.startswith(planner_id) else f"{planner_id} {message}"
