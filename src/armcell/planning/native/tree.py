"""A growing set of configurations with nearest-neighbour search, 16 at a time."""

# pyright: reportCallIssue=false
# Numba calls intrinsics without their typing context, and splices tuples into compiled calls.
from __future__ import annotations

import numpy as np
from numba import njit

from armcell.collision.kernel.simd import L, any_lt, fma, load, pointer, select_lt, splat, store

FAR = 1e9


def new_tree(dof: int, capacity: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nodes (blocks, dof, L) as one float32 array, parents, and radii of the dynamic domain."""
    blocks = -(-capacity // L)
    return (
        np.full(blocks * dof * L, FAR, np.float32),
        np.full(blocks * L, -1, np.int32),
        np.full(blocks * L, FAR),
    )


@njit(cache=True, forceinline=True)
def put(nodes, dof, i, q):
    """Write configuration q as node i. Nodes are put in order; the rest of a new block is set far away."""
    base = (i // L) * dof * L + i % L
    if i % L == 0:
        for j in range(dof):
            store(nodes, base + j * L, splat(np.float32(FAR)))
    for j in range(dof):
        nodes[base + j * L] = np.float32(q[j])


@njit(cache=True, forceinline=True)
def get(nodes, dof, i, q):
    """Read node i into q."""
    base = (i // L) * dof * L + i % L
    for j in range(dof):
        q[j] = nodes[base + j * L]


@njit(cache=True)
def nearest(nodes, dof, count, q, room):
    """Index of the node nearest to q (Euclidean). `room` has space for 2 L floats."""
    best, where = splat(np.float32(FAR * FAR)), splat(np.float32(0.0))
    for block in range((count + L - 1) // L):
        at = block * dof * L
        d = load(nodes, at) - splat(q[0])
        total = d * d
        for j in range(1, dof):
            d = load(nodes, at + j * L) - splat(q[j])
            total = fma(d, d, total)
        if any_lt(total, best):
            where = select_lt(total, best, splat(np.float32(block)), where)
            best = select_lt(total, best, total, best)
    store(room, 0, best)
    store(room, L, where)
    lane = 0
    for k in range(1, L):
        if room[k] < room[lane]:
            lane = k
    return int(room[L + lane]) * L + lane


__all__ = ["FAR", "get", "nearest", "new_tree", "pointer", "put"]
