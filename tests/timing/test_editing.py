"""Editing of trajectories: slower, later, parts, several as one; nothing else about the motion changes."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from tests.timing.helpers import NAMES, PANDA_A, PANDA_V, random_waypoints, sampled

from armcell.core import InputError, JointState, JointTrajectory, UnknownNameError
from armcell.timing import (
    BlendedPath,
    check_scaling,
    concatenate_trajectories,
    delay_trajectory,
    merge_trajectories,
    parameterize,
    reverse_trajectory,
    slow_down,
    slow_down_to_duration,
    stationary_trajectory,
    synchronize_trajectories,
    trajectory_section,
    with_resting_joints,
    with_start_state,
)


def timed(seed: int) -> tuple[BlendedPath, JointTrajectory]:
    path = BlendedPath(random_waypoints(seed), 0.05)
    return path, parameterize(path, NAMES, PANDA_V, PANDA_A)


@pytest.mark.parametrize("value", [0.0, -0.5, 1.0001, np.nan, np.inf])
def test_scaling_must_be_in_0_1(value):
    with pytest.raises(InputError, match=r"speed is .*, it must be in \(0, 1\]"):
        check_scaling(value, "speed")
    assert check_scaling(1, "speed") == 1.0


def test_backwards_in_time():
    _, trajectory = timed(2)
    back = reverse_trajectory(trajectory)
    assert back.duration == pytest.approx(trajectory.duration) and back.times[0] == 0.0
    for t in np.linspace(0, trajectory.duration, 50)[1:-1]:
        p, v, a = trajectory.sample(t)
        q, w, b = back.sample(trajectory.duration - t)
        for mine, theirs in ((q, p), (w, -v), (b, a)):
            np.testing.assert_allclose(mine, theirs, atol=1e-6)


def test_stretching_slows_the_same_motion():
    _, trajectory = timed(2)
    slow = slow_down(trajectory, 2.5)
    assert slow.duration == pytest.approx(2.5 * trajectory.duration)
    for t in np.linspace(0, trajectory.duration, 50)[1:-1]:
        p, v, a = trajectory.sample(t)
        q, w, b = slow.sample(2.5 * t)
        for mine, theirs in ((q, p), (w, v / 2.5), (b, a / 2.5**2)):
            np.testing.assert_allclose(mine, theirs, atol=1e-9)
    for factor in (0.5, 0.0, -1.0, np.nan, np.inf):
        with pytest.raises(InputError, match="stretch factor"):
            slow_down(trajectory, factor)


@pytest.mark.slow
@pytest.mark.parametrize("factor", [1.0, 1.0 + 1e-12, 1.37, 3.0])
def test_to_a_duration(factor):
    _, trajectory = timed(3)
    wanted = trajectory.duration * factor
    slow = slow_down_to_duration(trajectory, wanted)
    assert slow.times[0] == 0.0 and slow.duration == wanted
    for t in np.linspace(0, trajectory.duration, 30)[1:-1]:
        for mine, theirs, power in zip(slow.sample(factor * t), trajectory.sample(t), range(3), strict=True):
            np.testing.assert_allclose(mine, theirs / factor**power, atol=1e-6)
    _, v, a = sampled(slow, 5e-3)
    assert np.max(np.abs(v) / PANDA_V) <= 1.0 + 1e-9 and np.max(np.abs(a) / PANDA_A) <= 1.0 + 1e-9


@pytest.mark.parametrize("factor", [0.0, 0.99, -1.0, np.nan, np.inf])
def test_never_faster(factor):
    _, trajectory = timed(3)
    with pytest.raises(InputError, match="the motion needs"):
        slow_down_to_duration(trajectory, trajectory.duration * factor)


def test_two_arms_end_together():
    left, right = timed(1)[1], timed(4)[1]
    assert left.duration != right.duration
    for one, other in ((left, right), (right, left)):
        a, b = synchronize_trajectories([one, other])
        assert a.duration == b.duration == max(left.duration, right.duration)
        np.testing.assert_array_equal(a.positions, one.positions)
        np.testing.assert_array_equal(b.positions, other.positions)
    assert synchronize_trajectories([]) == ()


def test_an_arm_that_stands_still_waits():
    _, moving = timed(1)
    q = np.full(7, 0.3)
    still = parameterize(BlendedPath([q]), NAMES, PANDA_V, PANDA_A)
    _, waiting = synchronize_trajectories([moving, still])
    assert waiting.duration == moving.duration
    p, v, a = waiting.sample(moving.duration / 3)
    np.testing.assert_array_equal(p, q)
    assert not v.any() and not a.any()


def test_without_velocities():
    bare = JointTrajectory(("a",), np.array([0.0, 1.0]), np.array([[0.0], [1.0]]))
    slow = slow_down_to_duration(bare, 3.0)
    assert slow.duration == 3.0 and slow.velocities is None and slow.sample(1.5)[0] == pytest.approx(0.5)


def assert_same_at(mine: JointTrajectory, theirs: JointTrajectory, later: float, begin: float, end: float):
    """`mine` at t + later equals `theirs` at t, for begin < t < end [s]."""
    for t in np.linspace(begin, end, 40)[1:-1]:
        for a, b in zip(mine.sample(t + later), theirs.sample(t), strict=True):
            np.testing.assert_allclose(a, b, atol=1e-6)


def test_a_delayed_motion_stands_first():
    _, trajectory = timed(5)
    later = delay_trajectory(trajectory, 0.7)
    assert later.times[0] == 0.0 and later.duration == trajectory.duration + 0.7
    q, v, a = later.sample(0.3)
    np.testing.assert_array_equal(q, trajectory.positions[0])
    assert not v.any() and not a.any()
    assert_same_at(later, trajectory, 0.7, 0.0, trajectory.duration)


def test_sections_concatenate_to_the_whole():
    _, trajectory = timed(6)
    cuts = [0.0, 0.31, trajectory.times[len(trajectory.times) // 2], trajectory.duration]
    parts = [trajectory_section(trajectory, a, b) for a, b in pairwise(cuts)]
    assert all(part.times[0] == a and part.times[-1] == b for part, (a, b) in zip(parts, pairwise(cuts)))
    whole = concatenate_trajectories(*parts)
    assert whole.duration == pytest.approx(trajectory.duration)
    assert_same_at(whole, trajectory, 0.0, 0.0, trajectory.duration)


def test_a_section_keeps_its_speed_at_both_ends():
    _, trajectory = timed(6)
    part = trajectory_section(trajectory, 0.2, 0.5)
    for row, t in ((0, 0.2), (-1, 0.5)):
        np.testing.assert_array_equal(part.velocities[row], trajectory.sample(t)[1])
    inner = trajectory_section(
        part, part.times[0], part.times[-1]
    )  # its ends move, `sample` there is at rest
    np.testing.assert_array_equal(inner.velocities, part.velocities)
    sparse = trajectory_section(trajectory, 0.0, trajectory.duration, apart=trajectory.times[2] + 1e-9)
    np.testing.assert_array_equal(sparse.times[1:3], trajectory.times[3:5])
    bare = JointTrajectory(("a",), np.array([0.0, 1.0]), np.array([[0.0], [1.0]]))
    with pytest.raises(InputError, match="needs velocities"):
        trajectory_section(bare, 0.2, 0.5)


def test_concatenation_keeps_what_all_parts_have():
    _, trajectory = timed(7)
    bare = JointTrajectory(NAMES, np.array([0.0, 1.0]), np.repeat(trajectory.positions[-1:], 2, axis=0))
    both = concatenate_trajectories(trajectory, bare)
    assert both.velocities is None and both.duration == trajectory.duration + 1.0
    with pytest.raises(InputError, match="same joints"):
        concatenate_trajectories(trajectory, stationary_trajectory(("other",), [0.0]))
    with pytest.raises(InputError):
        concatenate_trajectories()


def test_merged_motions_move_like_each_alone():
    one, other = timed(1)[1], timed(4)[1]
    renamed = JointTrajectory(
        tuple(f"b_{n}" for n in NAMES), other.times, other.positions, other.velocities, other.accelerations
    )
    both = merge_trajectories(one, renamed)
    assert both.joint_names == one.joint_names + renamed.joint_names
    assert both.duration == max(one.duration, other.duration)
    for t in one.times[1:-1]:
        np.testing.assert_allclose(both.sample(t)[0][:7], one.sample(t)[0], atol=1e-9)
    late = both.sample(both.duration)[0]
    np.testing.assert_array_equal(late[:7], one.positions[-1])
    np.testing.assert_array_equal(late[7:], other.positions[-1])


def test_joints_that_do_not_move_rest():
    motion = JointTrajectory(("b",), np.array([0.0, 1.0]), np.array([[0.0], [1.0]]), np.ones((2, 1)))
    state = JointState(("a", "b", "c"), np.array([0.5, 9.0, -0.5]))
    wide = with_resting_joints(motion, state, ("c", "b", "a"))
    assert wide.joint_names == ("c", "b", "a") and wide.accelerations is None
    np.testing.assert_array_equal(wide.positions, [[-0.5, 0.0, 0.5], [-0.5, 1.0, 0.5]])
    np.testing.assert_array_equal(wide.velocities, [[0, 1, 0], [0, 1, 0]])
    assert with_resting_joints(motion, state, ("b",)) is motion
    with pytest.raises(UnknownNameError, match="d"):
        with_resting_joints(motion, state, ("b", "d"))


def test_a_motion_that_starts_from_a_state():
    motion = JointTrajectory(("a",), np.array([0.5, 1.0]), np.array([[0.0], [1.0]]), np.zeros((2, 1)))
    state = JointState(("z", "a"), np.array([3.0, -1.0]), np.array([7.0, 0.25]))
    begun = with_start_state(state, motion)
    np.testing.assert_array_equal(begun.times, [0.0, 0.5, 1.0])
    np.testing.assert_array_equal(begun.positions[:, 0], [-1.0, 0.0, 1.0])
    np.testing.assert_array_equal(begun.velocities[:, 0], [0.25, 0.0, 0.0])
    assert begun.accelerations is None
    with pytest.raises(UnknownNameError):
        with_start_state(JointState(("z",), np.zeros(1)), motion)
