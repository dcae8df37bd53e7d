"""Two arms that start and arrive together: the timed pair against coal, stretched, repaired, refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.planning.multi_arm.dual import FAST, LEFT, OTHER, RIGHT, Judge, motion, scene, tip
from tests.sizes import seeds

from armcell.collision.inter_arm_checker import InterArmChecker, without_arms
from armcell.core import Box, ErrorCode, InputError, JointTrajectory, PlanRequest
from armcell.planning import RunningMotion, plan, plan_synchronized
from armcell.scene import CollisionObject
from armcell.timing import merge_trajectories, synchronize_trajectories
from armcell.timing.chords import acceleration_bounds, chords, positions_at

pytestmark = pytest.mark.slow  # two arms: proofs, searches and physics by the second

TEMPLATE = PlanRequest(LEFT, (), **FAST)


@pytest.fixture(scope="module")
def arms():
    return InterArmChecker(scene(), (LEFT, RIGHT))


# --- one clock ---
@pytest.fixture(scope="module")
def pair():
    return synchronize_trajectories(
        [motion(scene(), LEFT, tip(0.3, -0.1)), motion(scene(), RIGHT, tip(-0.3, 0.1))]
    )


def test_positions_are_those_of_sample(pair):
    t = np.concatenate([[-1.0, 0.0], np.linspace(0, pair[0].duration, 57), [99.0]])
    for trajectory in (*pair, replace(pair[0], accelerations=None)):
        expected = np.array([trajectory.sample(x)[0] for x in t])
        np.testing.assert_allclose(positions_at(trajectory, t), expected, atol=1e-12)


def test_chords_are_as_near_as_they_say(pair):
    times, points, room = chords(pair, (0.0, 0.7), 0.0, pair[1].duration + 0.7)
    fine = np.linspace(0, times[-1], 4001)
    true = np.hstack([positions_at(pair[0], fine), positions_at(pair[1], fine - 0.7)])
    chord = np.column_stack([np.interp(fine, times, column) for column in points.T])
    off = np.abs(true - chord).max(axis=0)
    assert np.all(off <= room + 1e-12)
    assert room.max() <= 5.1e-4 and off.max() > 0.2 * room.max()  # a bound, and no idle one


def test_accelerations_are_bounded_between_points(pair):
    for trajectory in (pair[0], replace(pair[0], accelerations=None)):
        t = np.linspace(0, trajectory.duration, 3000)
        seen = np.abs([trajectory.sample(x)[2] for x in t]).max(axis=0)
        most = acceleration_bounds(trajectory)
        assert np.all(seen <= most + 1e-9) and np.all(most <= 1.5 * seen + 0.05)


def test_both_as_one_trajectory(pair):
    whole = merge_trajectories(pair[0], pair[1])
    for t in np.linspace(0, whole.duration, 101):
        expected = np.concatenate([p.sample(t)[0] for p in pair])
        np.testing.assert_allclose(whole.sample(t)[0], expected, atol=1e-6)


# --- the proof of a timed pair ---
def _agrees(arms, judge, first, second, clearance) -> bool:
    """The verdict; wrong if coal sees otherwise at any millisecond (half a millimeter is nobody's)."""
    free = arms.certify(first, second, clearance=clearance, evidence=False).free
    nearest = judge.nearest(RunningMotion(first), RunningMotion(second))
    if free:
        assert nearest >= clearance - 1e-5
    else:
        assert nearest <= clearance + 1e-3
    return free


def _random_pair(rng):
    tips = [tip(*rng.uniform((-0.5, -0.25, 0.98), (0.5, 0.25, 1.3))) for _ in range(2)]
    return [motion(scene(), g, p) for g, p in zip((LEFT, RIGHT), tips, strict=True)]


@pytest.mark.cases("3")
@pytest.mark.parametrize("seed", seeds(8, range(40)))
def test_the_timed_pair_is_what_coal_sees_every_millisecond(arms, seed):
    _agrees(arms, Judge(scene()), *_random_pair(np.random.default_rng(seed)), (0.0, 0.02)[seed % 2])


def test_contact_is_told_with_pair_and_time(arms):
    first, second = (motion(scene(), g, tip(0.0, 0.02)) for g in (LEFT, RIGHT))
    proof = arms.certify(first, second)
    assert not proof.free and proof.contact is not None
    assert {proof.contact.body_a.split("_")[0], proof.contact.body_b.split("_")[0]} == {"left", "right"}
    judge = Judge(scene())
    early = RunningMotion(first), RunningMotion(second)
    before = [
        RunningMotion(
            JointTrajectory(m.trajectory.joint_names, [0.0], [m.trajectory.sample(proof.time - 0.1)[0]])
        )
        for m in early
    ]
    assert judge.nearest(*before) > 0 >= judge.nearest(*early) - 1e-3


def test_what_an_arm_holds_counts(arms):
    first, second = motion(scene(), LEFT, tip(0.1, 0.05)), motion(scene(), RIGHT, tip(0.1, -0.4))
    assert arms.certify(first, second, clearance=0.02).free
    at = scene()
    gripper = at.model.gripper("left_gripper")
    bar = CollisionObject.single("bar", Box(0.9, 0.02, 0.02), at.frame_pose(gripper.tcp_link))
    held = at.with_object(bar).with_attached("bar", gripper.tcp_link, gripper.hand_links)
    turned = InterArmChecker(held, (LEFT, RIGHT)).certify(first, motion(scene(), RIGHT, tip(0.45, 0.05)))
    assert not turned.free and "bar" in (turned.contact.body_a, turned.contact.body_b)


def test_motions_that_do_not_end_at_rest_are_refused(arms, pair):
    fast = replace(pair[0], velocities=pair[0].velocities + 0.1)
    with pytest.raises(InputError, match="at rest"):
        arms.certify(fast, pair[1])
    with pytest.raises(InputError, match="joints are not those"):
        arms.certify(pair[1], pair[0])


# --- planning for both ---
CASES = {
    "apart": ((0.3, -0.1, 1.1), (-0.3, 0.1, 1.1)),
    "past each other": ((-0.3, -0.1), (0.3, 0.1)),
    "close": ((0.1, -0.15), (-0.1, 0.15)),
    "through each other": ((-0.1, -0.2), (0.1, 0.2)),
}


@pytest.mark.cases("apart", "close")
@pytest.mark.parametrize("name", CASES)
def test_they_start_and_arrive_together_and_apart(name):
    goals = dict(zip((LEFT, RIGHT), (tip(*xyz) for xyz in CASES[name]), strict=True))
    result = plan_synchronized(scene(), goals, template=TEMPLATE)
    assert result.ok, result.message
    a, b = (result.trajectories[g] for g in (LEFT, RIGHT))
    assert abs(a.duration - b.duration) <= 1e-9 and a.duration == result.trajectory.duration
    for group, trajectory in result.trajectories.items():
        assert np.allclose(trajectory.positions[0], scene().state.reindexed(trajectory.joint_names).positions)
        at = scene().with_state(trajectory.end)
        gripper = at.model.gripper(arm_group=group)
        assert at.frame_pose(gripper.tcp_link).isclose(goals[group].T_world_link, 1e-4, 1e-3)
    assert result.clearance == 0.02 and not result.message
    assert Judge(scene()).nearest(RunningMotion(a), RunningMotion(b), step=4e-3) >= 0.02 - 1e-5


def test_a_pair_that_meets_is_repaired():
    goals = dict(zip((LEFT, RIGHT), (tip(*xyz) for xyz in CASES["through each other"]), strict=True))
    alone = {
        g: plan(without_arms(scene(), OTHER[g]), PlanRequest(g, (goal,), **FAST)).trajectory
        for g, goal in goals.items()
    }
    first, second = synchronize_trajectories([alone[LEFT], alone[RIGHT]])
    assert not InterArmChecker(scene(), (LEFT, RIGHT)).certify(first, second, clearance=0.02).free
    assert plan_synchronized(scene(), goals, template=TEMPLATE).how in ("planned again", "as one")


def test_two_tips_to_one_point_are_refused_with_the_pair():
    result = plan_synchronized(scene(), {LEFT: tip(0, 0, 1.1), RIGHT: tip(0, 0, 1.1)}, template=TEMPLATE)
    assert result.code is ErrorCode.GOAL_IN_COLLISION
    (contact,) = result.evidence["contacts"]
    assert contact.body_a.startswith("left_") != contact.body_b.startswith("left_")
    assert contact.body_a in result.message and contact.body_b in result.message


def test_one_arm_s_own_failure_is_told_with_its_name():
    result = plan_synchronized(scene(), {LEFT: tip(3, 0, 1.1), RIGHT: tip(0, 0, 1.1)}, template=TEMPLATE)
    assert result.code is ErrorCode.NO_IK_SOLUTION and "left_arm" in result.message


def test_misuse():
    with pytest.raises(InputError, match="two arms need one each"):
        plan_synchronized(scene(), {LEFT: tip(0, 0)})
    with pytest.raises(InputError, match="share"):
        plan_synchronized(scene(), {LEFT: tip(0, 0), "both_arms": tip(0, 0)})
