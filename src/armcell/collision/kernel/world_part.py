"""What stands in the world, as the kernel wants it: shapes in world coordinates and a tree of boxes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from armcell.collision.kernel.pieces import Pieces, concatenate, convex_parts, pieces_of, solid
from armcell.collision.kernel.simd import L
from armcell.core import Mesh, Plane, Shape
from armcell.core.geometry import local_bounds
from armcell.scene import CollisionObject

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I32 = NDArray[np.int32]

HUGE = 1e6  # [m] half the size of a plane's box


@dataclass(frozen=True, eq=False)
class ObjectPart:
    """The convex shapes of one object in the world (o of them)."""

    kind: I32  # (o,)
    pose: F32  # (o, 12) rows of T_shape_world
    size: F32  # (o, 3)
    planes: F32  # (n, 4) of hulls
    planes_end: I32  # (o,)
    low: F64  # (o, 3) boxes in the world
    high: F64
    pieces: Pieces
    pieces_end: I32  # (o,)


@lru_cache(maxsize=512)
def object_part(item: CollisionObject) -> ObjectPart:
    """Kept per object: objects are values, a moved one is another one."""
    T_world_object = item.T_world_object.matrix
    kinds, poses, sizes, planes, planes_end, low, high = [], [], [], [], [], [], []
    pieces, pieces_end = [], []
    count = 0
    for shape, T_object_shape in item.shapes:
        T = T_world_object @ T_object_shape.matrix
        for part in convex_parts(shape):
            kind, size = solid(part)
            kinds.append(kind)
            sizes.append(size)
            poses.append(np.linalg.inv(T)[:3].ravel())
            if isinstance(part, Mesh):
                planes.append(_hull_planes(part))
            planes_end.append(sum(map(len, planes)))
            lo, hi = _world_box(part, T)
            low.append(lo)
            high.append(hi)
            pieces.append(pieces_of([(part, T)]))
            count += len(pieces[-1].kind)
            pieces_end.append(count)
    return ObjectPart(
        np.array(kinds, np.int32),
        np.array(poses, np.float32),
        np.array(sizes, np.float32),
        np.concatenate([np.zeros((0, 4)), *planes]).astype(np.float32),
        np.array(planes_end, np.int32),
        np.array(low),
        np.array(high),
        concatenate(pieces),
        np.array(pieces_end, np.int32),
    )


def box_tree(low: F64, high: F64) -> tuple[F32, I32]:
    """A tree of boxes (n, 3), 16 a block: boxes (blocks, 6, L) and the child in each (see pack).

    Shapes are sorted along a Z-order curve, so that those of a block are neighbours.
    """
    n = len(low)
    if n <= L:
        levels = [(low, high, np.arange(n))]
    else:
        order = np.argsort(_z_order(low, high), kind="stable")
        levels = [(low[order], high[order], order)]
        while len(levels[0][0]) > L:
            lo, hi, _ = levels[0]
            starts = np.arange(0, len(lo), L)
            levels.insert(
                0, (np.minimum.reduceat(lo, starts), np.maximum.reduceat(hi, starts), np.arange(len(starts)))
            )
    blocks = [max(-(-len(lo) // L), 1) for lo, _, _ in levels]
    boxes = np.full((sum(blocks), 6, L), 1e9, np.float32)
    boxes[:, 3:] = -1e9
    child = np.zeros((sum(blocks), L), np.int32)
    first = 0
    for depth, (lo, hi, content) in enumerate(levels):
        k = np.arange(len(lo))
        boxes[first + k // L, :3, k % L] = lo - 1e-5
        boxes[first + k // L, 3:, k % L] = hi + 1e-5
        inner = depth + 1 < len(levels)
        child[first + k // L, k % L] = -(first + blocks[depth] + content) if inner else content
        first += blocks[depth]
    return boxes, child


def _z_order(low: F64, high: F64) -> NDArray[np.uint64]:
    """Morton numbers of the boxes' middles, 10 bits an axis."""
    middle = np.clip((low + high) / 2, -HUGE, HUGE)
    usual = np.all(high - low < HUGE, axis=1)
    base = middle[usual] if usual.any() else middle
    span = np.maximum(np.ptp(base, axis=0), 1e-9)
    cell = np.clip((middle - base.min(0)) / span * 1023, 0, 1023).astype(np.uint64)
    code = np.zeros(len(middle), np.uint64)
    for bit in range(10):
        for axis in range(3):
            code |= ((cell[:, axis] >> np.uint64(bit)) & np.uint64(1)) << np.uint64(3 * bit + axis)
    return np.where(usual, code, 0)  # planes first, together


@lru_cache(maxsize=1024)
def _hull_planes(mesh: Mesh) -> F64:
    """Outward normals and offsets (n, 4) of a mesh's hull."""
    from scipy.spatial import ConvexHull

    equations = ConvexHull(mesh.vertices).equations  # n x + d <= 0 inside
    _, index = np.unique(np.round(equations, 6), axis=0, return_index=True)
    planes = equations[np.sort(index)]
    return np.column_stack([planes[:, :3], -planes[:, 3]])


def _world_box(shape: Shape, T: F64) -> tuple[F64, F64]:
    if isinstance(shape, Plane):
        return np.full(3, -HUGE), np.full(3, HUGE)
    centre, half = local_bounds(shape)
    centre = T[:3, :3] @ centre + T[:3, 3]
    half = np.abs(T[:3, :3]) @ half
    return centre - half, centre + half
