"""Plans for three and four arms: together, around several moving arms, and as one group."""

from __future__ import annotations

from functools import lru_cache
from itertools import product

import numpy as np
import pytest
from tests.planning.multi_arm.dual import FAST, SLOW, Judge, tip

import armcell
from armcell.collision.inter_arm_checker import (
    InterArmChecker,
    arms_of,
    check_arms,
    combined_group,
    without_arms,
)
from armcell.core import ErrorCode, InputError, NamedGoal, PlanRequest
from armcell.model import load_robot
from armcell.planning import RunningMotion, plan, plan_around_moving_arms, plan_synchronized
from armcell.planning.multi_arm.synchronized import _by_cost
from armcell.timing import reverse_trajectory

A, B, C, D = "a_arm", "b_arm", "c_arm", "d_arm"
CELLS = {"three_ur5_table": (A, B, C), "four_ur5_square": (A, B, C, D)}
PAIRS = """
parts:
  - {robot: ur10, prefix: a_, pose: [0, 0, 0]}
  - {robot: ur10, prefix: b_, pose: [0, 3, 0]}
  - {robot: ur10, prefix: c_, pose: [0, 6, 0]}
groups:
  front: [a_arm, b_arm]
  back: [b_arm, c_arm]
  all_arms: [front, c_arm]
"""


@lru_cache(maxsize=2)
def scene(name: str = "three_ur5_table"):
    return armcell.load(name).scene()


def alone(group: str, goal, **speeds):
    """The motion of one of three arms as if it were alone, from its home."""
    others = [g for g in (A, B, C) if g != group]
    result = plan(without_arms(scene(), *others), PlanRequest(group, (goal,), **(speeds or FAST)))
    assert result.trajectory is not None, result.message
    return result.trajectory


@pytest.mark.parametrize("name", CELLS)
def test_a_group_of_all_arms_is_made_of_them(name):
    model, arms = scene(name).model, CELLS[name]
    assert arms_of(model, "all_arms") == arms
    assert combined_group(model, arms[::-1]) == "all_arms"
    assert len(model.group("all_arms").joint_names) == 6 * len(arms)
    with pytest.raises(InputError, match=r"no planning group has the joints of 'a_arm' and 'b_arm'"):
        combined_group(model, (A, B))


def test_groups_of_several_arms_are_not_taken_for_arms(tmp_path):
    (tmp_path / "robot.yaml").write_text(PAIRS)
    model = load_robot(tmp_path)
    assert arms_of(model, "all_arms") == (A, B, C)
    assert arms_of(model, "front") == (A, B) and arms_of(model, A) == ()


@pytest.mark.slow
def test_arms_are_tested_against_each_other_or_one_against_the_rest():
    """B and C meet in the middle while A is at home."""
    at = scene()
    for group, x in ((B, -0.02), (C, 0.02)):
        at = at.with_state(alone(group, tip(x, 0.0)).end)
    all_three, mover = InterArmChecker(at, (A, B, C)), InterArmChecker(at, (A, B, C), A)
    q = at.state.reindexed(all_three.joint_names).positions
    touching = all_three.contact(q)
    assert touching is not None and {touching.body_a[0], touching.body_b[0]} == {"b", "c"}
    assert all_three.find_too_close(q[None]) >= 0 and mover.find_too_close(q[None]) < 0
    nearest = mover.contact(q)
    assert nearest is not None and nearest.distance > 0.02 and "a" in (nearest.body_a[0], nearest.body_b[0])
    assert InterArmChecker(at, (A, B, C), B).find_too_close(q[None]) >= 0


@pytest.mark.slow
@pytest.mark.cases("three_ur5_table")
@pytest.mark.parametrize("name", CELLS)
def test_all_start_and_arrive_together_and_keep_apart(name):
    arms = CELLS[name]
    goals = {g: tip(0.16 * np.cos(k * 2 * np.pi / len(arms)), 0.16 * np.sin(k * 2 * np.pi / len(arms)))
             for k, g in enumerate(arms)}  # fmt: skip
    result = plan_synchronized(scene(name), goals, template=PlanRequest(A, (), **FAST))
    assert result.ok and result.trajectories is not None and result.trajectory is not None, result.message
    assert tuple(result.trajectories) == arms
    durations = {round(t.duration, 6) for t in result.trajectories.values()}
    assert len(durations) == 1 and result.trajectory.duration == pytest.approx(durations.pop())
    motions = [RunningMotion(t) for t in result.trajectories.values()]
    assert Judge(scene(name), "all_arms").nearest(*motions, step=4e-3) >= min(result.clearance, 0.02) - 1e-5


@pytest.mark.slow
def test_two_of_three_goals_in_one_place_are_named():
    goals = {A: tip(0.3, 0.0), B: tip(0.0, 0.0), C: tip(0.0, 0.0)}
    result = plan_synchronized(scene(), goals, template=PlanRequest(A, (), **FAST))
    assert result.code is ErrorCode.GOAL_IN_COLLISION
    contact = result.evidence["contacts"][0]
    assert {contact.body_a[0], contact.body_b[0]} == {"b", "c"} and contact.body_a in result.message


def test_goals_are_tried_in_the_order_of_their_cost():
    rng = np.random.default_rng(0)
    costs = [rng.integers(0, 5, n).astype(float).tolist() for n in (3, 4, 2)]
    every = list(product(*(range(len(row)) for row in costs)))
    cost = [sum(row[k] for row, k in zip(costs, choice, strict=True)) for choice in every]
    assert list(_by_cost(costs)) == [every[i] for i in np.argsort(cost, kind="stable")]
    assert list(_by_cost([[1.0], []])) == []


@pytest.mark.slow
def test_around_two_arms_that_leave_the_middle():
    """B and C are in the way, one after the other, and A goes as soon as both have left."""
    at, running = scene(), {}
    for group, start, x in ((B, 0.5, -0.08), (C, 1.5, 0.08)):
        there = alone(group, tip(x, 0.0 if group == B else -0.1), **SLOW)
        at = at.with_state(there.end)
        running[group] = RunningMotion(reverse_trajectory(there), start)
    result = plan_around_moving_arms(at, PlanRequest(A, (tip(0.0, -0.05),), **FAST), running)
    assert result.ok and result.trajectory is not None, result.message
    assert result.evidence["beside"] != "as planned"
    motions = [RunningMotion(result.trajectory), *running.values()]
    judge = Judge(at, "all_arms")
    assert judge.nearest(*motions, step=4e-3) >= 0.015
    assert result.trajectory.duration > alone(A, tip(0.0, -0.05)).duration


def test_all_arms_as_one_group_keep_20_mm():
    at = scene("four_ur5_square")
    result = plan(at, PlanRequest("all_arms", (NamedGoal("up"),), **FAST))
    assert result.ok and result.trajectory is not None, result.message
    assert result.evidence["arm_clearance"] == pytest.approx(0.02)
    judge = Judge(at, "all_arms")
    assert judge.nearest(RunningMotion(result.trajectory), step=4e-3) >= 0.02 - 1e-5


def test_misuse():
    model = scene().model
    with pytest.raises(InputError, match="0 goals given, at least two arms need one each"):
        plan_synchronized(scene(), {})
    with pytest.raises(InputError, match="'a_arm' and 'all_arms' share 'a_"):
        check_arms(model, (A, B, "all_arms"))
