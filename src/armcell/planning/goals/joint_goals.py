"""Conversion of user targets to goals, and of a request's goals to collision-free joint positions.

A user target is a named state, a pose, or joint values in any form.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from armcell.collision.kernel.checker import KernelChecker
from armcell.core import (
    SE3,
    ConstraintGoal,
    Contact,
    ErrorCode,
    Goal,
    InputError,
    JointGoal,
    JointState,
    NamedGoal,
    Outcome,
    PoseGoal,
)
from armcell.kinematics import ik_solver
from armcell.model import RobotModel
from armcell.planning.constraints.constraint_validation import contradiction
from armcell.planning.constraints.evaluation import describe_violations
from armcell.planning.goals.sampling import full_turn_equivalents, is_region, is_wide, sample_goal_positions
from armcell.planning.moved_frame import MovedFrame
from armcell.planning.request import ValidatedRequest

Target = str | SE3 | JointState | Mapping[str, float] | Sequence[float] | NDArray[np.float64] | Goal
Array = NDArray[np.float64]
Found = tuple[Outcome, list[Array]]
MORE = 100  # further solutions to test if none of the first solutions is free
ENOUGH = 4  # free positions of a goal to begin with
BLOCKED = 16  # positions in collision after which another posture is tried
DISTINCT = 1e-2  # [rad or m] goals with a smaller difference in every joint count as one goal


def goal_of(model: RobotModel, group: str, target: Target) -> Goal:
    """Convert joint values, a named state or a pose, as a user specifies them, to the goal of a planning
    group.

    Args:
        target: a named state; a pose of the group's tip in the world; joint values, all of the group's in
            its order (list, tuple, array) or some by name (mapping, JointState); or a goal, which is
            returned unchanged.
    Raises:
        InputError: the number of values differs from the group's number of joints, a value is not a number,
            or the target has an unsupported type.
        UnknownNameError: the named state or joint does not exist.
    """
    names = model.group(group).joint_names
    if isinstance(target, JointGoal | PoseGoal | NamedGoal | ConstraintGoal):
        return target
    if isinstance(target, SE3):
        return PoseGoal(target)
    if isinstance(target, str):
        model.named_state(group, target)
        return NamedGoal(target)
    if isinstance(target, JointState):
        return JointGoal(target)
    if isinstance(target, Mapping):
        for name in target:
            model.joint(name)
        return JointGoal(JointState.from_mapping(target))
    try:
        values = np.asarray(target, dtype=float)
    except (TypeError, ValueError):
        raise InputError(
            f"a {type(target).__name__} is not a valid target",
            hint="give a named state, a pose (SE3), joint values or a goal",
        ) from None
    if values.shape != (len(names),):
        raise InputError(
            f"{values.shape} joint values given, group {group!r} has {len(names)} joints",
            hint=f"its order is {', '.join(names)}; to give some of them, give them by name",
        )
    return JointGoal(JointState(names, values))


def find_joint_goals(
    validated: ValidatedRequest, checker: KernelChecker, rng: np.random.Generator
) -> tuple[tuple[Array, ...], Outcome]:
    """Convert the goals of a request to collision-free joint positions (n,); those nearest to the start come
    first.

    Returns:
        The goals and SUCCESS; or no goals and the code, message and evidence of the last failed goal.
    """
    found: list[Array] = []
    failure = Outcome(ErrorCode.INVALID_GOAL_CONSTRAINTS, "the request has no goal")
    for goal in validated.request.goals:
        if isinstance(goal, PoseGoal):
            result, positions = _from_pose(validated, goal, checker, rng)
        elif isinstance(goal, ConstraintGoal):
            result, positions = _from_constraints(validated, goal, checker, rng)
        else:
            if isinstance(goal, NamedGoal):
                goal = JointGoal(validated.scene.model.named_state(validated.request.group, goal.name))
            result, positions = _from_joints(validated, goal, checker, rng)
        if result.ok:
            found += positions
        else:
            failure = result
    if not found:
        return (), failure
    start = validated.scene.positions[checker.columns]
    found.sort(key=lambda q: float(np.linalg.norm(q - start)))
    return tuple(found), Outcome(ErrorCode.SUCCESS)


class _GoalFilter:
    """Filter for joint goals, which rejects positions in collision or outside the workspace and records the
    reason.
    """

    def __init__(self, validated: ValidatedRequest, checker: KernelChecker):
        self.validated, self.checker = validated, checker
        self.blocked: list[Array] = []
        self.forbidden = ""

    def usable(self, q: Array) -> bool:
        """Return whether joint positions q (n,) of a goal are collision-free and allowed; record the reason
        if they are not.
        """
        if not self.checker.is_free(q):
            self.blocked.append(q)
            return False
        why = self.validated.forbids(q)
        self.forbidden = self.forbidden or why
        return not why

    def first(self, positions: Iterable[Array], count: int) -> list[Array]:
        """Return the first `count` candidate joint positions of a goal that are collision-free and that the
        request allows.
        """
        return list(islice((q for q in positions if self.usable(q)), count))

    def contacts(self, q: Array) -> list[Contact]:
        """Return the contacts at goal positions q (n,) that the collision kernel rejects. If the exact meshes
        do not touch, return the nearest pair of bodies instead.
        """
        nearest = self.checker.exact.nearest
        return self.checker.exact.contacts(q) or [c for c in (nearest(q),) if c is not None]

    def refusal(self) -> Outcome | None:
        """Return the reason why every tested joint goal was rejected. Return None if no goal was tested."""
        if self.forbidden:
            return Outcome(ErrorCode.INVALID_GOAL_CONSTRAINTS, f"goal: {self.forbidden}")
        contacts = [c for c in map(self.contacts, self.blocked[:BLOCKED]) if c]
        if not contacts:
            return None
        shallowest = min(contacts, key=lambda c: -min(x.distance for x in c))
        outcome = _in_collision(shallowest)
        if len(contacts) == 1:
            return outcome
        text = f"each of {len(contacts)} joint solutions is in collision; the best: {outcome.message}"
        return Outcome(ErrorCode.GOAL_IN_COLLISION, text, outcome.evidence)


def _from_joints(
    validated: ValidatedRequest, goal: JointGoal, checker: KernelChecker, rng: np.random.Generator
) -> Found:
    scene, names, state = validated.scene, validated.joint_names, goal.state
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
    goal_filter = _GoalFilter(validated, checker)
    centers = full_turn_equivalents(scene.model, names, q, start) if goal.turns else [q]
    found = goal_filter.first(centers, len(centers))
    if not found and is_region(goal):
        found = goal_filter.first(sample_goal_positions(scene, validated.request.group, goal, rng), 1)
    if found:
        return Outcome(ErrorCode.SUCCESS), found
    refusal = goal_filter.refusal()
    return _in_collision(goal_filter.contacts(q)) if refusal is None else refusal, []


def _from_pose(
    validated: ValidatedRequest, goal: PoseGoal, checker: KernelChecker, rng: np.random.Generator
) -> Found:
    scene, group = validated.scene, validated.request.group
    moved_frame = MovedFrame(scene, group, goal.link)
    ik = ik_solver(scene.model, group, moved_frame.link)
    target = moved_frame.link_target(goal.T_world_link)
    valid: list[Array] = []
    goal_filter = _GoalFilter(validated, checker)
    for among in (8, 24):  # mostly the first few solutions are good enough
        valid, goal_filter = [], _GoalFilter(validated, checker)
        for q in ik.nearest(target, scene.positions, rng, among):
            if goal_filter.usable(q):
                valid.append(q)
            if len(valid) >= ENOUGH or len(goal_filter.blocked) >= BLOCKED:
                break
        if valid:
            return Outcome(ErrorCode.SUCCESS), valid
    if (
        goal_filter.blocked or goal_filter.forbidden or is_wide(goal)
    ):  # another posture, or elsewhere in the tolerances
        some = islice(sample_goal_positions(scene, group, goal, rng, validated.deadline), MORE)
        first = len(goal_filter.blocked)
        if valid := goal_filter.first(some, 1):
            return Outcome(ErrorCode.SUCCESS), valid
        del goal_filter.blocked[max(first, BLOCKED) :]
    if (refusal := goal_filter.refusal()) is not None:
        return refusal, []
    result = ik.solve(target, scene.positions, rng=rng)
    evidence = {**result.evidence, "target": goal.T_world_link}
    return Outcome(ErrorCode.NO_IK_SOLUTION, result.message, evidence), []


def _from_constraints(
    validated: ValidatedRequest, goal: ConstraintGoal, checker: KernelChecker, rng: np.random.Generator
) -> Found:
    scene, group = validated.scene, validated.request.group
    if why := contradiction(scene, group, goal.constraints):
        return Outcome(ErrorCode.INVALID_GOAL_CONSTRAINTS, f"goal: {why}"), []
    goal_filter = _GoalFilter(validated, checker)
    some = islice(sample_goal_positions(scene, group, goal, rng, validated.deadline), MORE)
    if found := goal_filter.first(some, ENOUGH):
        return Outcome(ErrorCode.SUCCESS), found
    if (refusal := goal_filter.refusal()) is not None:
        return refusal, []
    here = describe_violations(scene, group, goal.constraints, scene.positions[checker.columns])
    text = f"goal: no state that keeps to all constraints was found; at the start {here}"
    return Outcome(ErrorCode.NO_IK_SOLUTION, text), []


def _in_collision(contacts: list[Contact]) -> Outcome:
    text = "goal in collision: " + "; ".join(c.describe() for c in contacts[:3])
    if all(c.distance > 0 for c in contacts):
        text += ", which is nearer than the kernel's convex pieces of the meshes resolve"
    return Outcome(ErrorCode.GOAL_IN_COLLISION, text, {"contacts": contacts})


def stream_goals(
    validated: ValidatedRequest, checker: KernelChecker, known: Sequence[Array], seed: int
) -> Iterator[Array] | None:
    """Yield further joint goals while the planner is searching: collision-free joint positions (n,) that meet
    the goals of the request, computed one by one.

    The positions of the request's goals alternate. Nothing is computed before the first position is
    requested. The result is None if the goals have no further positions.
    """
    regions = [goal for goal in validated.request.goals if is_region(goal)]
    if not regions:
        return None

    def new_ones() -> Iterator[Array]:
        rng, given = np.random.default_rng([seed, 1]), list(known)
        sources = [
            sample_goal_positions(validated.scene, validated.request.group, goal, rng, validated.deadline)
            for goal in regions
        ]
        while sources:
            for source in list(sources):
                for q in source:
                    new = all(np.max(np.abs(q - k)) > DISTINCT for k in given)
                    if new and checker.is_free(q) and not validated.forbids(q):
                        given.append(q)
                        yield q
                        break
                else:
                    sources.remove(source)

    return new_ones()
