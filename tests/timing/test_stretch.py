"""Time scaling: the same motion, slower, to the last bit as long as asked."""

from __future__ import annotations

import numpy as np
import pytest
from tests.timing.helpers import NAMES, PANDA_A, PANDA_V, random_waypoints, sampled

from armcell.core import InputError, JointTrajectory
from armcell.timing import (
    BlendedPath,
    check_scaling,
    parameterize,
    reversed_in_time,
    stretched,
    stretched_to,
    synchronized,
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
    back = reversed_in_time(trajectory)
    assert back.duration == pytest.approx(trajectory.duration) and back.times[0] == 0.0
    for t in np.linspace(0, trajectory.duration, 50)[1:-1]:
        p, v, a = trajectory.sample(t)
        q, w, b = back.sample(trajectory.duration - t)
        for mine, theirs in ((q, p), (w, -v), (b, a)):
            np.testing.assert_allclose(mine, theirs, atol=1e-6)


def test_stretching_slows_the_same_motion():
    _, trajectory = timed(2)
    slow = stretched(trajectory, 2.5)
    assert slow.duration == pytest.approx(2.5 * trajectory.duration)
    for t in np.linspace(0, trajectory.duration, 50)[1:-1]:
        p, v, a = trajectory.sample(t)
        q, w, b = slow.sample(2.5 * t)
        for mine, theirs in ((q, p), (w, v / 2.5), (b, a / 2.5**2)):
            np.testing.assert_allclose(mine, theirs, atol=1e-9)
    for factor in (0.5, 0.0, -1.0, np.nan, np.inf):
        with pytest.raises(InputError, match="stretch factor"):
            stretched(trajectory, factor)


@pytest.mark.parametrize("factor", [1.0, 1.0 + 1e-12, 1.37, 3.0])
def test_to_a_duration(factor):
    _, trajectory = timed(3)
    wanted = trajectory.duration * factor
    slow = stretched_to(trajectory, wanted)
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
        stretched_to(trajectory, trajectory.duration * factor)


def test_two_arms_end_together():
    left, right = timed(1)[1], timed(4)[1]
    assert left.duration != right.duration
    for one, other in ((left, right), (right, left)):
        a, b = synchronized([one, other])
        assert a.duration == b.duration == max(left.duration, right.duration)
        np.testing.assert_array_equal(a.positions, one.positions)
        np.testing.assert_array_equal(b.positions, other.positions)
    assert synchronized([]) == ()


def test_an_arm_that_stands_still_waits():
    _, moving = timed(1)
    q = np.full(7, 0.3)
    still = parameterize(BlendedPath([q]), NAMES, PANDA_V, PANDA_A)
    _, waiting = synchronized([moving, still])
    assert waiting.duration == moving.duration
    p, v, a = waiting.sample(moving.duration / 3)
    np.testing.assert_array_equal(p, q)
    assert not v.any() and not a.any()


def test_without_velocities():
    bare = JointTrajectory(("a",), np.array([0.0, 1.0]), np.array([[0.0], [1.0]]))
    slow = stretched_to(bare, 3.0)
    assert slow.duration == 3.0 and slow.velocities is None and slow.sample(1.5)[0] == pytest.approx(0.5)
