"""Points on the surface of a link's collision shapes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from armcell.core import Mesh
from armcell.core.geometry import local_bounds
from armcell.model.robot import Link

Array = NDArray[np.float64]


def surface_points(link: Link, spacing: float) -> Array:
    """Sample points (n, 3) [m] on the surface of a link's collision shapes, about three points per square of
    side `spacing` [m]. A shape that is not a mesh is replaced with its bounding box.
    """
    found = [np.zeros((0, 3))]
    for collision in link.collisions:
        shape = collision.shape
        if isinstance(shape, Mesh):
            corners = np.asarray(shape.vertices, dtype=float)[np.asarray(shape.faces)]
        else:
            center, half = local_bounds(shape)
            corners = _box(center, half)
        found.append(collision.T_link_shape.apply(_spread(corners, spacing)))
    return np.concatenate(found)


def _spread(corners: Array, spacing: float) -> Array:
    """Sample points on the surface of a link, given as triangles (n, 3, 3): all corners, and random points in
    large triangles.
    """
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    count = np.minimum(np.ceil(3 * area / spacing**2), 3000).astype(int)
    which = np.repeat(np.arange(len(corners)), count)
    u, v = np.random.default_rng(0).random((2, len(which)))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    inner = a[which] + u[:, None] * (b - a)[which] + v[:, None] * (c - a)[which]
    return np.concatenate([corners.reshape(-1, 3), inner])


def _box(center: Array, half: Array) -> Array:
    """Return the triangles (12, 3, 3) of a box, to sample points on its surface."""
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    v = np.asarray(center) + signs * np.asarray(half)
    quads = [(0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5)]
    return np.array([v[list(t)] for q in quads for t in ((q[0], q[1], q[2]), (q[0], q[2], q[3]))])
