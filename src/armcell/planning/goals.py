"""Goals of a request as joint positions, or the reason why there are none."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from armcell.collision.kernel.checker import KernelChecker
from armcell.core import (
    ConstraintGoal,
    Contact,
    ErrorCode,
    InputError,
    JointGoal,
    NamedGoal,
    Outcome,
    PoseGoal,
)
from armcell.kinematics import ik_solver
from armcell.planning.constraint_check import violations
from armcell.planning.constraint_sense import contradiction
from armcell.planning.goal_regions import candidates, is_region, is_wide, whole_turns
from armcell.planning.placed import Placed
from armcell.planning.question import Question

Array = NDArray[np.float64]
Found = tuple[Outcome, list[Array]]

MORE = 100  # solutions that are looked at where none of the first is free
ENOUGH = 4  # free positions of a goal to begin with
BLOCKED = 16  # positions in collision after which another posture is tried


def joint_goals(
    question: Question, checker: KernelChecker, rng: np.random.Generator
) -> tuple[tuple[Array, ...], Outcome]:
    """Collision-free goal positions (n,) of the group, nearest to the start first.

    Returns:
        The goals and SUCCESS, or no goals and the code, message and evidence of the last that failed.
    """
    found: list[Array] = []
    failure = Outcome(ErrorCode.INVALID_GOAL_CONSTRAINTS, "the request has no goal")
    for goal in question.request.goals:
        if isinstance(goal, PoseGoal):
            result, positions = _from_pose(question, goal, checker, rng)
        elif isinstance(goal, ConstraintGoal):
            result, positions = _from_constraints(question, goal, checker, rng)
        else:
            if isinstance(goal, NamedGoal):
                goal = JointGoal(question.scene.model.named_state(question.request.group, goal.name))
            result, positions = _from_joints(question, goal, checker, rng)
        if result.ok:
            found += positions
        else:
            failure = result
    if not found:
        return (), failure
    start = question.scene.positions[checker.columns]
    found.sort(key=lambda q: float(np.linalg.norm(q - start)))
    return tuple(found), Outcome(ErrorCode.SUCCESS)


class _Sieve:
    """Sorts positions into usable and not, and remembers why not."""

    def __init__(self, question: Question, checker: KernelChecker):
        self.question, self.checker = question, checker
        self.blocked: list[Array] = []
        self.forbidden = ""

    def usable(self, q: Array) -> bool:
        if not self.checker.is_free(q):
            self.blocked.append(q)
            return False
        why = self.question.forbids(q)
        self.forbidden = self.forbidden or why
        return not why

    def first(self, positions: Iterable[Array], count: int) -> list[Array]:
        return list(islice((q for q in positions if self.usable(q)), count))

    def refusal(self) -> Outcome | None:
        """What is wrong with what was looked at, or None if nothing was."""
        if self.forbidden:
            return Outcome(ErrorCode.INVALID_GOAL_CONSTRAINTS, f"goal: {self.forbidden}")
        contacts = [c for c in map(self.checker.exact.contacts, self.blocked[:BLOCKED]) if c]
        if not contacts:
            return None
        shallowest = min(contacts, key=lambda c: -min(x.distance for x in c))
        outcome = _in_collision(shallowest)
        if len(contacts) == 1:
            return outcome
        text = f"each of {len(contacts)} joint solutions is in collision; the best: {outcome.message}"
        return Outcome(ErrorCode.GOAL_IN_COLLISION, text, outcome.evidence)


def _from_joints(
    question: Question, goal: JointGoal, checker: KernelChecker, rng: np.random.Generator
) -> Found:
    scene, names, state = question.scene, question.joint_names, goal.state
    for name in state.joint_names:  # misuse, not a failure of planning
        if name not in names:
            scene.model.joint(name)
            raise InputError(f"goal names joint {name!r}, which the group does not move")
    q = scene.state.updated(state).reindexed(names).positions
    try:
        scene.model.check_positions(q, names, margin=max(goal.tolerance, 1e-9))
    except InputError as error:
        return Outcome(ErrorCode.GOAL_STATE_INVALID, f"goal: {error}"), []
    low, high = scene.model.lower[checker.columns], scene.model.upper[checker.columns]
    q = np.clip(q, low, high)
    start = scene.positions[checker.columns]
    sieve = _Sieve(question, checker)
    centres = whole_turns(scene.model, names, q, start) if goal.turns else [q]
    found = sieve.first(centres, len(centres))
    if not found and is_region(goal):
        found = sieve.first(candidates(scene, question.request.group, goal, rng), 1)
    if found:
        return Outcome(ErrorCode.SUCCESS), found
    refusal = sieve.refusal()
    return _in_collision(checker.exact.contacts(q)) if refusal is None else refusal, []


def _from_pose(question: Question, goal: PoseGoal, checker: KernelChecker, rng: np.random.Generator) -> Found:
    scene, group = question.scene, question.request.group
    placed = Placed(scene, group, goal.link)
    ik = ik_solver(scene.model, group, placed.link)
    target = placed.link_target(goal.T_world_link)
    valid: list[Array] = []
    sieve = _Sieve(question, checker)
    for among in (8, 24):  # mostly the first few solutions are good enough
        valid, sieve = [], _Sieve(question, checker)
        for q in ik.nearest(target, scene.positions, rng, among):
            if sieve.usable(q):
                valid.append(q)
            if len(valid) >= ENOUGH or len(sieve.blocked) >= BLOCKED:
                break
        if valid:
            return Outcome(ErrorCode.SUCCESS), valid
    if sieve.blocked or sieve.forbidden or is_wide(goal):  # another posture, or elsewhere in the tolerances
        some = islice(candidates(scene, group, goal, rng, question.deadline), MORE)
        first = len(sieve.blocked)
        if valid := sieve.first(some, 1):
            return Outcome(ErrorCode.SUCCESS), valid
        del sieve.blocked[max(first, BLOCKED) :]
    if (refusal := sieve.refusal()) is not None:
        return refusal, []
    result = ik.solve(target, scene.positions, rng=rng)
    evidence = {**result.evidence, "target": goal.T_world_link}
    return Outcome(ErrorCode.NO_IK_SOLUTION, result.message, evidence), []


def _from_constraints(
    question: Question, goal: ConstraintGoal, checker: KernelChecker, rng: np.random.Generator
) -> Found:
    scene, group = question.scene, question.request.group
    if why := contradiction(scene, group, goal.constraints):
        return Outcome(ErrorCode.INVALID_GOAL_CONSTRAINTS, f"goal: {why}"), []
    sieve = _Sieve(question, checker)
    some = islice(candidates(scene, group, goal, rng, question.deadline), MORE)
    if found := sieve.first(some, ENOUGH):
        return Outcome(ErrorCode.SUCCESS), found
    if (refusal := sieve.refusal()) is not None:
        return refusal, []
    here = violations(scene, group, goal.constraints, scene.positions[checker.columns])
    text = f"goal: no state that keeps to all constraints was found; at the start {here}"
    return Outcome(ErrorCode.NO_IK_SOLUTION, text), []


def _in_collision(contacts: list[Contact]) -> Outcome:
    text = "goal in collision: " + "; ".join(c.describe() for c in contacts[:3])
    return Outcome(ErrorCode.GOAL_IN_COLLISION, text, {"contacts": contacts})
