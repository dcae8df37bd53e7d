"""Goals of a request as joint positions, or the reason why there are none."""

from __future__ import annotations

from itertools import islice

import numpy as np
from numpy.typing import NDArray

from armcell.collision.kernel.checker import KernelChecker
from armcell.core import (
    Contact,
    ErrorCode,
    InputError,
    JointGoal,
    NamedGoal,
    Outcome,
    PlanRequest,
    PoseGoal,
)
from armcell.kinematics import ik_solver
from armcell.planning.goal_stream import candidates
from armcell.scene import PlanningScene

Array = NDArray[np.float64]

WIDE = (1e-3, 1e-2)  # [m], [rad] a pose goal with larger tolerances is a region to be sampled
MORE = 100  # solutions that are looked at where none of the first is free


def joint_goals(scene: PlanningScene, request: PlanRequest, checker: KernelChecker,
                rng: np.random.Generator) -> tuple[tuple[Array, ...], Outcome]:  # fmt: skip
    """Collision-free goal positions (n,) of the group, nearest to the start first.

    Returns:
        The goals and SUCCESS, or no goals and the code, message and evidence of the last that failed.
    """
    model = scene.model
    group = model.group(request.group)
    found: list[Array] = []
    failure = Outcome(ErrorCode.INVALID_GOAL_CONSTRAINTS, "the request has no goal")
    for goal in request.goals:
        if isinstance(goal, PoseGoal):
            result, positions = _from_pose(scene, request.group, goal, checker, rng)
        else:
            state = model.named_state(request.group, goal.name) if isinstance(goal, NamedGoal) else goal.state
            result, positions = _from_joints(scene, group.joint_names, state, checker)
        if result.ok:
            found += positions
        else:
            failure = result
    if not found:
        return (), failure
    start = scene.positions[checker.columns]
    found.sort(key=lambda q: float(np.linalg.norm(q - start)))
    return tuple(found), Outcome(ErrorCode.SUCCESS)


def _from_joints(scene, joint_names, state, checker) -> tuple[Outcome, list[Array]]:
    for name in state.joint_names:  # misuse, not a failure of planning
        if name not in joint_names:
            scene.model.joint(name)
            raise InputError(f"goal names joint {name!r}, which the group does not move")
    try:
        q = scene.state.updated(state).reindexed(joint_names).positions
        scene.model.check_positions(q, joint_names)
    except InputError as error:
        return Outcome(ErrorCode.GOAL_STATE_INVALID, f"goal: {error}"), []
    if not checker.is_free(q):
        return _in_collision(checker.exact.contacts(q)), []
    return Outcome(ErrorCode.SUCCESS), [q]


def _from_pose(scene, group, goal: PoseGoal, checker, rng) -> tuple[Outcome, list[Array]]:
    ik = ik_solver(scene.model, group, goal.link)
    for among in (8, 24):  # mostly the first few solutions are good enough
        valid, blocked = [], []
        for q in ik.nearest(goal.T_world_link, scene.positions, rng, among):
            (valid if checker.is_free(q) else blocked).append(q)
            if len(valid) >= 4 or len(blocked) >= 16:
                break
        if valid:
            break
    if not valid:  # another posture, or elsewhere within the tolerances
        wide = goal.position_tolerance > WIDE[0] or goal.orientation_tolerance > WIDE[1]
        some = islice(candidates(scene, group, goal, rng), MORE) if blocked or wide else ()
        valid = list(islice((q for q in some if checker.is_free(q)), 1))
    if valid:
        return Outcome(ErrorCode.SUCCESS), valid
    contacts = [c for c in map(checker.exact.contacts, blocked) if c] if blocked else []
    if contacts:
        shallowest = min(contacts, key=lambda c: -min(x.distance for x in c))
        outcome = _in_collision(shallowest)
        text = f"each of {len(contacts)} joint solutions is in collision; the best: {outcome.message}"
        return Outcome(ErrorCode.GOAL_IN_COLLISION, text, outcome.evidence), []
    result = ik.solve(goal.T_world_link, scene.positions, rng=rng)
    evidence = {**result.evidence, "target": goal.T_world_link}
    return Outcome(ErrorCode.NO_IK_SOLUTION, result.message, evidence), []


def _in_collision(contacts: list[Contact]) -> Outcome:
    text = "goal in collision: " + "; ".join(c.describe() for c in contacts[:3])
    return Outcome(ErrorCode.GOAL_IN_COLLISION, text, {"contacts": contacts})


__all__ = ["JointGoal", "NamedGoal", "PoseGoal", "joint_goals"]
