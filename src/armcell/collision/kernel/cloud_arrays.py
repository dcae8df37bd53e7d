"""Kernel data of point clouds, octrees, and nonconvex meshes: spheres, cubes, or triangles.

The kernel calls each of them a cloud of parts. A cloud is stored in the frame of its bounding box, so moving
the object costs no time. The parts are sorted along a Z-order curve and stored in blocks of 16 under a
bounding-box tree: 18 bytes per point.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from armcell.collision.coal_shapes import is_closed, is_convex
from armcell.collision.kernel import gjk
from armcell.collision.kernel.box_tree import tree_of, z_order
from armcell.collision.kernel.cover import small_triangles
from armcell.collision.kernel.simd import L
from armcell.core import Box, Mesh, Octree, PointCloud, Shape
from armcell.core.geometry import local_bounds

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I32 = NDArray[np.int32]

TRIANGLE_EDGE = 0.03  # [m]
TRIANGLES = 10000
"""Triangle edges are split if they are longer than `TRIANGLE_EDGE` and than sqrt(mesh area / `TRIANGLES`):
the bounding boxes of long triangles would cover the whole mesh."""

ROWS = {gjk.BALL: 4, gjk.CELL: 4, gjk.TRIANGLE: 12}
"""Values per part: center and radius, center and half edge, or corners and unit normal."""


@dataclass(frozen=True, eq=False)
class Cloud:
    """Arrays of a cloud in the kernel: spheres, cubes or triangles that represent a world shape, stored in
    blocks under a tree of bounding boxes.

    The leaves of the tree are blocks of parts. `box` at the pose `T_shape_box` (4, 4) encloses all parts.
    `closed` is True if the triangles enclose a solid.
    """

    kind: int
    box: Box
    T_shape_box: F64
    parts: F32
    boxes: F32
    child: I32
    closed: bool = False

    @property
    def empty(self) -> bool:
        return len(self.parts) == 0


@lru_cache(maxsize=16)
def cloud_of(shape: Shape) -> Cloud | None:
    """Build the kernel's cloud arrays for a shape with many parts: a point cloud, an octree or a nonconvex
    mesh. Return None for a convex shape.
    """
    center, half = local_bounds(shape)
    match shape:
        case PointCloud():
            points = np.ascontiguousarray(shape.points.T) - center[:, None]
            return _cloud(gjk.BALL, center, half, [*points, shape.radius], *_grown(points, shape.radius))
        case Octree():
            cells, edge = np.ascontiguousarray(shape.centers.T) - center[:, None], shape.sizes / 2
            return _cloud(gjk.CELL, center, half, [*cells, edge], *_grown(cells, edge))
        case Mesh() if not is_convex(shape):
            edge = max(TRIANGLE_EDGE, float(np.sqrt(_area(shape) / TRIANGLES)))
            corners = small_triangles(shape.vertices - center, shape.faces.astype(np.int64), edge)
            corners = corners.astype(np.float32).astype(float)  # rounded as in the kernel
            normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
            parts = [*corners.reshape(-1, 9).T, *normal.T]
            low, high = corners.min(axis=1).T, corners.max(axis=1).T
            return _cloud(gjk.TRIANGLE, center, half, parts, low, high, is_closed(shape))
    return None


def _area(mesh: Mesh) -> float:
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def _grown(middle: F64, half: F64 | float) -> tuple[F64, F64]:
    return middle - half, middle + half


def _cloud(
    kind: int,
    center: F64,
    half: F64,
    parts: Sequence[F64 | float],
    low: F64,
    high: F64,
    closed: bool = False,
) -> Cloud:
    """Return the arrays with which the kernel represents a cloud of n spheres, cubes or triangles.

    Args:
        parts: values of the parts, a row (n,) or a number for each of `ROWS`.
        low, high: (3, n) corners of the parts' bounding boxes.
    """
    T = np.eye(4)
    T[:3, 3] = center
    box = Box(*(2 * np.maximum(half, 1e-6)))
    if low.shape[1] == 0:
        none = np.zeros((0, ROWS[kind], L), np.float32)
        return Cloud(kind, box, T, none, *tree_of(low.T, high.T, np.arange(0)))
    order = z_order(low.T, high.T)
    count = -(-len(order) // L)
    padded = order[np.minimum(np.arange(count * L), len(order) - 1)]  # the last part fills its block
    low = np.stack([row[padded].reshape(-1, L).min(axis=1) for row in low], axis=1)
    high = np.stack([row[padded].reshape(-1, L).max(axis=1) for row in high], axis=1)
    blocks = np.empty((count, ROWS[kind], L), np.float32)
    for k, row in enumerate(parts):
        blocks[:, k] = row[padded].reshape(-1, L) if isinstance(row, np.ndarray) else row
    if kind == gjk.TRIANGLE:  # no triangle may count twice, so the surplus ones shrink to a point
        surplus = np.arange(len(padded) - len(order), 0, -1)
        blocks[-1, 3:9, L - surplus] = np.tile(blocks[-1, :3, L - surplus], 2)
        blocks[-1, 9:, L - surplus] = 0
    else:  # rounding to float32 must not shrink a part
        blocks[:, 3] += np.float32(2e-7) * (np.abs(blocks[:, :3]).max() + np.abs(blocks[:, 3]))
    return Cloud(kind, box, T, blocks, *tree_of(low, high, np.arange(count)), closed)
