"""Planning of two arm motions that start and end at the same time."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from armcell.collision.arms import CLEARANCE, Arms, without_arm
from armcell.core import (
    ErrorCode,
    Goal,
    InputError,
    JointGoal,
    JointState,
    JointTrajectory,
    Outcome,
    PlanRequest,
    PlanResult,
)
from armcell.planning.pipeline import find_start_and_goals, plan
from armcell.planning.request import validate_request
from armcell.scene import PlanningScene
from armcell.timing import merged, synchronized

Array = NDArray[np.float64]

TOUCHING = 1e-4  # [m] goals closer than this are rejected
TRIES = 3  # pairs of separate plans with different seeds before planning both arms as one group


@dataclass(frozen=True)
class SynchronizedPlan(Outcome):
    """Plan for synchronized motions of two arms that take equally long. It contains one motion per group, and
    both motions as one trajectory.

    Both are None unless planning succeeded.
    """

    trajectories: Mapping[str, JointTrajectory] | None = None
    trajectory: JointTrajectory | None = None
    how: str = ""  # "as planned", "planned again" or "as one"
    clearance: float = 0.0  # [m] proven clearance between the arms; `message` explains a smaller one
    planning_time: float = 0.0  # [s], wall clock
    recheck_time: float = 0.0  # [s] of it for the last proof of the timed pair


def plan_synchronized(
    scene: PlanningScene,
    goals: Mapping[str, Goal],
    both: str | None = None,
    clearance: float = CLEARANCE,
    template: PlanRequest | None = None,
) -> SynchronizedPlan:
    """Plan synchronized motions of two arms, which start and end at the same time and keep a clearance
    between the arms.

    Each arm is planned without the other, the shorter motion is stretched to the longer duration, and the
    timed pair is proven. If the proof fails, planning repeats with other seeds, then plans both arms as one
    group. If start or goals are closer than `clearance`, both arms are planned as one group at once; the
    result reports the clearance that is kept.

    Args:
        goals: exactly two goals, by group.
        both: group of both arms' joints; by default the group with exactly these joints.
        clearance: distance between the arms [m].
        template: speeds, planner and times of the requests; its group and goals are ignored.
    Returns:
        GOAL_IN_COLLISION with the pair of bodies if the arms cannot hold both goals without touching.
    Raises:
        InputError: not two groups, groups that share joints, no group of both; misuse as of `plan`.
    """
    began = time.monotonic()
    if len(goals) != 2:
        raise InputError(f"{len(goals)} goals given, two arms have two")
    groups = tuple(goals)
    arms = Arms(scene, (groups[0], groups[1]))
    template = template or PlanRequest(groups[0], ())
    requests = {g: replace(template, group=g, goals=(goal,)) for g, goal in goals.items()}
    scenes = {g: without_arm(scene, other) for g, other in zip(groups, groups[::-1], strict=True)}
    chosen = _goals(arms, requests, scenes, clearance)
    if isinstance(chosen, Outcome):
        return SynchronizedPlan(
            chosen.code, chosen.message, chosen.evidence, planning_time=time.monotonic() - began
        )
    recheck, last = 0.0, None
    start = scene.state.reindexed(arms.joint_names).positions
    endpoints = (start, np.concatenate([chosen[g] for g in groups]))
    near = any(arms.find_too_close(q[None], None, clearance) >= 0 for q in endpoints)
    for attempt in range(0 if near else TRIES):
        results = []
        for group in groups:
            goal = JointGoal(JointState(scene.model.group(group).joint_names, chosen[group]))
            request = replace(requests[group], goals=(goal,), seed=template.seed + 31 * attempt)
            results.append(plan(scenes[group], request))
        failed = next((r for r in results if not r.ok), None)
        if failed is not None:
            return SynchronizedPlan(
                failed.code, failed.message, failed.evidence, planning_time=time.monotonic() - began
            )
        pair = synchronized([r.trajectory for r in results if r.trajectory is not None])
        t0 = time.perf_counter()
        proof = arms.certify(pair[0], pair[1], clearance=clearance, evidence=False)
        recheck = time.perf_counter() - t0
        if proof.free:
            how = "as planned" if attempt == 0 else "planned again"
            return _done(groups, pair, how, began, recheck, clearance)
        last = proof
    both = both or _both(scene, arms)
    names = scene.model.group(both).joint_names
    target = {n: v for g in groups for n, v in zip(scene.model.group(g).joint_names, chosen[g], strict=True)}
    goal = JointGoal(JointState(names, np.array([target[n] for n in names])))
    whole: PlanResult = plan(scene, replace(template, group=both, goals=(goal,), arm_clearance=clearance))
    spent = time.monotonic() - began
    if not whole.ok or whole.trajectory is None:
        evidence = {**whole.evidence, "time": last.time if last else None}
        return SynchronizedPlan(
            whole.code, f"both arms as one: {whole.message}", evidence, planning_time=spent
        )
    parts = tuple(whole.trajectory.reindexed(scene.model.group(g).joint_names) for g in groups)
    kept = float(whole.evidence.get("arm_clearance", 0.0))
    return _done(groups, parts, "as one", began, recheck, kept, whole.message)


def _done(
    groups, pair, how: str, began: float, recheck: float, clearance: float, words: str = ""
) -> SynchronizedPlan:
    return SynchronizedPlan(
        ErrorCode.SUCCESS, words, trajectories=dict(zip(groups, pair, strict=True)), trajectory=merged(*pair),
        how=how, clearance=clearance, planning_time=time.monotonic() - began, recheck_time=recheck,
    )  # fmt: skip


def _goals(arms: Arms, requests, scenes, clearance: float) -> dict[str, Array] | Outcome:
    """Choose goals for synchronized motions of two arms: collision-free positions that are nearest to the
    start.
    """
    found, starts = [], []
    for group, request in requests.items():
        endpoints = find_start_and_goals(validate_request(scenes[group], request))
        if isinstance(endpoints, Outcome):
            return Outcome(endpoints.code, f"{group}: {endpoints.message}", endpoints.evidence)
        found.append(endpoints.goals)
        starts.append(endpoints.start)
    pairs = sorted(
        product(*found), key=lambda ab: sum(float(np.linalg.norm(q - s)) for q, s in zip(ab, starts))
    )
    nearest, best = None, None
    for a, b in pairs:
        q = np.concatenate([a, b])
        if arms.find_too_close(q[None], None, clearance) < 0:
            return dict(zip(requests, (a, b), strict=True))
        contact = arms.contact(q)
        if contact is not None and (nearest is None or contact.distance > nearest.distance):
            nearest, best = contact, (a, b)
    if best is not None and nearest is not None and nearest.distance > TOUCHING:
        return dict(zip(requests, best, strict=True))
    text = f"the goals of {' and '.join(map(repr, requests))} cannot be held at once"
    if nearest is None:
        return Outcome(ErrorCode.GOAL_IN_COLLISION, text)
    return Outcome(
        ErrorCode.GOAL_IN_COLLISION,
        f"{text}: {nearest.body_a} and {nearest.body_b} would touch",
        {"contacts": [nearest]},
    )


def _both(scene: PlanningScene, arms: Arms) -> str:
    wanted = set(arms.joint_names)
    for group in scene.model.groups.values():
        if set(group.joint_names) == wanted:
            return group.name
    raise InputError(
        f"no planning group has the joints of {arms.groups[0]!r} and {arms.groups[1]!r}",
        hint="add one under 'groups' in robot.yaml",
    )
