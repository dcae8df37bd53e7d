"""Obstacles with known motions: proofs in time against dense sampling, and plans that keep off them."""

from __future__ import annotations

import numpy as np
import pytest
from tests.planning.helpers import judge, request
from tests.scene.helpers import box, floating, panda
from tests.sizes import seeds

from armcell.collision import ExactChecker, certify_timed
from armcell.core import (
    SE3,
    Box,
    ErrorCode,
    InputError,
    JointGoal,
    JointState,
    JointTrajectory,
    Plane,
    PointCloud,
)
from armcell.planning.moving_obstacles import plan_around_moving_obstacles
from armcell.scene import CollisionObject, MovingObject, PlanningScene
from armcell.timing import BlendedPath, delay_trajectory, parameterize

ARM = tuple(f"panda_joint{i}" for i in range(1, 8))


def crossing(begin: float, end: float, y: float = 0.5) -> MovingObject:
    """A 0.1 m cube that crosses the rail of `floating` at x = 1 along y, from -y to y."""
    ways = (SE3.from_xyz(1, -y, 0), SE3.from_xyz(1, y, 0))
    return MovingObject(box("cube2", (0.1, 0.1, 0.1)), np.array([begin, end]), ways)


def slide(x0: float, x1: float, duration: float) -> JointTrajectory:
    """The 0.2 m cube of `floating` at an even speed."""
    return JointTrajectory(("x",), np.array([0.0, duration]), np.array([[x0], [x1]]))


def first_contact(scene, trajectory, item, start, end, step=0.0005) -> float | None:
    """By looking at a scene for every instant."""
    for t in np.arange(start, end, step):
        q = trajectory.sample(t - start)[0]
        here = scene.with_object(item.object.at(item.pose(t))).with_state(
            JointState(trajectory.joint_names, q)
        )
        if ExactChecker(here).contacts(here.positions, padded=False):
            return float(t)
    return None


def test_two_cubes_by_hand():
    """The big cube comes to x = 0.85 (contact) at 0.85 s; the small one is at |y| < 0.15 from 0.35 to 0.65 s
    after it has set out, and gone afterwards."""
    motion = slide(0.0, 2.0, 2.0)
    scene = floating()
    early = certify_timed(scene, motion, [crossing(0.0, 1.0)])  # gone at 0.65 s
    assert early.free
    meets = certify_timed(scene, motion, [crossing(0.6, 1.6)])  # there from 0.95 s on: in the middle of it
    assert not meets.free and meets.time == pytest.approx(0.95, abs=0.002)
    assert {meets.contact.body_a, meets.contact.body_b} == {"cube", "cube2"}
    late = certify_timed(scene, motion, [crossing(1.0, 2.0)])  # there from 1.35 s; the big one goes at 1.15 s
    assert late.free
    assert not certify_timed(scene, motion, [crossing(1.0, 2.0)], start_time=0.3).free
    assert certify_timed(scene, motion, [crossing(0.0, 1.0)], clearance=0.1).free
    assert not certify_timed(scene, motion, [crossing(0.0, 1.0)], clearance=0.2).free


def test_staying_at_the_end():
    motion = slide(0.0, 1.0, 1.0)  # arrives in the small cube's way and stays
    scene = floating()
    assert certify_timed(scene, motion, [crossing(2.0, 3.0)]).free
    stays = certify_timed(scene, motion, [crossing(2.0, 3.0)], until=4.0)
    assert stays.time == pytest.approx(2.35, abs=0.002)
    allowed = scene.with_object(crossing(0, 1).object).with_allowed("cube", "cube2")
    assert certify_timed(allowed, motion, [crossing(2.0, 3.0)], until=4.0).free


@pytest.mark.slow
@pytest.mark.parametrize("seed", seeds(4, range(12)))
def test_against_dense_sampling(seed):
    """A Panda on its timed way, and a plate that turns and comes by."""
    rng = np.random.default_rng(seed)
    scene = panda()
    q0 = scene.positions[:7]
    q1 = q0 + rng.uniform(-0.8, 0.8, 7)
    model = scene.model
    q1 = np.clip(q1, model.lower[:7] + 0.01, model.upper[:7] - 0.01)
    path = BlendedPath(np.array([q0, (q0 + q1) / 2 + rng.uniform(-0.1, 0.1, 7), q1]), 0.02)
    v, a = (model.limits(ARM, kind) for kind in ("velocity", "acceleration"))
    motion = parameterize(path, ARM, v, a)
    tip = scene.frame_pose("panda_hand").translation
    way = [SE3.from_xyz_rpy(tip + rng.uniform(-0.5, 0.5, 3), rng.uniform(-3, 3, 3)) for _ in range(3)]
    plate = MovingObject(box("plate", (0.3, 0.2, 0.02)), motion.duration * np.array([0.1, 0.5, 0.9]), way)
    proof = certify_timed(scene, motion, [plate])
    seen = first_contact(scene, motion, plate, 0.0, motion.duration, 0.004)
    if seen is None and not proof.free:  # a touch shorter than the samples
        here = scene.with_object(plate.object.at(plate.pose(proof.time)))
        here = here.with_state(JointState(ARM, motion.sample(proof.time)[0]))
        assert ExactChecker(here).nearest(here.positions).distance < 2e-4
    elif seen is not None:
        assert not proof.free and seen - 0.005 <= proof.time <= seen + 0.005


# --- planning ---
def passing(begin: float, speed: float = 0.5) -> MovingObject:
    """A post that crosses the Panda's way from right to left in front of it, upwards out of the world."""
    ways = [SE3.from_xyz(0.5, 0.0, z) for z in (-1.5, 0.4, 2.5)]
    times = begin + np.array([0.0, 1.9, 4.0]) / speed
    return MovingObject(box("post", (0.1, 0.1, 0.8)), times, tuple(ways))


def across() -> tuple[PlanningScene, JointGoal]:
    scene = panda(joint1=-0.7, joint2=0.3, joint4=-2.2, joint6=2.5).with_padding(0.005)
    return scene, JointGoal(JointState(("panda_joint1",), [0.7]))


def test_nothing_in_the_way():
    scene, goal = across()
    result = plan_around_moving_obstacles(scene, request(goal), [passing(100.0)])
    assert result.ok and result.evidence["moving"] == "as planned" and result.evidence["wait"] == 0
    assert plan_around_moving_obstacles(scene, request(goal), []).evidence["moving"] == "as planned"


@pytest.mark.slow
@pytest.mark.cases("-2.0")
@pytest.mark.parametrize("begin", [-1.0, -2.0])
def test_a_post_that_comes_by(begin):
    scene, goal = across()
    post = passing(begin, speed=1.0)
    plain = plan_around_moving_obstacles(scene, request(goal), [])
    assert not certify_timed(scene, plain.trajectory, [post]).free  # it does matter
    result = plan_around_moving_obstacles(scene, request(goal), [post])
    assert result.ok and result.evidence["moving"] in ("waits", "around")
    assert first_contact(scene, result.trajectory, post, 0.0, result.trajectory.duration, 0.01) is None
    judge(scene, result.trajectory)
    if result.evidence["moving"] == "waits":
        assert result.trajectory.duration == pytest.approx(
            plain.trajectory.duration + result.evidence["wait"]
        )


@pytest.mark.slow
def test_waiting_is_sooner_than_a_long_way_round():
    """A wall that comes down in front of the goal: nothing goes around it, a moment later it is gone."""
    scene, goal = across()
    ways = (SE3.from_xyz(0.5, 0.25, 0.8), SE3.from_xyz(0.5, 0.25, 0.8), SE3.from_xyz(0.5, 0.25, 4.0))
    wall = MovingObject(box("wall", (2.5, 0.02, 2.5)), np.array([0.0, 2.0, 3.0]), ways)
    result = plan_around_moving_obstacles(scene, request(goal), [wall])
    assert result.ok and result.evidence["moving"] == "waits" and 1.0 < result.evidence["wait"] < 3.0
    assert first_contact(scene, result.trajectory, wall, 0.0, result.trajectory.duration, 0.01) is None
    still = result.trajectory.sample(result.evidence["wait"] - 1e-6)[0]
    np.testing.assert_allclose(still, scene.positions[:7], atol=1e-9)


def test_one_that_never_goes():
    scene, goal = across()
    there = scene.with_state(goal.state).frame_pose("panda_hand")
    block = MovingObject(box("block", (0.2, 0.2, 0.2)), np.array([0.0]), (there,))
    result = plan_around_moving_obstacles(scene, request(goal, planning_time=2.0), [block])
    assert result.code is ErrorCode.PLANNING_FAILED and "block" in result.message
    assert result.evidence["contact"] is not None and result.evidence["time"] > 0


def test_waiting_first():
    motion = slide(0.0, 1.0, 1.0)
    later = delay_trajectory(motion, 0.5)
    for t in (0.0, 0.3, 0.5, 1.0, 1.5):
        np.testing.assert_allclose(later.sample(t)[0], motion.sample(t - 0.5)[0], atol=1e-12)


def test_a_moving_objects_numbers():
    item = crossing(0.0, 1.0)
    assert item.travel(0.25, 0.75) == pytest.approx(0.5) and item.travel(2, 3) == 0
    np.testing.assert_allclose(item.pose(0.75).translation, [1, 0.25, 0])
    assert item.pose(-1).isclose(item.poses[0]) and item.pose(9).isclose(item.poses[1])
    turning = MovingObject(box("a", (2, 0.1, 0.1)), np.array([0.0, 1.0]),
                           (SE3.identity(), SE3.from_xyz_rpy((0, 0, 0), (0, 0, 1.0))))  # fmt: skip
    corner = np.array([1, 0.05, 0.05])
    moved = np.linalg.norm(turning.pose(0.6).apply(corner) - turning.pose(0.5).apply(corner))
    assert moved <= turning.travel(0.5, 0.6) <= 1.1 * moved
    swept = item.swept(0.0, 1.0, step=0.1)
    gaps = np.diff([T.translation[1] for _, T in swept.shapes])
    np.testing.assert_allclose(gaps, 0.1, atol=1e-3)
    assert len(item.swept(5.0, 6.0).shapes) == 1


BOX = CollisionObject.single("a", Box(1, 1, 1))


@pytest.mark.parametrize(
    ("item", "times", "count", "text"),
    [
        (BOX, [], 0, "0 poses"), (BOX, [0.0, 1.0], 1, "1 poses at 2"), (BOX, [1.0, 1.0], 2, "increase"),
        (BOX, [0.0, np.nan], 2, "finite"), (CollisionObject.single("a", Plane()), [0.0], 1, "cannot move"),
        (CollisionObject.single("a", PointCloud(np.zeros((1, 3)), 0.1)), [0.0], 1, "cannot move"),
    ],
)  # fmt: skip
def test_bad_moving_objects(item, times, count, text):
    with pytest.raises(InputError, match=text):
        MovingObject(item, np.array(times), (SE3.identity(),) * count)


def test_misuse():
    scene, motion = floating(), slide(0, 1, 1)
    with pytest.raises(InputError, match="one name"):
        certify_timed(scene, motion, [crossing(0, 1), crossing(2, 3)])
    with pytest.raises(InputError, match="clearance"):
        certify_timed(scene, motion, [crossing(0, 1)], clearance=-1.0)
    empty = JointTrajectory(("x",), np.zeros(0), np.zeros((0, 1)))
    with pytest.raises(InputError, match="empty"):
        certify_timed(scene, empty, [crossing(0, 1)])
    with pytest.raises(InputError, match="start_time"):
        plan_around_moving_obstacles(*across()[:1], request(across()[1]), [], start_time=np.nan)
