"""Kernel data of point clouds, octrees, and nonconvex meshes: spheres, cubes, or triangles.

The kernel calls each of them a cloud of parts. A cloud is stored in the frame of its bounding box, so moving
the object costs no time. The parts are sorted along a Z-order curve and stored in blocks of 16 under a
bounding-box tree: 18 bytes per point.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armcell.collision.kernel import gjk
from armcell.collision.kernel.box_tree import tree_of, z_order
from armcell.collision.kernel.simd import L
from armcell.collision.kernel.surface import small_triangles
from armcell.collision.shapes import is_closed, is_convex
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
    """Parts in blocks (b, rows, L) with a bounding-box tree whose leaves are blocks of parts.

    `box` at the pose `T_shape_box` (4, 4) encloses all parts. `closed` is True if the triangles enclose a
    solid.
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
    """Return the cloud of a point cloud, octree, or nonconvex mesh; None for a convex shape."""
    centre, half = local_bounds(shape)
    match shape:
        case PointCloud():
            points = shape.points - centre
            low, high = points - shape.radius, points + shape.radius
            radius = np.full(len(points), shape.radius)
            return _cloud(gjk.BALL, centre, half, np.column_stack([points, radius]), low, high)
        case Octree():
            cells, edge = shape.centres - centre, shape.sizes[:, None] / 2
            return _cloud(gjk.CELL, centre, half, np.column_stack([cells, edge]), cells - edge, cells + edge)
        case Mesh() if not is_convex(shape):
            edge = max(TRIANGLE_EDGE, float(np.sqrt(_area(shape) / TRIANGLES)))
            corners = small_triangles(shape.vertices - centre, shape.faces.astype(np.int64), edge)
            corners = corners.astype(np.float32).astype(float)  # rounded as in the kernel
            normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
            parts = np.column_stack([corners.reshape(-1, 9), normal])
            low, high = corners.min(axis=1), corners.max(axis=1)
            return _cloud(gjk.TRIANGLE, centre, half, parts, low, high, is_closed(shape))
    return None


def _area(mesh: Mesh) -> float:
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def _cloud(kind: int, centre: F64, half: F64, parts: F64, low: F64, high: F64, closed: bool = False) -> Cloud:
    T = np.eye(4)
    T[:3, 3] = centre
    box = Box(*(2 * np.maximum(half, 1e-6)))
    if len(parts) == 0:
        return Cloud(
            kind, box, T, np.zeros((0, ROWS[kind], L), np.float32), *tree_of(low, high, np.arange(0))
        )
    order = z_order(low, high)
    starts = np.arange(0, len(order), L)
    low, high = np.minimum.reduceat(low[order], starts), np.maximum.reduceat(high[order], starts)
    padded = order[np.minimum(np.arange(len(starts) * L), len(order) - 1)]  # the last part fills its block
    blocks = parts[padded].astype(np.float32).reshape(-1, L, ROWS[kind]).transpose(0, 2, 1)
    if kind == gjk.TRIANGLE:  # no triangle may count twice, so the surplus ones shrink to a point
        surplus = np.arange(len(padded) - len(order), 0, -1)
        blocks[-1, 3:9, L - surplus] = np.tile(blocks[-1, :3, L - surplus], 2)
        blocks[-1, 9:, L - surplus] = 0
    else:  # rounding to float32 must not shrink a part
        blocks[:, 3] += np.float32(2e-7) * (np.abs(blocks[:, :3]).max() + np.abs(blocks[:, 3]))
    return Cloud(
        kind, box, T, np.ascontiguousarray(blocks), *tree_of(low, high, np.arange(len(starts))), closed
    )


def join_clouds(clouds: list[Cloud]) -> dict[str, Any]:
    """Concatenate clouds into the arrays of a `Pack`."""
    table, block, number = [], 0, 0
    for cloud in clouds:
        table.append((cloud.kind, block, number, cloud.closed))
        block += len(cloud.boxes)
        number += cloud.parts.size
    return {
        "cloud": np.array(table, np.int32).reshape(-1, 4),
        "cloud_boxes": np.concatenate([np.zeros((0, 6, L), np.float32), *(c.boxes for c in clouds)]),
        "cloud_child": np.concatenate([np.zeros((0, L), np.int32), *(c.child for c in clouds)]),
        "cloud_parts": np.concatenate([np.zeros(0, np.float32), *(c.parts.ravel() for c in clouds)]),
    }
