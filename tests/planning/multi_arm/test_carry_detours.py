"""A rod in two hands round obstacles: judged by coal every millisecond, limits, seeds, refusals."""

from __future__ import annotations

import threading
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from benchmarks.carry import KINDS, RESTS, ROD, TABLE, Carry, draw, held, look_at
from scipy.interpolate import BSpline

from armcell.collision import ExactChecker
from armcell.collision.resting_contact import resting_pairs
from armcell.core import SE3, Box, ErrorCode, InputError
from armcell.planning.multi_arm.object_paths import RoundedObjectPath, StraightObjectPath
from armcell.scene import CollisionObject

slow = pytest.mark.slow  # two arms: searches, and coal by the millisecond


def first_of(kind: str) -> Carry:
    """The first random scene of a kind in which the straight way is blocked."""
    return next(p for seed in range(100) if (p := draw(np.random.default_rng(seed), kind)) is not None)


def box(name: str, sizes: tuple, at: tuple) -> CollisionObject:
    return CollisionObject.single(name, Box(*sizes), SE3.from_xyz(*at))


WALL = [box("wall", (0.7, 0.02, 0.2), (0.0, 0.0, TABLE + 0.101))]
GATE = [  # around the middle of the rod: it is caught
    box("near_post", (0.04, 0.02, 0.12), (0.0, 0.08, TABLE + 0.061)),
    box("far_post", (0.04, 0.02, 0.12), (0.0, 0.24, TABLE + 0.061)),
    box("lintel", (0.04, 0.18, 0.02), (0.0, 0.16, TABLE + 0.132)),
]


def beyond(obstacles: list[CollisionObject], goal: SE3 | None = None) -> Carry:
    """The rod on its rests, and to be taken to the other side of the table."""
    start = SE3.from_xyz(0.0, 0.16, ROD[2])
    taken = held(start, obstacles)
    assert taken is not None
    goal = goal or SE3.from_xyz(0.0, -0.12, ROD[2])
    scene, carried, supports = taken
    assert supports == RESTS
    return Carry("", scene, carried, start, goal, supports)


@pytest.mark.cases("block")
@slow
@pytest.mark.parametrize("kind", KINDS)
def test_the_way_round_is_free_as_it_is_executed(kind):
    problem = first_of(kind)
    straight = problem.plan(planning_time=0.0)
    assert straight.code is ErrorCode.PLANNING_FAILED and "blocked at" in straight.message
    result = problem.plan(seed=1)
    assert result.ok and result.evidence["ways"] == ("round",), result.message
    trajectory = result.trajectory
    seen = look_at(problem, trajectory, step=1e-3 if kind in ("wall", "bar") else 4e-3)
    assert seen.contacts == 0
    assert seen.off_m < 5e-5 and seen.turn_rad < 5e-5  # wanted: 0.5 mm and 0.1 degree
    assert seen.share <= 1.03
    ends = [trajectory.sample(t) for t in (0.0, trajectory.duration)]
    assert all(not v.any() and not a.any() for _, v, a in ends)
    np.testing.assert_array_equal(ends[0][0], problem.scene.state.reindexed(trajectory.joint_names).positions)
    at = problem.scene.with_state(trajectory.end)
    assert at.frame_pose("rod").isclose(problem.goal, 1e-6, 1e-6)


@slow
def test_the_same_seed_gives_the_same_way():
    problem = beyond(WALL)
    first, again = (problem.plan(seed=3).trajectory for _ in range(2))
    np.testing.assert_array_equal(first.positions, again.positions)


@slow
def test_a_straight_way_that_is_free_is_taken():
    problem = beyond(WALL, SE3.from_xyz(0.02, 0.2, ROD[2] + 0.1))
    result = problem.plan()
    assert result.evidence == {"ways": ("straight",), "poses_looked_at": 0}
    alone = problem.plan(planning_time=0.0).trajectory
    np.testing.assert_array_equal(result.trajectory.positions, alone.positions)


@slow
def test_without_a_way_round_it_says_what_is_in_the_way_and_what_would_help():
    result = beyond(GATE).plan(planning_time=1.0)
    assert result.code is ErrorCode.TIMED_OUT
    assert "near_post" in result.message and "blocked at" in result.message
    assert "no detour was found in" in result.message and "planning_time" in result.message
    (contact,) = result.evidence["contacts"]
    assert {contact.body_a, contact.body_b} == {"rod", "near_post"}
    assert 1.0 <= result.planning_time < 20.0


@slow
def test_a_goal_that_cannot_be_is_told_at_once():
    inside = beyond(WALL, SE3.from_xyz(0.0, 0.0, ROD[2])).plan()
    assert not inside.ok and "the pose itself is not free" in inside.message and "wall" in inside.message
    far = beyond(WALL, SE3.from_xyz(0.0, -2.0, ROD[2])).plan()
    assert not far.ok and "does not reach the pose itself" in far.message


@slow
def test_it_stops_when_it_is_cancelled():
    cancel = threading.Event()
    threading.Timer(0.5, cancel.set).start()
    result = beyond(GATE).plan(planning_time=60.0, cancel=cancel)
    assert result.code is ErrorCode.PREEMPTED and result.planning_time < 30.0


@slow
def test_a_time_that_is_none_is_refused():
    with pytest.raises(InputError, match="planning_time is -1"):
        beyond(WALL).plan(planning_time=-1.0)


# --- ways ---
def random_poses(rng: np.random.Generator, count: int) -> list[SE3]:
    return [SE3.from_xyz_rpy(rng.uniform(-0.3, 0.3, 3), rng.uniform(-0.5, 0.5, 3)) for _ in range(count)]


def test_rounded_ways_are_b_splines_in_space():
    way = RoundedObjectPath(random_poses(np.random.default_rng(0), 5), 0.1, 0.5)
    reference = BSpline(np.arange(-3, way.count + 4), way.x, 3)
    shares = np.linspace(0, 1, 333)
    found = np.array([T.translation for T in way.poses(shares)])
    np.testing.assert_allclose(found, reference(shares * way.count), atol=1e-12)


@pytest.mark.slow
def test_rounded_ways_begin_and_end_where_they_should_and_turn_smoothly():
    through = random_poses(np.random.default_rng(1), 4)
    way = RoundedObjectPath(through, 0.1, 0.5)
    shares = np.linspace(0, 1, 4001)
    poses = way.poses(shares)
    assert poses[0].isclose(through[0]) and poses[-1].isclose(through[-1])
    h = shares[1]
    spin = np.array([(a.rotation.inverse() @ b.rotation).log() / h for a, b in pairwise(poses)])
    change = np.diff(spin, axis=0) / h
    assert (
        np.abs(np.diff(change, axis=0)).max() < 0.02 * np.abs(change).max()
    )  # the acceleration has no steps
    speed = np.linalg.norm(np.diff([T.translation for T in poses], axis=0), axis=1) / h
    assert speed.max() <= way.rate * (1 + 1e-9)


def test_a_rounded_way_through_two_poses_is_the_straight_one():
    a, b = random_poses(np.random.default_rng(2), 2)
    rounded, straight = RoundedObjectPath([a, b], 0.05, 0.5), StraightObjectPath(a, b)
    shares = np.linspace(0, 1, 50)
    for one, other in zip(rounded.poses(shares), straight.poses(shares), strict=True):
        assert one.isclose(other, 1e-12, 1e-9)


@slow
def test_what_two_hands_hold_is_lifted_off_what_it_rests_on():
    """Contact with the rests is not allowed: the start is in resting contact, and the way leads out of it."""
    problem = beyond([], SE3.from_xyz(0.0, 0.16, ROD[2] + 0.1))
    scene = problem.scene.with_allowed("rod", RESTS, allow=False)
    names = scene.model.group("both_arms").joint_names
    rests = resting_pairs(ExactChecker(scene, names), scene.state.reindexed(names).positions)
    assert {name for pair in rests for name in pair} >= {"rod", *RESTS}
    lifted = replace(problem, scene=scene, rests_on=())
    assert lifted.plan(planning_time=0.0).ok
    sideways = replace(lifted, goal=SE3.from_xyz(0.0, 0.06, ROD[2]))
    result = sideways.plan(planning_time=0.0)
    assert not result.ok and "rod" in result.message
