"""The planning pipeline: check the request, find a path, shorten, prove and time it."""

from __future__ import annotations

import threading
import time
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from armcell.collision.kernel.checker import KernelChecker
from armcell.core import (
    ConstraintGoal,
    ErrorCode,
    InputError,
    JointPath,
    Outcome,
    PlanRequest,
    PlanResult,
    PoseGoal,
)
from armcell.planning import planners as _registered  # noqa: F401  (fills the registry)
from armcell.planning.explanation import explained
from armcell.planning.finish import clearance_along, finish, torque_model
from armcell.planning.goal_stream import stream
from armcell.planning.goals import joint_goals
from armcell.planning.native.warm_up import warm_up, warm_up_ik
from armcell.planning.problem import Problem, find_planner, normalized_planner_id, sampling_bounds
from armcell.planning.simplify import simplify
from armcell.scene import PlanningScene
from armcell.timing import TorqueLimitError, check_scaling

Array = NDArray[np.float64]

MAX_ROUNDS = 5
"""How often a path that fails certification is planned anew with another seed."""


@explained(PlanRequest)
def plan(scene: PlanningScene, request: PlanRequest, cancel: threading.Event | None = None) -> PlanResult:
    """A certified, timed motion of one group.

    Args:
        scene: the world; its state is the start where the request names none.
        cancel: set it from another thread to stop.
    Returns:
        SUCCESS with path and trajectory, or the code, message and evidence (contacts, joints, distances).
    Raises:
        InputError: misuse: unknown group, planner, link or joint; scaling outside (0, 1].
    """
    warm_up()
    for goal in request.goals:
        if isinstance(goal, PoseGoal) and request.group in scene.model.groups:
            warm_up_ik(scene.model, request.group, goal.link)
    began = time.monotonic()
    check_scaling(request.velocity_scaling, "velocity scaling")
    check_scaling(request.acceleration_scaling, "acceleration scaling")
    if not (np.isfinite(request.planning_time) and request.planning_time > 0):
        raise InputError(f"planning_time is {request.planning_time:g} s, it must be positive")
    if request.path_constraints or any(isinstance(goal, ConstraintGoal) for goal in request.goals):
        raise InputError("constraints are not planned with yet")
    planner_id = normalized_planner_id(request.planner_id)
    planner = find_planner(request.pipeline_id, planner_id)
    group = scene.model.group(request.group)
    if not group.joint_names:
        raise InputError(f"group {request.group!r} has no joints")

    def failed(outcome: Outcome) -> PlanResult:
        spent = time.monotonic() - began
        return PlanResult(
            outcome.code, outcome.message, outcome.evidence, planner_id=planner_id, planning_time=spent
        )

    scene, problem_with_start = _started(scene, request)
    if problem_with_start is not None:
        return failed(problem_with_start)
    checker = KernelChecker(scene, group.joint_names)
    start = scene.positions[checker.columns]
    if checker.touches(start):
        contacts = checker.exact.contacts(start, padded=False)
        text = "start in collision: " + "; ".join(c.describe() for c in contacts[:3])
        return failed(Outcome(ErrorCode.START_STATE_IN_COLLISION, text, {"contacts": contacts}))
    checker.relax_margins(start)
    rng = np.random.default_rng(request.seed)
    goals, outcome = joint_goals(scene, request, checker, rng)
    if not outcome.ok:
        return failed(outcome)
    lower, upper = sampling_bounds(scene.model, group.joint_names, start, goals)
    torque = torque_model(scene, group.joint_names) if request.torque_limits else None
    answer = None
    for round_ in range(MAX_ROUNDS):
        seed = request.seed + 7919 * round_
        problem = Problem(
            checker,
            start,
            goals,
            lower,
            upper,
            seed,
            began + request.planning_time,
            cancel or threading.Event(),
            stream(scene, request, checker, goals),
        )
        waypoints = _direct(problem) if round_ == 0 else None
        used = "straight line" if waypoints is not None else planner_id
        if waypoints is None:
            answer = planner(problem)
            if answer.waypoints is None:
                break
            waypoints = answer.waypoints if answer.simplified else simplify(problem, answer.waypoints)
            if waypoints is None:
                continue
        if cancel is not None and cancel.is_set():
            break
        try:
            finished = finish(
                checker, waypoints, request.velocity_scaling, request.acceleration_scaling,
                torque=torque, jerk_limits=request.jerk_limits,
            )  # fmt: skip
        except TorqueLimitError as error:
            evidence = {"joint": error.joint, "torque": error.torque, "limit": error.limit}
            return failed(Outcome(ErrorCode.PLANNING_FAILED, str(error), evidence))
        if finished.trajectory is not None:
            return PlanResult(
                ErrorCode.SUCCESS,
                path=JointPath(group.joint_names, waypoints),
                trajectory=finished.trajectory,
                planner_id=used,
                planning_time=time.monotonic() - began,
                clearance=partial(clearance_along, checker, finished.trajectory),
                evidence=answer.statistics if answer else {},
            )
    cancelled = cancel is not None and cancel.is_set()
    timed_out = time.monotonic() - began >= request.planning_time
    code = (
        ErrorCode.PREEMPTED if cancelled else ErrorCode.TIMED_OUT if timed_out else ErrorCode.PLANNING_FAILED
    )
    message = (answer.message if answer else "") or (
        f"{planner_id}: cancelled"
        if cancelled
        else "found paths, but none could be proven free between its samples"
    )
    return failed(Outcome(code, message, {"goals": len(goals), **(answer.statistics if answer else {})}))


def _started(scene: PlanningScene, request: PlanRequest) -> tuple[PlanningScene, Outcome | None]:
    """The scene at the request's start state, or what is wrong with that."""
    if request.start is not None:  # an unknown joint in it is misuse and raises
        scene = replace(scene, positions=scene.state.updated(request.start).positions)
    try:
        scene.model.check_positions(scene.positions, margin=1e-3)
    except InputError as error:
        return scene, Outcome(ErrorCode.START_STATE_INVALID, f"start: {error}")
    return scene, None


def _direct(problem: Problem) -> Array | None:
    """The straight line to a goal, where it is free with padding: the shortest path there is."""
    for goal in problem.goals:
        if np.max(np.abs(goal - problem.start)) < 1e-9:
            return np.vstack([problem.start])
        if problem.checker.edge_is_free(problem.start, goal):
            edge = np.vstack([problem.start, goal])
            if problem.checker.certify(edge, evidence=False).free:
                return edge
    return None
