"""Time parameterisation: as fast as toppra, within every limit, on the path, at rest at the ends."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest
from scipy.spatial import cKDTree
from tests.timing.helpers import (
    NAMES,
    PANDA_A,
    PANDA_V,
    distance_to_polyline,
    random_waypoints,
    sampled,
    toppra_duration,
)

from armcell.core import InputError
from armcell.timing import (
    BlendedPath,
    TimingSettings,
    check_scaling,
    parameterize,
    reversed_in_time,
    stretched,
)
from armcell.timing.parameterize import ACCELERATION_SHARE

SEEDS = range(20)
SETTINGS = TimingSettings()
# The moving average that rounds the accelerations makes every motion its window longer.
WINDOW = SETTINGS.smoothing
# ... and leaves the path by at most this in every joint.
SMOOTHING = PANDA_A * WINDOW**2 / 24


CASES = [(seed, 0.05) for seed in SEEDS] + [(seed, d) for seed in SEEDS[:5] for d in (0.0, 0.01, 0.3)]


@lru_cache
def timed(seed: int, deviation: float = 0.05, settings: TimingSettings = SETTINGS):
    path = BlendedPath(random_waypoints(seed), deviation)
    return path, parameterize(path, NAMES, PANDA_V, PANDA_A, settings)


@lru_cache
def milliseconds(seed: int, deviation: float = 0.05):
    """Positions, velocities, accelerations every millisecond."""
    return sampled(timed(seed, deviation)[1])


@pytest.mark.parametrize("seed", SEEDS)
def test_as_fast_as_toppra(seed):
    path, trajectory = timed(seed)
    best = toppra_duration(path, PANDA_V, ACCELERATION_SHARE * PANDA_A)
    assert trajectory.duration - WINDOW == pytest.approx(
        best, rel=0.015, abs=0.02
    )  # its points are 10 ms apart
    assert toppra_duration(path, PANDA_V, PANDA_A) <= trajectory.duration


@pytest.mark.parametrize(("seed", "deviation"), CASES)
def test_limits_hold_at_every_millisecond(seed, deviation):
    _, v, a = milliseconds(seed, deviation)
    assert np.max(np.abs(v) / PANDA_V) <= 1.001
    assert np.max(np.abs(a) / PANDA_A) <= 1.001


@pytest.mark.parametrize(("seed", "deviation"), CASES)
def test_the_path_is_kept_from_rest_to_rest(seed, deviation):
    corners = random_waypoints(seed)
    path, trajectory = timed(seed, deviation)
    assert trajectory.joint_names == NAMES and trajectory.times[0] == 0.0
    np.testing.assert_array_equal(trajectory.positions[[0, -1]], corners[[0, -1]])
    for values in (trajectory.velocities, trajectory.accelerations):
        assert not values[0].any() and not values[-1].any()
    p = milliseconds(seed, deviation)[0]
    assert distance_to_polyline(p, corners).max() <= deviation + np.linalg.norm(SMOOTHING) + 1e-4
    on_path = cKDTree(path.at(np.linspace(0, path.length, 50_000))[0])
    assert on_path.query(p)[0].max() <= np.linalg.norm(SMOOTHING) + path.length / 50_000


@pytest.mark.parametrize("seed", SEEDS[:5])
def test_sharp_corners_are_reached_at_rest(seed):
    corners = random_waypoints(seed)
    p, v, _ = milliseconds(seed, 0.0)
    for corner in corners[1:-1]:
        k = int(np.argmin(np.linalg.norm(p - corner, axis=1)))
        # Within the averaging window of the stop the motion is slow and near.
        assert np.all(np.abs(p[k] - corner) <= SMOOTHING + 1e-4)
        assert np.all(np.abs(v[k]) <= PANDA_A * WINDOW)


def test_the_jerk_is_bounded():
    for seed in SEEDS[:5]:
        _, trajectory = timed(seed)
        jerk = np.diff(trajectory.accelerations, axis=0) / np.diff(trajectory.times)[:, None]
        assert np.all(np.abs(jerk) <= 2 * PANDA_A / WINDOW * 1.01)


def test_scaled_limits_take_longer():
    path = BlendedPath(random_waypoints(1), 0.05)
    base = parameterize(path, NAMES, PANDA_V, PANDA_A)
    slow = parameterize(path, NAMES, PANDA_V / 4, PANDA_A / 16)  # the whole motion four times as slow
    assert slow.duration - WINDOW == pytest.approx(4 * (base.duration - WINDOW), rel=0.01)
    assert np.max(np.abs(sampled(slow)[1]) / PANDA_V) <= 0.25 * 1.001


@pytest.mark.parametrize("waypoints", [[[0.1] * 7], [[0.1] * 7] * 3])
def test_a_path_that_goes_nowhere_is_one_point(waypoints):
    trajectory = parameterize(BlendedPath(waypoints), NAMES, PANDA_V, PANDA_A)
    assert trajectory.duration == 0.0 and len(trajectory.times) == 1
    np.testing.assert_array_equal(trajectory.positions[0], waypoints[0])


@pytest.mark.parametrize("size", [2e-6, 1e-4, 1e-2])
def test_a_very_short_path(size):
    corners = np.array([np.zeros(7), size * np.r_[1.0, -1.0, np.zeros(5)]])
    trajectory = parameterize(BlendedPath(corners), NAMES, PANDA_V, PANDA_A)
    np.testing.assert_array_equal(trajectory.positions[[0, -1]], corners)
    _, v, a = sampled(trajectory)
    assert np.max(np.abs(v) / PANDA_V) <= 1.001 and np.max(np.abs(a) / PANDA_A) <= 1.001


def test_repeated_waypoints_change_nothing():
    corners = random_waypoints(4)
    a = parameterize(BlendedPath(corners), NAMES, PANDA_V, PANDA_A)
    b = parameterize(BlendedPath(np.repeat(corners, 2, axis=0)), NAMES, PANDA_V, PANDA_A)
    np.testing.assert_allclose(a.positions, b.positions, atol=1e-9)


@pytest.mark.parametrize("bad", [0.0, -1.0, np.inf, np.nan])
def test_a_missing_limit_names_the_joint(bad):
    path = BlendedPath(random_waypoints(0))
    limits = {"velocity": PANDA_V.copy(), "acceleration": PANDA_A.copy()}
    for kind in limits:
        broken = {**limits, kind: np.where(np.arange(7) == 4, bad, limits[kind])}
        with pytest.raises(InputError, match=f"joint 'j4' has no {kind} limit"):
            parameterize(path, NAMES, broken["velocity"], broken["acceleration"])


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


def test_the_settings_are_followed():
    _, fine = timed(1, settings=TimingSettings(sample_time=0.002))
    _, coarse = timed(1, settings=TimingSettings(sample_time=0.02))
    assert np.allclose(np.diff(fine.times)[:-1], 0.002) and np.allclose(np.diff(coarse.times)[:-1], 0.02)
    assert fine.duration == pytest.approx(coarse.duration, abs=0.03)
    _, soft = timed(1, settings=TimingSettings(smoothing=0.2))
    _, hard = timed(1, settings=TimingSettings(smoothing=0.02))
    assert soft.duration - hard.duration == pytest.approx(0.18, abs=0.03)
