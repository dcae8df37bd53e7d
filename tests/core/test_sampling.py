"""JointTrajectory.sample: continuity, derivatives and ends, against SciPy's piecewise polynomials."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import BPoly, CubicHermiteSpline

from armcell.core import InputError, JointTrajectory, Playback

NAMES = ("a", "b", "c")
KINDS = ("linear", "cubic", "quintic")


def trajectory(kind: str, points: int = 8, seed: int = 0) -> JointTrajectory:
    rng = np.random.default_rng(seed)
    p, v, a = rng.uniform(-2, 2, (3, points, len(NAMES)))
    times = np.concatenate([[0.0], np.cumsum(rng.uniform(0.1, 0.9, points - 1))])
    return JointTrajectory(NAMES, times, p, None if kind == "linear" else v, a if kind == "quintic" else None)


def reference(t: JointTrajectory, order: int):
    """The same curve from SciPy, as a function of time."""
    if t.velocities is None:
        rows = t.positions[:, None, :]
    elif t.accelerations is None:
        return CubicHermiteSpline(t.times, t.positions, t.velocities).derivative(order)
    else:
        rows = np.stack([t.positions, t.velocities, t.accelerations], axis=1)
    curve = BPoly.from_derivatives(t.times, list(rows))
    return curve.derivative(order) if order else curve


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", range(3))
def test_agrees_with_scipy(kind, seed):
    t = trajectory(kind, seed=seed)
    at = np.random.default_rng(seed).uniform(0.0, t.duration, 200)
    samples = [t.sample(s) for s in at]
    for order in range(2 if kind == "linear" else 3):
        mine = np.array([s[order] for s in samples])
        np.testing.assert_allclose(mine, reference(t, order)(at), atol=1e-8)
    if kind == "linear":
        assert all(not s[2].any() for s in samples)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", range(3))
def test_playback_agrees_with_scipy_and_holds_both_ends(kind, seed):
    t = trajectory(kind, seed=seed)
    playback = Playback(t)
    at = np.random.default_rng(seed).uniform(0.0, t.duration, 200)
    for order in range(2):
        mine = np.array([playback.at(float(s))[order] for s in at])
        np.testing.assert_allclose(mine, reference(t, order)(at), atol=1e-8)
    for time, end in ((-1.0, 0), (0.0, 0), (t.duration, -1), (t.duration + 1.0, -1)):
        q, v = playback.at(time)
        np.testing.assert_array_equal(q, t.positions[end])
        assert not v.any()


@pytest.mark.parametrize("kind", KINDS)
def test_many_moments_are_played_as_each_alone_bit_for_bit(kind):
    t = trajectory(kind)
    playback, times = Playback(t), np.linspace(-0.1, t.duration + 0.1, 500)
    q, v = playback.at_times(times)
    for i, time in enumerate(times):
        for many, one, alone in zip((q, v), playback.at_times([time]), playback.at(time), strict=True):
            assert many[i].tobytes() == one[0].tobytes()
            np.testing.assert_allclose(many[i], alone, atol=1e-12)


def test_playback_of_one_point_and_of_none():
    single = Playback(JointTrajectory(NAMES, np.zeros(1), np.ones((1, 3))))
    for q, v in (single.at(0.5), single.at_times([-1.0, 0.0, 0.5])):
        assert (q == 1.0).all() and not v.any()
    with pytest.raises(InputError, match="empty"):
        Playback(JointTrajectory(NAMES, np.zeros(0), np.zeros((0, 3))))


@pytest.mark.parametrize("kind", KINDS)
def test_passes_through_its_points_without_steps(kind):
    t = trajectory(kind)
    given = [x for x in (t.positions, t.velocities, t.accelerations) if x is not None]
    for i, time in enumerate(t.times[1:-1], start=1):
        before, after = t.sample(time - 1e-9), t.sample(time + 1e-9)
        for order, values in enumerate(given):
            np.testing.assert_allclose(before[order], values[i], atol=1e-5)
            np.testing.assert_allclose(after[order], values[i], atol=1e-5)


@pytest.mark.parametrize("kind", KINDS)
def test_velocity_and_acceleration_are_the_derivatives(kind):
    t, h = trajectory(kind), 1e-6
    for time in np.random.default_rng(1).uniform(t.times[0], t.times[-1], 50):
        if np.min(np.abs(t.times - time)) < 2 * h:
            continue
        before, at, after = t.sample(time - h), t.sample(time), t.sample(time + h)
        np.testing.assert_allclose((after[0] - before[0]) / (2 * h), at[1], atol=1e-5)
        np.testing.assert_allclose((after[1] - before[1]) / (2 * h), at[2], atol=1e-5)


@pytest.mark.parametrize("kind", KINDS)
def test_ends_are_held_at_rest(kind):
    t = trajectory(kind)
    for time, at in ((-5.0, 0), (0.0, 0), (t.duration, -1), (t.duration + 5.0, -1)):
        p, v, a = t.sample(time)
        np.testing.assert_array_equal(p, t.positions[at])
        assert not v.any() and not a.any()
        p[:] = 99.0  # the caller owns what it got
        np.testing.assert_array_equal(t.sample(time)[0], t.positions[at])


@pytest.mark.parametrize("kind", KINDS)
def test_many_samples_are_those_one_by_one_to_the_last_bit(kind):
    t = trajectory(kind, points=30)
    times = np.sort(np.concatenate([t.times, np.random.default_rng(1).uniform(-0.5, t.duration + 0.5, 300)]))
    one_by_one = [np.array(rows) for rows in zip(*(t.sample(float(at)) for at in times), strict=True)]
    for many, single in zip(t.samples(times), one_by_one, strict=True):
        np.testing.assert_array_equal(many, single)


def test_one_point_is_a_trajectory():
    t = JointTrajectory(NAMES, [0.0], [[1.0, 2.0, 3.0]])
    assert t.duration == 0.0
    np.testing.assert_array_equal(t.sample(0.5)[0], [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(t.samples([0.5])[0], [[1.0, 2.0, 3.0]])


def test_a_trajectory_without_points_is_refused():
    with pytest.raises(InputError):
        JointTrajectory(NAMES, [], np.zeros((0, 3))).sample(0.0)
    with pytest.raises(InputError):
        JointTrajectory(NAMES, [], np.zeros((0, 3))).samples([0.0])
