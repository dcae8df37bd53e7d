"""BlendedPath: through the ends, near the corners, smooth in between."""

from __future__ import annotations

import numpy as np
import pytest
from tests.timing.helpers import distance_to_polyline, random_waypoints

from armcell.core import InputError
from armcell.timing import BlendedPath

SEEDS = range(10)


@pytest.mark.slow
@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("deviation", [0.005, 0.05, 0.5])
def test_it_stays_near_its_corners_and_keeps_its_ends(seed, deviation):
    corners = random_waypoints(seed)
    path = BlendedPath(corners, deviation)
    s = np.linspace(0, path.length, 2000)
    points = path.at(s)[0]
    np.testing.assert_allclose(points[[0, -1]], corners[[0, -1]], atol=1e-9)
    assert distance_to_polyline(points, corners).max() <= deviation + 1e-9
    assert distance_to_polyline(corners, path.polyline(1e-5)).max() <= deviation + 1e-5  # none is left out
    assert path.length <= np.linalg.norm(np.diff(corners, axis=0), axis=1).sum() + 1e-9
    assert not path.stops


@pytest.mark.parametrize("seed", SEEDS)
def test_it_is_parameterised_by_length_and_smooth(seed):
    path, h = BlendedPath(random_waypoints(seed), 0.05), 1e-6
    s = np.random.default_rng(seed).uniform(2 * h, path.length - 2 * h, 300)
    s = s[np.min(np.abs(s[:, None] - path.starts), axis=1) > 2 * h]  # inside the pieces
    _, tangent, curvature = path.at(s)
    before, after = path.at(s - h), path.at(s + h)
    np.testing.assert_allclose(np.linalg.norm(tangent, axis=1), 1.0, atol=1e-9)
    np.testing.assert_allclose((after[0] - before[0]) / (2 * h), tangent, atol=1e-6)
    np.testing.assert_allclose((after[1] - before[1]) / (2 * h), curvature, atol=1e-3)
    np.testing.assert_allclose(np.sum(tangent * curvature, axis=1), 0.0, atol=1e-9)
    joints = path.starts[1:-1]
    for order in (0, 1):  # no step of point or direction where pieces meet
        np.testing.assert_allclose(path.at(joints - 1e-9)[order], path.at(joints + 1e-9)[order], atol=1e-6)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_polyline_is_within_its_sagitta(seed):
    path = BlendedPath(random_waypoints(seed), 0.2)
    points = path.at(np.linspace(0, path.length, 2000))[0]
    for sagitta in (1e-2, 1e-4):
        assert distance_to_polyline(points, path.polyline(sagitta)).max() <= 1.02 * sagitta


def test_sharp_corners_are_stops():
    corners = random_waypoints(3)
    path = BlendedPath(corners, 0.0)
    lengths = np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))
    np.testing.assert_allclose(path.stops, lengths[:-1])
    np.testing.assert_allclose(path.at(path.stops)[0], corners[1:-1], atol=1e-9)


def test_one_deviation_for_each_corner():
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [2.0, 1.0]])
    path = BlendedPath(corners, [0.0, 0.1])
    assert len(path.stops) == 1
    np.testing.assert_allclose(path.at(path.stops)[0][0], corners[1])
    assert distance_to_polyline(corners[2:3], path.polyline(1e-5))[0] == pytest.approx(0.1, abs=1e-4)


def test_turning_back_is_a_stop():
    path = BlendedPath([[0.0, 0.0], [1.0, 0.0], [0.5, 0.0]], 0.1)
    assert path.length == pytest.approx(1.5) and path.stops == pytest.approx([1.0])


def test_going_straight_on_is_no_stop():
    path = BlendedPath([[0.0, 0.0], [0.3, 0.3], [1.0, 1.0]], 0.1)
    assert path.length == pytest.approx(np.sqrt(2)) and not path.stops


@pytest.mark.parametrize("deviation", [0.0, 0.05])
def test_repeated_waypoints_change_nothing(deviation):
    corners = random_waypoints(5)
    repeated = np.repeat(corners, 3, axis=0)
    a, b = BlendedPath(corners, deviation), BlendedPath(repeated, deviation)
    assert a.length == pytest.approx(b.length) and a.stops == pytest.approx(b.stops)
    s = np.linspace(0, a.length, 100)
    np.testing.assert_allclose(a.at(s)[0], b.at(s)[0], atol=1e-9)


@pytest.mark.parametrize("waypoints", [[[0.1, 0.2]], [[0.1, 0.2]] * 4])
def test_a_path_that_goes_nowhere(waypoints):
    path = BlendedPath(waypoints, 0.05)
    assert path.length == 0.0 and len(path.kind) == 0
    np.testing.assert_array_equal(path.polyline(), waypoints[:1])


@pytest.mark.slow
@pytest.mark.cases("*-0", "*-1", "*-2")
@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("deviation", [0.005, 0.05, 0.5])
def test_smooth_corners_have_no_step_of_curvature(seed, deviation):
    corners, h = random_waypoints(seed), 1e-6
    path = BlendedPath(corners, deviation, smooth=True)
    points = path.at(np.linspace(0, path.length, 2000))[0]
    assert distance_to_polyline(points, corners).max() <= deviation + 1e-9
    assert distance_to_polyline(points, path.polyline(1e-4)).max() <= 1.0001e-4
    for order in (0, 1, 2):
        for at in path.starts[1:-1]:
            step = path.at(at + 1e-9)[order] - path.at(at - 1e-9)[order]
            np.testing.assert_allclose(step, 0.0, atol=1e-4 if order == 2 else 1e-7)
    s = np.random.default_rng(seed).uniform(2 * h, path.length - 2 * h, 200)
    s = s[np.min(np.abs(s[:, None] - path.starts), axis=1) > 2 * h]
    before, after, now = path.at(s - h), path.at(s + h), path.at(s)
    np.testing.assert_allclose((after[0] - before[0]) / (2 * h), now[1], atol=1e-6)
    np.testing.assert_allclose((after[1] - before[1]) / (2 * h), now[2], atol=1e-3)


def test_a_smooth_corner_is_cut_as_far_as_allowed():
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]])
    for deviation in (0.01, 0.1):
        polyline = BlendedPath(corners, deviation, smooth=True).polyline(1e-6)
        assert distance_to_polyline(corners[1:2], polyline)[0] == pytest.approx(deviation, abs=1e-5)


def test_the_last_waypoint_is_kept_to_the_bit():
    corners = np.vstack([random_waypoints(2), random_waypoints(2)[-1] + 3e-7])
    path = BlendedPath(corners)
    np.testing.assert_array_equal(path.points[-1], corners[-1])


@pytest.mark.parametrize(
    ("waypoints", "deviation", "reason"),
    [
        ([], 0.05, "shape"),
        ([0.1, 0.2], 0.05, "shape"),
        ([[0.0, np.nan], [1.0, 1.0]], 0.05, "not finite"),
        ([[0.0], [1.0], [0.5]], -0.1, "negative"),
        ([[0.0], [1.0], [0.5]], np.nan, "negative or not a number"),
        ([[0.0], [1.0], [0.5]], [0.1, 0.1], r"\(2,\) deviations given for 1 inner"),
    ],
)
def test_bad_input(waypoints, deviation, reason):
    with pytest.raises(InputError, match=reason):
        BlendedPath(waypoints, deviation)
