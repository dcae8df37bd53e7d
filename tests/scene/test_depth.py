"""Depth images: a plane seen by a camera gives the plane's points."""

from __future__ import annotations

import numpy as np
import pytest

from armcell.core import SE3, InputError, PointCloud
from armcell.scene import depth_points, seen_through

K = np.array([[100.0, 0, 31.5], [0, 120.0, 23.5], [0, 0, 1]])
T = SE3.from_xyz_rpy((1, 2, 3), (-2.0, 0.3, 0.7))
NORMAL, OFFSET = np.array([0.1, -0.2, 1.0]), 1.5  # n p = offset, in the camera's frame


def plane_depth() -> np.ndarray:
    """Where each pixel's ray meets the plane, by solving for it."""
    depth = np.empty((48, 64))
    for v in range(48):
        for u in range(64):
            ray = np.linalg.solve(K, [u, v, 1.0])
            depth[v, u] = OFFSET / (NORMAL @ ray)
    return depth


def test_points_lie_on_the_plane_and_project_back():
    depth = plane_depth()
    points = T.inverse().apply(depth_points(depth, K, T))
    np.testing.assert_allclose(points @ NORMAL, OFFSET)
    pixels = points @ K.T
    pixels = pixels[:, :2] / pixels[:, 2:]
    v, u = np.divmod(np.arange(48 * 64), 64)
    np.testing.assert_allclose(pixels, np.column_stack([u, v]), atol=1e-9)


def test_what_is_not_seen():
    depth = plane_depth()
    depth[0, :4] = [np.nan, np.inf, 0.0, -1.0]
    assert len(depth_points(depth, K)) == 48 * 64 - 4
    near = depth_points(depth, K, nearest=1.4, farthest=1.6)
    assert 0 < len(near) < 48 * 64 and near[:, 2].min() >= 1.4 and near[:, 2].max() <= 1.6
    assert depth_points(np.full((4, 4), np.nan), K).shape == (0, 3)


def test_millimeters():
    in_mm = np.round(plane_depth() * 1000).astype(np.uint16)
    np.testing.assert_allclose(depth_points(in_mm, K), depth_points(plane_depth(), K), atol=1e-3)


def test_points_that_a_view_proves_free():
    """A point is cleared only if all pixels around it saw something behind it."""
    rng, depth = np.random.default_rng(0), plane_depth()
    depth[10:20, 30:50] = 0.7  # a hand in front of the plane
    depth[30:35, 10:20] = [0.0, np.nan, np.inf, -1.0, np.nan] * 2
    local = rng.uniform([-1.5, -1.0, -0.5], [1.5, 1.0, 3.0], (4000, 3))
    local[:, :2] *= np.abs(local[:, 2:]) / 3
    local[:5] = 0.0  # at the camera
    free = seen_through(T.apply(local), depth, K, T, margin=0.05)
    for k, (x, y, z) in enumerate(local):
        expected = False
        if z > 1e-9:
            u, v, _ = K @ [x / z, y / z, 1.0]
            around = [
                (int(a), int(b)) for a in (np.floor(v), np.ceil(v)) for b in (np.floor(u), np.ceil(u))
            ]  # fmt: skip
            if all(0 <= a < 48 and 0 <= b < 64 for a, b in around):
                expected = all(np.isfinite(depth[at]) and depth[at] > z + 0.05 for at in around)
        assert free[k] == expected
    assert 300 < free.sum() < 3700


def test_a_cloud_follows_a_camera():
    """An object that was taken away disappears from the cloud, and the surface behind it appears."""
    depth = plane_depth()
    before = depth.copy()
    before[10:20, 30:50] = 0.7
    cloud = PointCloud(depth_points(before, K, T), 0.01)
    gone = seen_through(cloud.points, depth, K, T)
    assert 100 < gone.sum() <= 200  # all but its border, where the wall may hide it
    cloud = cloud.updated(depth_points(depth, K, T), gone)
    local = T.inverse().apply(cloud.points)
    assert np.sum(np.abs(local @ NORMAL - OFFSET) > 1e-9) == 200 - gone.sum()
    assert not seen_through(cloud.points[-48 * 64 :], depth, K, T).any()


@pytest.mark.parametrize(
    ("depth", "intrinsics"),
    [(np.zeros(3), K), (np.zeros((3, 3, 3)), K), (np.full((3, 3), "a"), K), (np.zeros((3, 3)), K[:2]),
     (np.zeros((3, 3)), -K), (np.zeros((3, 3)), K * np.nan)],
)  # fmt: skip
def test_bad_input(depth, intrinsics):
    with pytest.raises(InputError):
        depth_points(depth, intrinsics)
    with pytest.raises(InputError):
        seen_through(np.zeros((1, 3)), depth, intrinsics)
