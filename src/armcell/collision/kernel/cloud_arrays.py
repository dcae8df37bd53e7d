"""Kernel data of point clouds, octrees, and nonconvex meshes: spheres, cubes, or triangles.

The kernel calls each of them a cloud of parts. A cloud is stored in the frame of its bounding box, so moving
the object costs no time. The parts are sorted along a Z-order curve and stored in blocks of 16 under a
bounding-box tree: 18 bytes per point.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from armcell.collision.coal_shapes import is_closed, is_convex
from armcell.collision.kernel import gjk
from armcell.collision.kernel.box_tree import sorted_order, tree_of, z_codes, z_order
from armcell.collision.kernel.cover import small_triangles
from armcell.collision.kernel.simd import L
from armcell.core import Box, Mesh, Octree, PointCloud, Shape
from armcell.core.cloud_shapes import SLACK, CloudUpdate
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
    `closed` is True if the triangles enclose a solid. `order` contains the index of the part in each lane of
    the blocks, and repetitions of the last part fill the last block. A partly converted cloud has no order.
    """

    kind: int
    box: Box
    T_shape_box: F64
    parts: F32
    boxes: F32
    child: I32
    closed: bool = False
    order: I32 | None = None

    @property
    def empty(self) -> bool:
        return len(self.parts) == 0


@lru_cache(maxsize=16)
def cloud_of(shape: Shape) -> Cloud | None:
    """Build the kernel's cloud arrays for a shape with many parts: a point cloud, an octree or a nonconvex
    mesh. Return None for a convex shape.

    For a point cloud from `PointCloud.updated`, only the changed part is built if most blocks stay unchanged.
    """
    if isinstance(shape, PointCloud) and shape.update is not None:
        updated = _updated(shape, shape.update)
        if updated is not None:
            return updated
    center, half = local_bounds(shape)
    match shape:
        case PointCloud():
            return _cloud(gjk.BALL, center, half, _sized(shape.points, center, shape.radius, half))
        case Octree():
            return _cloud(gjk.CELL, center, half, _sized(shape.centers, center, shape.sizes / 2, half))
        case Mesh() if not is_convex(shape):
            edge = max(TRIANGLE_EDGE, float(np.sqrt(_area(shape) / TRIANGLES)))
            corners = small_triangles(shape.vertices - center, shape.faces.astype(np.int64), edge)
            corners = corners.astype(np.float32).astype(float)  # rounded as in the kernel
            normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
            parts = np.hstack([corners.reshape(-1, 9), normal]).astype(np.float32)
            return _cloud(gjk.TRIANGLE, center, half, parts, is_closed(shape))
    return None


def _area(mesh: Mesh) -> float:
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def _sized(points: F64, center: F64, size: F64 | float, half: F64) -> F32:
    """Return the kernel's values (n, 4) of spheres or cubes in a cloud: center in the frame of the cloud's
    bounding box, and radius or half edge. The cloud's half extents are `half`.
    """
    parts = np.empty((len(points), 4), np.float32)
    for k in range(3):  # NumPy works several times faster along a column than along short rows
        np.subtract(points[:, k], center[k], out=parts[:, k], casting="same_kind")
    parts[:, 3] = size
    parts[:, 3] += np.float32(2e-7) * (np.float32(half.max()) + parts[:, 3])  # rounding must not shrink parts
    return parts


def _cloud(kind: int, center: F64, half: F64, parts: F32, closed: bool = False) -> Cloud:
    """Return the arrays with which the kernel represents a cloud of n spheres, cubes or triangles.

    Args:
        parts: (n, `ROWS`) values of the parts.
    """
    if len(parts) == 0:
        order = np.arange(0)
    elif kind == gjk.TRIANGLE:
        corners = parts[:, :9].reshape(-1, 3, 3)
        order = z_order(corners.min(axis=1), corners.max(axis=1))
    else:
        columns = np.ascontiguousarray(parts[:, :3].T, np.float64)
        order = z_order(columns.T, columns.T)
    filled = order[np.minimum(np.arange(-(-len(order) // L) * L), len(order) - 1)]
    blocks = _blocks(parts.take(filled, axis=0))
    if kind == gjk.TRIANGLE and len(
        order
    ):  # no triangle may count twice, so the surplus ones shrink to a point
        surplus = np.arange(len(filled) - len(order), 0, -1)
        blocks[-1, 3:9, L - surplus] = np.tile(blocks[-1, :3, L - surplus], 2)
        blocks[-1, 9:, L - surplus] = 0
    return _with_tree(kind, center, half, blocks, _block_bounds(kind, blocks), closed, filled)


def _updated(shape: PointCloud, update: CloudUpdate) -> Cloud | None:
    """Return the cloud of an updated point cloud, or None if most blocks of the base change.

    Only those blocks of the base are filled again that contain removed points, or into which new points
    belong by their position on the Z-order curve. The rest is copied, and the tree is built again.
    """
    base, kept = cloud_of(update.base), update.kept
    assert base is not None and base.order is not None
    live = kept[base.order]
    live[len(kept) :] = False  # the repetitions in the last block
    center, half = base.T_shape_box[:3, 3], np.array([base.box.x, base.box.y, base.box.z]) / 2
    added = _sized(shape.points[np.count_nonzero(kept) :], center, shape.radius, (1 + 2 * SLACK) * half)
    lowest = shape.radius - half

    def codes(points: F32) -> NDArray[np.int64]:
        return z_codes(np.ascontiguousarray(points[:, :3].T), lowest, -2 * lowest)

    begin, code = np.maximum.accumulate(codes(base.parts[:, :, 0])), codes(added)
    unchanged = np.ones(len(base.parts), bool)
    unchanged[np.flatnonzero(~live) // L] = False
    unchanged[np.maximum(begin.searchsorted(np.sort(code), "right") - 1, 0)] = False
    if 2 * np.count_nonzero(unchanged) < len(unchanged):
        return None
    left = base.parts[~unchanged].transpose(0, 2, 1)[live.reshape(-1, L)[~unchanged]]
    code = np.concatenate([codes(left), code])
    order = sorted_order(code)
    # Runs of parts between unchanged blocks. The last part of a run fills the last block of the run.
    before = begin[unchanged].searchsorted(code[order], "right")
    first = np.flatnonzero(np.diff(before, prepend=-1))
    size = np.diff(first, append=len(order))
    count = -(-size // L)
    run = np.repeat(np.arange(len(first)), count)
    lane = ((np.arange(len(run)) - (np.cumsum(count) - count)[run]) * L)[:, None] + np.arange(L)
    filled = order[first[run, None] + np.minimum(lane, size[run, None] - 1)]
    changed = _blocks(np.concatenate([left, added]).take(filled.ravel(), axis=0))
    after = before[first][run]  # number of unchanged blocks before each changed block
    place, old = np.arange(len(run)) + after, np.flatnonzero(unchanged)
    source = np.zeros(len(run) + len(old), np.int64)
    source[np.arange(len(old)) + after.searchsorted(np.arange(len(old)), "right")] = old
    blocks, low, high = base.parts.take(source, axis=0), *(r.take(source, axis=1) for r in _leaf_boxes(base))
    blocks[place], (low[:, place], high[:, place]) = changed, _block_bounds(base.kind, changed)
    half = np.maximum(-low, high).max(axis=1, initial=0.0)
    return _with_tree(base.kind, center, half, blocks, (low, high))


def _leaf_boxes(cloud: Cloud) -> tuple[F64, F64]:
    """Return the lowest and the highest corners, each (3, b), of the boxes of a cloud's b blocks."""
    count = len(cloud.parts)
    leaves = cloud.boxes[len(cloud.boxes) - max(-(-count // L), 1) :].transpose(1, 0, 2).astype(float)
    return leaves[:3].reshape(3, -1)[:, :count], leaves[3:].reshape(3, -1)[:, :count]


def _blocks(parts: F32) -> F32:
    """Arrange the values (n, k) of a cloud's parts in blocks (n / L, k, L)."""
    return np.ascontiguousarray(parts.reshape(-1, L, parts.shape[1]).transpose(0, 2, 1))


def _with_tree(
    kind: int, center: F64, half: F64, blocks: F32, bounds: tuple[F64, F64], closed: bool = False,
    order: NDArray[np.int64] | None = None,
) -> Cloud:  # fmt: skip
    """Return the cloud of blocks of parts, with a tree over their bounding boxes. `bounds` are the lowest and
    the highest corners of the boxes, each (3, b).
    """
    T = np.eye(4)
    T[:3, 3] = center
    boxes, child = tree_of(bounds[0].T, bounds[1].T, np.arange(len(blocks)))
    box = Box(*(2 * np.maximum(half, 1e-6)))
    return Cloud(
        kind, box, T, blocks, boxes, child, closed, None if order is None else order.astype(np.int32)
    )


def _block_bounds(kind: int, blocks: F32) -> tuple[F64, F64]:
    """Return the lowest and the highest corners, each (3, b), of the bounding boxes of blocks of parts."""
    lanes = np.ascontiguousarray(blocks.transpose(2, 1, 0))  # long rows: NumPy reduces short ones slowly
    if kind == gjk.TRIANGLE:
        corners = lanes[:, :9].reshape(3 * L, 3, -1)
        low, high = corners, corners
    else:
        low, high = lanes[:, :3] - lanes[:, 3:4], lanes[:, :3] + lanes[:, 3:4]
    return low.min(axis=0).astype(float), high.max(axis=0).astype(float)
