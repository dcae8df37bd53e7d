"""Depth images: a plane seen by a camera gives the plane's points."""

from __future__ import annotations

import numpy as np
import pytest

from armcell.core import SE3, InputError
from armcell.scene import depth_points

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


@pytest.mark.parametrize(
    ("depth", "intrinsics"),
    [(np.zeros(3), K), (np.zeros((3, 3, 3)), K), (np.full((3, 3), "a"), K), (np.zeros((3, 3)), K[:2]),
     (np.zeros((3, 3)), -K), (np.zeros((3, 3)), K * np.nan)],
)  # fmt: skip
def test_bad_input(depth, intrinsics):
    with pytest.raises(InputError):
        depth_points(depth, intrinsics)
