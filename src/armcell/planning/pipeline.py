"""The planning pipeline: check the request, find a path, shorten, prove and time it."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from armcell.collision.kernel.checker import KernelChecker
from armcell.core import ErrorCode, InputError, JointPath, Outcome, PlanRequest, PlanResult, PoseGoal
from armcell.planning.finish import clearance_along, finish, torque_model
from armcell.planning.goal_stream import stream
from armcell.planning.goals import joint_goals
from armcell.planning.native.warm_up import warm_up, warm_up_ik
from armcell.planning.problem import Answer, Problem, sampling_bounds
from armcell.planning.question import Question, ask
from armcell.planning.simplify import simplify
from armcell.scene import PlanningScene
from armcell.timing import TorqueLimitError

Array = NDArray[np.float64]

MAX_ROUNDS = 5
"""How often a path that fails certification is planned anew with another seed."""


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
    question = ask(scene, request, cancel)
    ends = find_ends(question)
    if isinstance(ends, Outcome):
        return question.failed(ends)
    return search(question, ends)


@dataclass(frozen=True, eq=False)
class Ends:
    """A free start (n,) and goals (n,), bounds to sample in, and the checker they were found with."""

    checker: KernelChecker
    start: Array
    goals: tuple[Array, ...]
    lower: Array
    upper: Array


def find_ends(question: Question) -> Ends | Outcome:
    """Start and goals as joint positions, or what is wrong with them."""
    scene = question.scene
    try:
        scene.model.check_positions(scene.positions, margin=1e-3)
    except InputError as error:
        return Outcome(ErrorCode.START_STATE_INVALID, f"start: {error}")
    checker = KernelChecker(scene, question.joint_names)
    start = scene.positions[checker.columns]
    if checker.touches(start):
        contacts = checker.exact.contacts(start, padded=False)
        text = "start in collision: " + "; ".join(c.describe() for c in contacts[:3])
        return Outcome(ErrorCode.START_STATE_IN_COLLISION, text, {"contacts": contacts})
    checker.relax_margins(start)
    rng = np.random.default_rng(question.request.seed)
    goals, outcome = joint_goals(scene, question.request, checker, rng)
    if not outcome.ok:
        return outcome
    lower, upper = sampling_bounds(scene.model, question.joint_names, start, goals)
    return Ends(checker, start, goals, lower, upper)


def search(question: Question, ends: Ends) -> PlanResult:
    """Paths until one can be proven and timed."""
    scene, request, checker = question.scene, question.request, ends.checker
    torque = torque_model(scene, question.joint_names) if request.torque_limits else None
    answer = None
    for round_ in range(MAX_ROUNDS):
        problem = Problem(
            checker,
            ends.start,
            ends.goals,
            ends.lower,
            ends.upper,
            request.seed + 7919 * round_,
            question.deadline,
            question.cancel,
            stream(scene, request, checker, ends.goals),
        )
        waypoints = _direct(problem) if round_ == 0 else None
        used = "straight line" if waypoints is not None else question.planner_id
        if waypoints is None:
            answer = question.planner(problem)
            if answer.waypoints is None:
                break
            waypoints = answer.waypoints if answer.simplified else simplify(problem, answer.waypoints)
            if waypoints is None:
                continue
        if question.cancel.is_set():
            break
        try:
            finished = finish(
                checker, waypoints, request.velocity_scaling, request.acceleration_scaling,
                torque=torque, jerk_limits=request.jerk_limits,
            )  # fmt: skip
        except TorqueLimitError as error:
            evidence = {"joint": error.joint, "torque": error.torque, "limit": error.limit}
            return question.failed(Outcome(ErrorCode.PLANNING_FAILED, str(error), evidence))
        if finished.trajectory is not None:
            return PlanResult(
                ErrorCode.SUCCESS,
                path=JointPath(question.joint_names, waypoints),
                trajectory=finished.trajectory,
                planner_id=used,
                planning_time=time.monotonic() - question.began,
                clearance=partial(clearance_along, checker, finished.trajectory),
                evidence={**question.evidence, **(answer.statistics if answer else {})},
            )
    return question.failed(_unsolved(question, ends, answer))


def _unsolved(question: Question, ends: Ends, answer: Answer | None) -> Outcome:
    cancelled = question.cancel.is_set()
    timed_out = time.monotonic() >= question.deadline
    code = (
        ErrorCode.PREEMPTED if cancelled else ErrorCode.TIMED_OUT if timed_out else ErrorCode.PLANNING_FAILED
    )
    message = (answer.message if answer else "") or (
        f"{question.planner_id}: cancelled"
        if cancelled
        else "found paths, but none could be proven free between its samples"
    )
    return Outcome(code, message, {"goals": len(ends.goals), **(answer.statistics if answer else {})})


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
