"""Bounding-box trees of the kernel: construction, and transforms and box tests for walks through them.

A block has 16 children, sorted along a Z-order curve; a walk tests 16 boxes at a time.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from armcell._inner_njit import inner_njit
from armcell.collision.kernel.simd import L, fma, load, mask_lt, splat

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I32 = NDArray[np.int32]

HUGE = 1e6  # [m] half extent of a plane's bounding box
EMPTY = 1e9  # [m] lower sides of an empty box


def box_tree(low: F64, high: F64) -> tuple[F32, I32]:
    """Build a tree of bounding boxes over boxes (n, 3), with 16 boxes per block.

    The boxes are sorted along a Z-order curve, so that the boxes of a block are neighbors.

    Returns:
        Boxes (blocks, 6, L), and the child of each box (blocks, L); see `Pack`.
    """
    order = z_order(low, high) if len(low) > L else np.arange(len(low))
    return tree_of(low[order], high[order], order)


def tree_of(low: F64, high: F64, content: NDArray[np.int64]) -> tuple[F32, I32]:
    """Build a tree of bounding boxes over boxes (n, 3) that are already
    ordered such that neighbors are close in space.

    Args:
        content: (n,) content index of each box.
    Returns:
        As `box_tree`.
    """
    levels = [(_blocks(low.T, EMPTY), _blocks(high.T, -EMPTY), content)]
    while levels[0][0].shape[1] > 1:
        lo, hi, _ = levels[0]
        lo, hi = lo.min(axis=2), hi.max(axis=2)
        levels.insert(0, (_blocks(lo, EMPTY), _blocks(hi, -EMPTY), np.arange(lo.shape[1])))
    blocks = [lo.shape[1] for lo, _, _ in levels]
    boxes = np.empty((sum(blocks), 6, L), np.float32)
    child = np.zeros((sum(blocks), L), np.int32)
    first = 0
    for depth, (lo, hi, inside) in enumerate(levels):
        end = first + blocks[depth]
        boxes[first:end, :3] = (lo - 1e-5).transpose(1, 0, 2)
        boxes[first:end, 3:] = (hi + 1e-5).transpose(1, 0, 2)
        inner = depth + 1 < len(levels)
        child[first:end].reshape(-1)[: len(inside)] = -(end + inside) if inner else inside
        first = end
    return boxes, child


def _blocks(rows: F64, empty: float) -> F64:
    """Arrange the coordinates (3, n) of a tree's bounding boxes in SIMD blocks of L boxes each, as an array
    (3, b, L). The unused entries of the last block get the value `empty`.
    """
    blocks = np.full((3, max(-(-rows.shape[1] // L), 1) * L), empty)
    blocks[:, : rows.shape[1]] = rows
    return blocks.reshape(3, -1, L)


def z_order(low: F64, high: F64) -> NDArray[np.int64]:
    """Return the order of boxes (n, 3) along a Z-order curve, to build a bounding-box tree.
    Unbounded boxes come first.
    """
    usual = np.logical_and.reduce([high[:, k] - low[:, k] < HUGE for k in range(3)])
    bounded = usual if usual.any() and not usual.all() else slice(None)
    middle = [np.clip((low[:, k] + high[:, k]) / 2, -HUGE, HUGE) for k in range(3)]
    lowest = np.array([row[bounded].min() for row in middle])
    code = z_codes(middle, lowest, np.array([row[bounded].max() for row in middle]) - lowest)
    code[~usual] = 0
    return sorted_order(code)


def z_codes(columns: Sequence[F32 | F64] | F32, lowest: F64, span: F64) -> NDArray[np.int64]:
    """Return the positions (n,) along a Z-order curve of points, whose coordinates are three columns (n,).

    The curve fills the box with the lowest corner `lowest` (3,) and the edges `span` (3,), in 1024 cells per
    axis. Points outside count as if they were at the nearest border.
    """
    code = np.zeros(len(columns[0]), np.int64)
    for k in range(3):  # one axis at a time, in place: the temporary arrays fit the processor's cache
        cell = columns[k] - lowest[k]
        cell /= max(span[k], 1e-9)
        cell *= 1023
        code |= SPREAD[np.clip(cell, 0, 1023, out=cell).astype(np.int64)] << k
    return code


def sorted_order(code: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the stable order that sorts Z-order codes (n,)."""
    # A sort of unique keys is the stable order, and several times faster than a stable argsort.
    shift = max(len(code) - 1, 1).bit_length()
    return np.sort(code << shift | np.arange(len(code))) & ((1 << shift) - 1)


def _spread() -> NDArray[np.int64]:
    """Return the integers from 0 to 1023 with two zero bits inserted after each bit, to sort the boxes of a
    tree in Z-order.
    """
    numbers = np.arange(1024)
    return sum(((numbers >> bit) & 1) << 3 * bit for bit in range(10))  # pyright: ignore


SPREAD = _spread()


# pyright: reportCallIssue=false
# Numba calls intrinsics without their typing context, and splices tuples into compiled calls.


@inner_njit(forceinline=True)
def to_shape_frame(F, m, cx, cy, cz):
    """Transform points from the world frame to the frame of a world shape, whose tree of boxes the kernel
    then searches. Each SIMD lane holds one point.

    The rows of the transform's 3x4 matrix are stored in F, beginning at F[m].
    """
    x = fma(cx, splat(F[m]), fma(cy, splat(F[m + 1]), fma(cz, splat(F[m + 2]), splat(F[m + 3]))))
    y = fma(cx, splat(F[m + 4]), fma(cy, splat(F[m + 5]), fma(cz, splat(F[m + 6]), splat(F[m + 7]))))
    z = fma(cx, splat(F[m + 8]), fma(cy, splat(F[m + 9]), fma(cz, splat(F[m + 10]), splat(F[m + 11]))))
    return x, y, z


@inner_njit(forceinline=True)
def rotate_to_shape_frame(F, m, cx, cy, cz):
    """Rotate vectors from the world frame to the frame of a world shape with its tree of boxes. Each SIMD
    lane holds one vector.

    The rows of the transform's 3x4 matrix are stored in F, beginning at F[m]. Its translation is ignored.
    """
    x = fma(cx, splat(F[m]), fma(cy, splat(F[m + 1]), cz * splat(F[m + 2])))
    y = fma(cx, splat(F[m + 4]), fma(cy, splat(F[m + 5]), cz * splat(F[m + 6])))
    z = fma(cx, splat(F[m + 8]), fma(cy, splat(F[m + 9]), cz * splat(F[m + 10])))
    return x, y, z


@inner_njit(forceinline=True)
def boxes_hit(F, at, lx, ly, lz, hx, hy, hz):
    """Test the 16 bounding boxes in a block of a box tree against a given box. Return a bit mask of those
    that overlap it. The block starts at F[at].
    """
    mask = mask_lt(load(F, at), splat(hx)) & mask_lt(load(F, at + L), splat(hy))
    mask &= mask_lt(load(F, at + 2 * L), splat(hz)) & mask_lt(splat(lx), load(F, at + 3 * L))
    return mask & mask_lt(splat(ly), load(F, at + 4 * L)) & mask_lt(splat(lz), load(F, at + 5 * L))
