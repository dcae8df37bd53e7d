"""Bounding-box trees with blocks of 16 children, sorted along a Z-order curve."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from armcell.collision.kernel.simd import L

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I32 = NDArray[np.int32]

HUGE = 1e6  # [m] half extent of a plane's bounding box


def box_tree(low: F64, high: F64) -> tuple[F32, I32]:
    """Build a bounding-box tree of boxes (n, 3) with 16 boxes per block.

    The boxes are sorted along a Z-order curve, so that the boxes of a block are neighbors.

    Returns:
        Boxes (blocks, 6, L), and the child of each box (blocks, L); see `Pack`.
    """
    order = z_order(low, high) if len(low) > L else np.arange(len(low))
    return tree_of(low[order], high[order], order)


def tree_of(low: F64, high: F64, content: NDArray[np.int64]) -> tuple[F32, I32]:
    """Build a bounding-box tree of boxes (n, 3) that are already in a spatially compact order.

    Args:
        content: (n,) content index of each box.
    Returns:
        As `box_tree`.
    """
    levels = [(low, high, content)]
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
    for depth, (lo, hi, inside) in enumerate(levels):
        k = np.arange(len(lo))
        boxes[first + k // L, :3, k % L] = lo - 1e-5
        boxes[first + k // L, 3:, k % L] = hi + 1e-5
        inner = depth + 1 < len(levels)
        child[first + k // L, k % L] = -(first + blocks[depth] + inside) if inner else inside
        first += blocks[depth]
    return boxes, child


def z_order(low: F64, high: F64) -> NDArray[np.int64]:
    """Return the order of boxes (n, 3) along a Z-order curve; unbounded boxes come first."""
    middle = np.clip((low + high) / 2, -HUGE, HUGE)
    usual = np.all(high - low < HUGE, axis=1)
    base = middle[usual] if usual.any() else middle
    span = np.maximum(np.ptp(base, axis=0), 1e-9)
    cell = np.clip((middle - base.min(0)) / span * 1023, 0, 1023).astype(np.uint64)
    code = np.zeros(len(middle), np.uint64)  # Morton numbers, 10 bits an axis
    for bit in range(10):
        for axis in range(3):
            code |= ((cell[:, axis] >> np.uint64(bit)) & np.uint64(1)) << np.uint64(3 * bit + axis)
    return np.argsort(np.where(usual, code, 0), kind="stable")
