"""Planning of the motions of several arms that start and end at the same time."""

from __future__ import annotations

import heapq
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from armcell.collision.inter_arm_checker import (
    CLEARANCE,
    InterArmChecker,
    check_arms,
    combined_group,
    sides_of,
    without_arms,
)
from armcell.core import (
    ErrorCode,
    Goal,
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
from armcell.timing import merge_trajectories, synchronize_trajectories

Array = NDArray[np.float64]

TOUCHING = 1e-4  # [m] goals closer than this are rejected
TRIES = 3  # sets of separate plans with different seeds before planning the arms as one group
COMBINATIONS = 5000  # of joint goals of all arms that are tried


@dataclass(frozen=True, repr=False)
class SynchronizedPlan(Outcome):
    """Result of planning synchronized motions for several arms: one trajectory per arm, all with the same
    duration, and one trajectory for all joints together.

    They are None unless planning succeeded.
    """

    trajectories: Mapping[str, JointTrajectory] | None = None
    trajectory: JointTrajectory | None = None
    how: str = ""  # "as planned", "planned again" or "as one"
    clearance: float = 0.0  # [m] proven clearance between the arms; `message` explains a smaller one
    planning_time: float = 0.0  # [s], wall clock
    recheck_time: float = 0.0  # [s] of it for the last proof of the timed motions


def plan_synchronized(
    scene: PlanningScene,
    goals: Mapping[str, Goal],
    combined: str | None = None,
    clearance: float = CLEARANCE,
    template: PlanRequest | None = None,
) -> SynchronizedPlan:
    """Plan synchronized motions of several arms, which start and end at the same time and keep a clearance
    between the arms.

    Each arm is planned without the others, shorter motions are stretched to the longest duration, and the
    timed motions are proven. If the proof fails, planning repeats with other seeds, then plans the arms as
    one group. If start or goals are closer than `clearance`, the arms are planned as one group at once; the
    result reports the clearance that is kept.

    Args:
        goals: the goal of each arm, by group; two or more.
        combined: group of all these arms' joints; by default the group with exactly these joints.
        clearance: distance between the arms [m].
        template: speeds, planner and times of the requests; its group and goals are ignored.
    Returns:
        GOAL_IN_COLLISION with the pair of bodies if the arms cannot hold all goals without touching.
    Raises:
        InputError: fewer than two groups, groups that share joints, no combined group; misuse as of `plan`.
    """
    began = time.monotonic()
    groups = tuple(goals)
    check_arms(scene.model, groups, "goal")
    arms = InterArmChecker(scene, groups)
    template = template or PlanRequest(groups[0], ())
    requests = {g: replace(template, group=g, goals=(goal,)) for g, goal in goals.items()}
    scenes = {g: without_arms(scene, *(other for other in groups if other != g)) for g in groups}
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
        motions = synchronize_trajectories([r.trajectory for r in results if r.trajectory is not None])
        t0 = time.perf_counter()
        proof = arms.certify(*motions, clearance=clearance, evidence=False)
        recheck = time.perf_counter() - t0
        if proof.free:
            how = "as planned" if attempt == 0 else "planned again"
            return _done(groups, motions, how, began, recheck, clearance)
        last = proof
    combined = combined or combined_group(scene.model, groups)
    names = scene.model.group(combined).joint_names
    target = {n: v for g in groups for n, v in zip(scene.model.group(g).joint_names, chosen[g], strict=True)}
    goal = JointGoal(JointState(names, np.array([target[n] for n in names])))
    whole: PlanResult = plan(scene, replace(template, group=combined, goals=(goal,), arm_clearance=clearance))
    spent = time.monotonic() - began
    if not whole.ok or whole.trajectory is None:
        evidence = {**whole.evidence, "time": last.time if last else None}
        return SynchronizedPlan(
            whole.code, f"the arms as one group: {whole.message}", evidence, planning_time=spent
        )
    parts = tuple(whole.trajectory.reindexed(scene.model.group(g).joint_names) for g in groups)
    kept = float(whole.evidence.get("arm_clearance", 0.0))
    return _done(groups, parts, "as one", began, recheck, kept, whole.message)


def _done(
    groups, motions, how: str, began: float, recheck: float, clearance: float, words: str = ""
) -> SynchronizedPlan:
    return SynchronizedPlan(
        ErrorCode.SUCCESS, words, trajectories=dict(zip(groups, motions, strict=True)),
        trajectory=merge_trajectories(*motions), how=how, clearance=clearance,
        planning_time=time.monotonic() - began, recheck_time=recheck,
    )  # fmt: skip


def _goals(arms: InterArmChecker, requests, scenes, clearance: float) -> dict[str, Array] | Outcome:
    """Choose goals for synchronized motions of several arms: collision-free positions that are nearest to the
    start.
    """
    found, costs = [], []
    for group, request in requests.items():
        endpoints = find_start_and_goals(validate_request(scenes[group], request))
        if isinstance(endpoints, Outcome):
            return Outcome(endpoints.code, f"{group}: {endpoints.message}", endpoints.evidence)
        found.append(endpoints.goals)
        costs.append([float(np.linalg.norm(q - endpoints.start)) for q in endpoints.goals])
    side = sides_of(arms.scene, arms.groups)
    touching: set[frozenset[tuple[int, int]]] = set()  # two arms, each with the number of a goal
    nearest, best = None, None
    for choice in islice(_by_cost(costs), COMBINATIONS):
        if any(pair <= set(enumerate(choice)) for pair in touching):
            continue
        positions = [goals[k] for goals, k in zip(found, choice, strict=True)]
        q = np.concatenate(positions)
        if arms.find_too_close(q[None], None, clearance) < 0:
            return dict(zip(requests, positions, strict=True))
        contact = arms.contact(q)
        if contact is None:
            continue
        if nearest is None or contact.distance > nearest.distance:
            nearest, best = contact, positions
        if contact.distance <= TOUCHING:
            touching.add(frozenset((k, choice[k]) for k in (side[contact.body_a], side[contact.body_b])))
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


def _by_cost(costs: Sequence[Sequence[float]]) -> Iterator[tuple[int, ...]]:
    """Yield combinations of goals for synchronized motions, the combination with the lowest total cost first.
    Each one is a tuple with the index of one goal per arm.

    Args:
        costs: the cost of each goal, by arm.
    """
    ranked = [sorted(range(len(row)), key=row.__getitem__) for row in costs]

    def entry(ranks: tuple[int, ...]) -> tuple[float, tuple[int, ...], tuple[int, ...]]:
        choice = tuple(order[k] for order, k in zip(ranked, ranks, strict=True))
        return sum(row[k] for row, k in zip(costs, choice, strict=True)), choice, ranks

    waiting = [entry((0,) * len(costs))] if all(costs) else []
    seen = {ranks for _, _, ranks in waiting}
    while waiting:
        _, choice, ranks = heapq.heappop(waiting)
        yield choice
        for k, order in enumerate(ranked):
            after = (*ranks[:k], ranks[k] + 1, *ranks[k + 1 :])
            if after[k] < len(order) and after not in seen:
                seen.add(after)
                heapq.heappush(waiting, entry(after))
