"""Two arms, one of which stands in resting contact: it leads out, alone, together and beside the other."""

from __future__ import annotations

import numpy as np
import pytest
from tests.planning.multi_arm.dual import FAST, LEFT, RIGHT, SLOW, Judge, motion, tip, with_tips
from tests.planning.resting import SINK, brought_to, judge_from_rest
from tests.scene.helpers import box

from armcell.collision.inter_arm_checker import without_arms
from armcell.core import SE3, JointGoal, PlanRequest
from armcell.planning import RunningMotion, plan, plan_around_moving_arms, plan_synchronized
from armcell.scene import PlanningScene

pytestmark = pytest.mark.slow  # two arms: proofs and searches by the second

UP = np.array([0.0, 0.0, 1.0])


def on_a_block(left: tuple, right: tuple) -> PlanningScene:
    """The left arm's fingers stand on a block."""
    at = with_tips(left, right)
    T = at.frame_pose("left_gripper_tcp")
    block = box("block", (0.15, 0.15, 0.02)).at(SE3(T.rotation, T.translation - 0.3 * UP))
    return brought_to(at, block, UP, SINK, LEFT)


def test_together_they_start_although_one_rests_on_something():
    at = on_a_block((-0.4, 0.0), (0.4, 0.0))
    goals = {LEFT: tip(-0.3, 0.2), RIGHT: tip(0.4, 0.2)}
    result = plan_synchronized(at, goals, template=PlanRequest(LEFT, (), **FAST))
    assert result.ok, result.message
    judge_from_rest(at, result.trajectories[LEFT])
    judge_from_rest(at, result.trajectory)
    pair = [RunningMotion(t) for t in result.trajectories.values()]
    assert Judge(at).nearest(*pair, step=4e-3) >= 0.02 - 1e-5


def test_both_arms_as_one_group_lead_out_of_two_contacts():
    at = on_a_block((-0.4, 0.0), (0.4, 0.0))
    T = at.frame_pose("right_gripper_tcp")
    other = box("other", (0.15, 0.15, 0.02)).at(SE3(T.rotation, T.translation - 0.3 * UP))
    at = brought_to(at, other, UP, SINK, RIGHT)
    higher = with_tips((-0.4, 0.2), (0.4, 0.2))
    goal = JointGoal(higher.state.reindexed(at.model.group("both_arms").joint_names))
    result = plan(at, PlanRequest("both_arms", (goal,), **FAST))
    assert result.ok, result.message
    touched = {c.body_b for c in result.evidence["start_repaired"]["contacts"]}
    assert {"block", "other"} <= touched
    judge_from_rest(at, result.trajectory)


@pytest.mark.parametrize("how", ["as planned", "searched"])
def test_beside_a_running_arm(how):
    """Also where the search in time begins after the way out."""
    if how == "as planned":
        at, there, goal = on_a_block((-0.4, 0.0), (0.4, 0.0)), (0.2, 0.2), tip(-0.3, 0.2)
    else:
        at, there, goal = on_a_block((0.4, 0.0), (-0.4, 0.0)), (0.4, 0.0, 1.12), tip(-0.4, 0.0)
    running = RunningMotion(motion(at, RIGHT, tip(*there), **SLOW), 0.0)
    result = plan_around_moving_arms(at, PlanRequest(LEFT, (goal,), **FAST), {RIGHT: running})
    assert result.ok, result.message
    assert result.evidence["beside"] == how
    judge_from_rest(without_arms(at, RIGHT), result.trajectory)
    nearest = Judge(at).nearest(RunningMotion(result.trajectory, 0.0), running, step=4e-3)
    assert nearest >= 0.02 - 1e-5
