"""Jerk-limited timing: on the path, within every limit by finite differences, as fast as ruckig on lines."""

from __future__ import annotations

import numpy as np
import pytest
import ruckig
from scipy.spatial import cKDTree
from tests.sizes import seeds
from tests.timing.helpers import NAMES, PANDA_A, PANDA_V, random_walk, random_waypoints, toppra_duration

from armcell.core import InputError
from armcell.timing import BlendedPath, jerk_limited

SMOOTH = [(seed, d) for seed in range(3) for d in (0.05, 0.0, 0.005, 0.5)]
SMOOTH = seeds(4, [*SMOOTH, (3, 0.05)])
STEP = 5e-4  # [s] of the finite differences


def dense(trajectory, step: float = STEP) -> np.ndarray:
    times = np.arange(0.0, trajectory.duration + step, step)
    return np.array([trajectory.sample(t)[0] for t in times])


@pytest.mark.slow
@pytest.mark.cases("0-0.005-*", "0-0.5-20.0")
@pytest.mark.parametrize("ratio", [500.0, 20.0, 3.0])
@pytest.mark.parametrize(("seed", "deviation"), SMOOTH)
def test_limits_hold_by_finite_differences_of_the_positions(seed, deviation, ratio):
    path = BlendedPath(random_walk(seed, 4, 0.3), deviation, smooth=True)
    jerk = ratio * PANDA_A
    trajectory = jerk_limited(path, NAMES, PANDA_V, PANDA_A, jerk)
    q = dense(trajectory)
    for order, limit, digits in ((1, PANDA_V, 1e-9), (2, PANDA_A, 1e-6), (3, jerk, 1e-3)):
        difference = np.diff(q, order, axis=0) / STEP**order  # a mean of the derivative: within its limit
        assert np.max(np.abs(difference) / limit) <= 1.0 + digits


@pytest.mark.parametrize(("seed", "deviation"), SMOOTH)
def test_the_path_is_kept_exactly_from_rest_to_rest(seed, deviation):
    corners = random_walk(seed, 6, 0.3)
    path = BlendedPath(corners, deviation, smooth=True)
    trajectory = jerk_limited(path, NAMES, PANDA_V, PANDA_A, 20 * PANDA_A)
    np.testing.assert_array_equal(trajectory.positions[[0, -1]], corners[[0, -1]])
    for values in (trajectory.velocities, trajectory.accelerations):
        assert not values[0].any() and not values[-1].any()
    count = 50_000
    on_path = cKDTree(path.at(np.linspace(0, path.length, count))[0])
    assert on_path.query(dense(trajectory, 5e-3))[0].max() <= path.length / count


def test_straight_lines_are_as_fast_as_ruckig():
    rng = np.random.default_rng(0)
    for _ in range(100):
        way = rng.uniform(-1.5, 1.5, 7) * 10 ** rng.uniform(-3, 0.5)
        jerk = PANDA_A * 10 ** rng.uniform(0.5, 3)
        ours = jerk_limited(BlendedPath([np.zeros(7), way], smooth=True), NAMES, PANDA_V, PANDA_A, jerk)
        share = np.abs(way) / np.linalg.norm(way)
        problem, answer = ruckig.InputParameter(1), ruckig.Trajectory(1)
        problem.target_position = [float(np.linalg.norm(way))]
        for name, limit in (("velocity", PANDA_V), ("acceleration", PANDA_A), ("jerk", jerk)):
            setattr(problem, f"max_{name}", [float(np.min(limit / share))])
        ruckig.Ruckig(1).calculate(problem, answer)
        # Phases of a millisecond at least cost a fraction of one.
        assert answer.duration - 1e-9 <= ours.duration <= answer.duration + 1e-3


@pytest.mark.slow
def test_between_the_motion_without_jerk_limits_and_one_that_stops_at_corners():
    for seed in range(6):
        corners = random_walk(seed, 12, 0.4)
        path = BlendedPath(corners, 0.05, smooth=True)
        jerk = 50 * PANDA_A
        ours = jerk_limited(path, NAMES, PANDA_V, PANDA_A, jerk).duration
        stops = jerk_limited(BlendedPath(corners, 0.0), NAMES, PANDA_V, PANDA_A, jerk).duration
        assert toppra_duration(path, PANDA_V, PANDA_A) <= ours < stops


@pytest.mark.parametrize("size", [2e-6, 1e-4, 1e-2])
def test_very_short_paths_and_edges(size):
    rng = np.random.default_rng(1)
    corners = np.concatenate([[np.zeros(7)], rng.normal(0.0, size, (5, 7)), [np.full(7, size)]])
    trajectory = jerk_limited(BlendedPath(corners, 0.05, smooth=True), NAMES, PANDA_V, PANDA_A, 30 * PANDA_A)
    np.testing.assert_array_equal(trajectory.positions[[0, -1]], corners[[0, -1]])
    q = dense(trajectory)
    assert np.max(np.abs(np.diff(q, 2, axis=0)) / STEP**2 / PANDA_A) <= 1.0 + 1e-6
    assert np.max(np.abs(np.diff(q, 3, axis=0)) / STEP**3 / (30 * PANDA_A)) <= 1.0 + 1e-2


def test_two_thousand_waypoints():
    path = BlendedPath(random_walk(0, 2000, 0.05), 0.05, smooth=True)
    trajectory = jerk_limited(path, NAMES, PANDA_V, PANDA_A, 100 * PANDA_A)
    jerk = np.diff(trajectory.accelerations, axis=0) / np.diff(trajectory.times)[:, None]
    assert np.max(np.abs(jerk) / (100 * PANDA_A)) <= 1.0 + 1e-3


def test_going_nowhere_and_back():
    assert len(jerk_limited(BlendedPath([np.ones(7)]), NAMES, PANDA_V, PANDA_A, PANDA_A).times) == 1
    there = random_waypoints(3)[0]
    path = BlendedPath([np.zeros(7), there, np.zeros(7)], 0.1, smooth=True)
    assert len(path.stops) == 1
    trajectory = jerk_limited(path, NAMES, PANDA_V, PANDA_A, 20 * PANDA_A)
    half = trajectory.sample(trajectory.duration / 2)
    np.testing.assert_allclose(half[0], there, atol=1e-9)
    np.testing.assert_allclose(half[1], 0.0, atol=1e-6)


def test_arcs_have_no_bounded_jerk():
    with pytest.raises(InputError, match=r"smooth=True"):
        jerk_limited(BlendedPath(random_waypoints(0), 0.05), NAMES, PANDA_V, PANDA_A, PANDA_A)


@pytest.mark.parametrize("bad", [0.0, np.inf, np.nan])
def test_a_missing_jerk_limit_names_the_joint(bad):
    limits = np.where(np.arange(7) == 2, bad, PANDA_A)
    with pytest.raises(InputError, match="joint 'j2' has no jerk limit"):
        jerk_limited(BlendedPath(random_waypoints(0), smooth=True), NAMES, PANDA_V, PANDA_A, limits)
