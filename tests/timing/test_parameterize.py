"""Time parameterisation: as fast as toppra, within every limit, on the path, at rest at the ends."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest
from scipy.interpolate import BPoly
from scipy.spatial import cKDTree
from tests.sizes import seeds, sizes
from tests.timing.helpers import (
    NAMES,
    PANDA_A,
    PANDA_V,
    distance_to_polyline,
    random_walk,
    random_waypoints,
    sampled,
    toppra_duration,
)

from armcell.core import InputError
from armcell.timing import BlendedPath, TimingSettings, parameterize
from armcell.timing.parameterize import ACCELERATION_SHARE

SEEDS = range(20)
SETTINGS = TimingSettings()
# The moving average that rounds the accelerations makes every motion its window longer.
WINDOW = SETTINGS.smoothing
# ... and leaves the path by at most this in every joint.
SMOOTHING = PANDA_A * WINDOW**2 / 24


CASES = [(seed, d) for seed in SEEDS[:5] for d in (0.05, 0.0, 0.01, 0.3)]
CASES = seeds(8, [*CASES, *((seed, 0.05) for seed in SEEDS[5:])])


@lru_cache
def timed(seed: int, deviation: float = 0.05, settings: TimingSettings = SETTINGS):
    path = BlendedPath(random_waypoints(seed), deviation)
    return path, parameterize(path, NAMES, PANDA_V, PANDA_A, settings)


@lru_cache
def milliseconds(seed: int, deviation: float = 0.05):
    """Positions, velocities, accelerations every millisecond."""
    return sampled(timed(seed, deviation)[1])


@pytest.mark.cases("0", "1")
@pytest.mark.parametrize("seed", seeds(5, SEEDS))
def test_as_fast_as_toppra(seed):
    path, trajectory = timed(seed)
    best = toppra_duration(path, PANDA_V, PANDA_A, 1500)
    assert 0.995 * best <= trajectory.duration - WINDOW <= 1.012 * best
    assert best <= trajectory.duration


@pytest.mark.slow
@pytest.mark.parametrize("step", [0.05, 0.15, 0.5])
def test_within_one_percent_of_toppra_on_500_points(step):
    for seed in range(6):
        path = BlendedPath(random_walk(seed, step=step), 0.05)
        trajectory = parameterize(path, NAMES, PANDA_V, PANDA_A)
        assert trajectory.duration - WINDOW <= 1.01 * toppra_duration(path, PANDA_V, PANDA_A, 500)


def test_a_straight_line_is_timed_as_by_hand():
    """Speed up at the limit, cruise at the limit, slow down: the trapezoid."""
    for distance in (0.02, 3.0):
        line = np.outer([0.0, 1.0], [distance, distance / 2])
        v, a = np.array([1.0, 1.0]), np.array([2.0, 2.0])
        trajectory = parameterize(BlendedPath(line), ("a", "b"), v, a)
        share = a[0] * ACCELERATION_SHARE
        by_hand = 2 * np.sqrt(distance / share) if distance < 1 / share else distance + 1 / share
        assert trajectory.duration == pytest.approx(by_hand + WINDOW, rel=0.005)


@pytest.mark.slow
@pytest.mark.cases("0-0.0", "1-0.05", "1-0.3")
@pytest.mark.parametrize(("seed", "deviation"), CASES)
def test_limits_hold_at_every_millisecond(seed, deviation):
    _, v, a = milliseconds(seed, deviation)
    assert np.max(np.abs(v) / PANDA_V) <= 1.0 + 1e-9
    assert np.max(np.abs(a) / PANDA_A) <= 1.0 + 1e-9


@pytest.mark.slow
@pytest.mark.cases("0.*-few", "1.0-*-1.0-few", "1.0-*-0.3-few")
@pytest.mark.parametrize("walks", sizes(1, 4))
@pytest.mark.parametrize("scale", [1.0, 0.3, 0.02])
@pytest.mark.parametrize(("step", "deviation"), [(0.02, 0.002), (0.15, 0.3), (1.0, 0.05), (1.0, 1.0)])
def test_limits_hold_on_walks_of_every_kind(scale, step, deviation, walks):
    """The interpolation taken from scipy, looked at up to ten times between points."""
    for seed in range(walks):
        path = BlendedPath(random_walk(seed, 20 if scale == 1.0 else 5, step), deviation)
        t = parameterize(path, NAMES, scale * PANDA_V, scale * PANDA_A)
        curve = BPoly.from_derivatives(t.times, np.stack([t.positions, t.velocities, t.accelerations], 1))
        at = np.linspace(0.0, t.duration, min(10 * len(t.times), 20_000))
        assert np.max(np.abs(curve(at, 1)) / (scale * PANDA_V)) <= 1.0 + 1e-9
        assert np.max(np.abs(curve(at, 2)) / (scale * PANDA_A)) <= 1.0 + 1e-9


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


@pytest.mark.slow
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


@pytest.mark.slow
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


@pytest.mark.parametrize("bad", [{"smoothing": 0.0}, {"sample_time": np.nan}, {"torque_grid": -1.0}])
def test_settings_must_be_positive(bad):
    with pytest.raises(InputError, match=f"{next(iter(bad))} is .*, it must be positive"):
        TimingSettings(**bad)


def test_the_number_of_limits_must_fit():
    with pytest.raises(InputError, match=r"\(3,\) velocity limits given for 7 joints"):
        parameterize(BlendedPath(random_waypoints(0)), NAMES, PANDA_V[:3], PANDA_A)


def test_there_and_back():
    """A reversal is a stop; its way back takes as long as its way there."""
    a = np.zeros(7)
    b = random_waypoints(3)[0]
    one = parameterize(BlendedPath([a, b]), NAMES, PANDA_V, PANDA_A)
    two = parameterize(BlendedPath([a, b, a]), NAMES, PANDA_V, PANDA_A)
    assert two.duration - WINDOW == pytest.approx(2 * (one.duration - WINDOW), rel=0.005)
    _, v, acc = sampled(two)
    assert np.max(np.abs(v) / PANDA_V) <= 1.0 + 1e-9 and np.max(np.abs(acc) / PANDA_A) <= 1.0 + 1e-9


def test_two_thousand_waypoints(within):
    path = BlendedPath(random_walk(0, 2000, 0.05), 0.05)
    parameterize(path, NAMES, PANDA_V, PANDA_A)
    with within(1.0):
        trajectory = parameterize(path, NAMES, PANDA_V, PANDA_A)
    assert trajectory.duration > 150.0 and np.all(np.isfinite(trajectory.positions))
    assert np.max(np.abs(trajectory.velocities) / PANDA_V) <= 1.0
    assert np.max(np.abs(trajectory.accelerations) / PANDA_A) <= 1.0


def test_very_short_edges_between_long_ones():
    rng, corners = np.random.default_rng(0), random_waypoints(6)
    near = np.concatenate([c + rng.normal(0.0, 1e-5, (3, 7)) for c in corners])
    trajectory = parameterize(BlendedPath(near), NAMES, PANDA_V, PANDA_A)
    _, v, a = sampled(trajectory)
    assert np.max(np.abs(v) / PANDA_V) <= 1.0 + 1e-9 and np.max(np.abs(a) / PANDA_A) <= 1.0 + 1e-9
    np.testing.assert_array_equal(trajectory.positions[[0, -1]], near[[0, -1]])


def test_the_settings_are_followed():
    _, fine = timed(1, settings=TimingSettings(sample_time=0.002))
    _, coarse = timed(1, settings=TimingSettings(sample_time=0.02))
    for trajectory, step in ((fine, 0.002), (coarse, 0.02)):  # a little more where limits slow the motion
        gaps = np.diff(trajectory.times)
        assert step - 1e-12 <= gaps[:-1].min() and gaps[:-1].max() <= 1.02 * step
        assert 0.5 * step <= gaps[-1] <= 1.53 * step
    assert fine.duration == pytest.approx(coarse.duration, abs=0.03)
    _, soft = timed(1, settings=TimingSettings(smoothing=0.2))
    _, hard = timed(1, settings=TimingSettings(smoothing=0.02))
    assert soft.duration - hard.duration == pytest.approx(0.18, abs=0.03)
