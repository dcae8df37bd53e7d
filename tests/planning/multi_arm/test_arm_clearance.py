"""Room between two arms of one group: the kernel's verdict against coal, planned motions, what is told."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.planning.multi_arm.dual import FAST, LEFT, RIGHT, Judge, motion, scene, tip, with_tips

from armcell.collision.inter_arm_checker import InterArmChecker, arms_of, nearest_between, sides_of
from armcell.collision.kernel.checker import KernelChecker
from armcell.core import (
    SE3,
    ErrorCode,
    InputError,
    JointGoal,
    JointState,
    JointTrajectory,
    PlanRequest,
    Sphere,
)
from armcell.planning import RunningMotion, plan, plan_synchronized
from armcell.scene import CollisionObject, PlanningScene

pytestmark = pytest.mark.slow  # two arms: proofs, searches and physics by the second

BOTH = "both_arms"
NAMES = scene().model.group(BOTH).joint_names


def standing(q: np.ndarray) -> RunningMotion:
    return RunningMotion(JointTrajectory(NAMES, np.zeros(1), q[None], q[None] * 0, q[None] * 0))


def joints(at: PlanningScene) -> np.ndarray:
    return at.state.reindexed(NAMES).positions


def facing(gap: float) -> PlanningScene:
    """Both tips over the middle of the table, about so far apart [m]."""
    at = scene()
    for group, y in ((LEFT, gap / 2), (RIGHT, -gap / 2)):
        at = at.with_state(motion(at, group, tip(0.0, y, 1.1)).end)
    return at


def test_a_group_of_two_arms_is_known_by_its_joints():
    model = scene().model
    assert set(arms_of(model, BOTH)) == {LEFT, RIGHT}
    for group in (LEFT, "left_gripper", "grippers"):
        assert arms_of(model, group) == ()


def test_the_verdict_is_coal_s():
    """Random postures around some in which the hands are near each other, and edges between them."""
    rng, judge = np.random.default_rng(3), Judge(scene())
    plain = KernelChecker(scene(), NAMES)
    roomy = plain.with_clearance_between(sides_of(scene(), (LEFT, RIGHT)), 0.02)
    base, verdicts = joints(facing(0.12)), []
    for _ in range(150):
        q = base + rng.normal(size=12) * 0.05
        gap = judge.nearest(standing(q))
        if abs(gap - 0.02) < 1e-4 or not plain.is_free(q):
            continue
        verdicts.append(gap > 0.02)
        assert roomy.is_free(q) == verdicts[-1]
        end = q + rng.normal(size=12) * 0.01
        if roomy.certify([q, end], evidence=False).free:
            assert all(judge.nearest(standing(q + s * (end - q))) > 0.02 - 1e-5 for s in (0, 0.25, 0.5, 1))
    assert 15 < sum(verdicts) < len(verdicts) - 15


def test_small_round_things_in_both_hands_keep_their_distance():
    """Their bounding spheres are as small as they are: what is asked for on top must not be forgotten."""
    at = facing(0.3)
    for group, name in ((LEFT, "a"), (RIGHT, "b")):
        gripper = at.model.gripper(arm_group=group)
        place = at.frame_pose(gripper.tcp_link).translation
        middle = 0.02 if group == LEFT else -0.02
        ball = CollisionObject.single(name, Sphere(0.015), SE3.from_xyz(place[0], middle, place[2] - 0.2))
        at = at.with_object(ball).with_attached(name, gripper.tcp_link, gripper.hand_links)
    arms = InterArmChecker(at, (LEFT, RIGHT))
    q = joints(at)[[NAMES.index(n) for n in arms.joint_names]]
    assert arms.contact(q).distance == pytest.approx(0.01, abs=1e-6)
    assert arms.find_too_close(q[None], None, 0.009) < 0
    assert arms.find_too_close(q[None], None, 0.011) >= 0


def passing() -> tuple[JointState, JointState]:
    """The left hand goes past the right one, straight in the joints, about a centimeter off."""
    ends = [joints(with_tips((x, 0.05, 1.1), (0.0, -0.3, 1.1))) for x in (-0.3, 0.3)]
    right = [NAMES.index(n) for n in scene().model.group(RIGHT).joint_names]
    far, near = ends[0][right], joints(with_tips((0.3, 0.05, 1.1), (0.0, 0.05, 1.1)))[right]
    judge, low, high = Judge(scene()), 0.0, 1.0
    for _ in range(12):
        middle = 0.5 * (low + high)
        for q in ends:
            q[right] = far + middle * (near - far)
        line = JointTrajectory(NAMES, np.array([0.0, 1.0]), np.array(ends))
        low, high = (middle, high) if judge.nearest(RunningMotion(line), step=0.02) > 0.01 else (low, middle)
    for q in ends:
        q[right] = far + low * (near - far)
    return JointState(NAMES, ends[0]), JointState(NAMES, ends[1])


def test_motions_of_both_keep_20_mm():
    start, goal = passing()
    judge, wanted = Judge(scene()), JointGoal(goal)
    close = plan(scene(), PlanRequest(BOTH, (wanted,), start, arm_clearance=0.0, **FAST))
    assert judge.nearest(RunningMotion(close.trajectory), step=4e-3) < 0.015  # the straight line
    for seed in range(3):
        result = plan(scene(), PlanRequest(BOTH, (wanted,), start, seed=seed, **FAST))
        assert result.ok, result.message
        assert result.evidence["arm_clearance"] == 0.02 and not result.message
        assert judge.nearest(RunningMotion(result.trajectory), step=4e-3) >= 0.02 - 1e-5
    several = plan(scene(), PlanRequest(BOTH, (wanted,), start, attempts=2, **FAST))
    assert judge.nearest(RunningMotion(several.trajectory), step=4e-3) >= 0.02 - 1e-5
    other = plan(
        scene(), PlanRequest(BOTH, (wanted,), start, planner_id="RRTConnect", pipeline_id="ompl", **FAST)
    )
    assert other.ok and judge.nearest(RunningMotion(other.trajectory), step=4e-3) >= 0.02 - 1e-5


def test_where_no_way_with_room_is_found_any_free_one_is_taken_and_told():
    start, goal = passing()
    few = {"max_iterations": 1}  # too few for a search; the straight line needs none
    result = plan(scene(), PlanRequest(BOTH, (JointGoal(goal),), start, parameters=few, **FAST))
    assert result.ok and result.evidence["arm_clearance"] == 0.0
    assert "no motion was found that keeps 20 mm between them" in result.message
    assert Judge(scene()).nearest(RunningMotion(result.trajectory), step=4e-3) > 0.0
    assert 0.0 < result.min_clearance < 0.015


def test_a_start_that_is_nearer_is_left_and_told():
    at, judge = near_start(), Judge(scene())
    gap = judge.nearest(standing(joints(at)))
    assert 0.002 < gap < 0.018
    goal = JointGoal(JointState(NAMES, joints(scene())))
    result = plan(at, PlanRequest(BOTH, (goal,), **FAST))
    assert result.ok and result.evidence["arm_clearance"] == pytest.approx(gap - 1e-3, abs=2e-4)
    assert "at the start left_" in result.message or "at the start right_" in result.message
    assert judge.nearest(RunningMotion(result.trajectory), step=4e-3) >= gap - 1.2e-3
    free = plan(at, PlanRequest(BOTH, (goal,), arm_clearance=0.0, **FAST))
    assert free.ok and not free.message and "arm_clearance" not in free.evidence


def near_start() -> PlanningScene:
    """The hands about a centimeter apart."""
    sides = sides_of(scene(), (LEFT, RIGHT))
    a, b = joints(facing(0.2)), joints(facing(0.05))
    exact = KernelChecker(scene(), NAMES).exact
    low, high = 0.0, 1.0
    for _ in range(20):
        middle = 0.5 * (low + high)
        contact = nearest_between(exact, sides, a + middle * (b - a))
        low, high = (middle, high) if contact.distance > 0.01 else (low, middle)
    return scene().with_state(JointState(NAMES, a + low * (b - a)))


def test_goals_that_are_nearer_are_planned_as_one_and_told():
    at = near_start()
    goals = {g: JointGoal(at.state.reindexed(scene().model.group(g).joint_names)) for g in (LEFT, RIGHT)}
    result = plan_synchronized(scene(), goals, template=PlanRequest(LEFT, (), **FAST))
    assert result.ok and result.how == "as one", result.message
    assert 0.0 < result.clearance < 0.02 and "at the goal" in result.message


def test_misuse():
    goal = JointGoal(JointState(NAMES, joints(scene())))
    with pytest.raises(InputError, match="arm_clearance"):
        plan(scene(), PlanRequest(BOTH, (goal,), arm_clearance=-0.1))
    touching = replace(PlanRequest(BOTH, (goal,)), start=JointState(NAMES, joints(facing(0.0))))
    assert plan(scene(), touching).code is ErrorCode.START_STATE_IN_COLLISION
