"""Storage of two search trees in blocks of 16 nodes, and brute-force nearest neighbors."""

# pyright: reportCallIssue=false
# Numba calls intrinsics without their typing context, and splices tuples into compiled calls.
from __future__ import annotations

import numpy as np

from armcell._inner_njit import inner_njit
from armcell.collision.kernel.simd import (
    L,
    any_lt,
    fma,
    hmin,
    load,
    mask_lt,
    select_lt,
    splat,
    store,
    trailing_zeros,
)

FAR = 1e9


def new_trees(dof: int, capacity: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Allocate the memory for two native search trees. Each tree has space for `capacity` nodes.

    `capacity` must be a multiple of L, the number of nodes per block. `put` fills the blocks in order.

    Returns:
        Nodes (blocks, dof, L) as one float32 array, parents (-1 - r for root r), radii of the dynamic
        domain.
    """
    return (
        np.empty(2 * capacity * dof, np.float32),
        np.empty(2 * capacity, np.int32),
        np.empty(2 * capacity),
    )


@inner_njit(forceinline=True)
def put(nodes, dof, i, q, at):
    """Store configuration q[at:] as node i of a native search tree.

    Write nodes in ascending order. The rest of a new block is set far away.
    """
    base = (i // L) * dof * L + i % L
    if i % L == 0:
        for j in range(dof):
            store(nodes, base + j * L, splat(np.float32(FAR)))
    for j in range(dof):
        nodes[base + j * L] = np.float32(q[at + j])


@inner_njit(forceinline=True)
def get(nodes, dof, i, q, at):
    """Copy the configuration of node i in a native search tree to q[at:]."""
    base = (i // L) * dof * L + i % L
    for j in range(dof):
        q[at + j] = nodes[base + j * L]


@inner_njit
def nearest(nodes, dof, first, count, q, at, room):
    """Find the node of a native search tree that is nearest to q[at:],
    by comparing `count` nodes beginning with node `first`.

    `first` is a multiple of L.

    `room` is scratch memory of L floats.
    """
    best, where = splat(np.float32(FAR * FAR)), splat(np.float32(0.0))
    for block in range((count + L - 1) // L):
        base = (first // L + block) * dof * L
        d = load(nodes, base) - splat(q[at])
        total = d * d
        for j in range(1, dof):
            d = load(nodes, base + j * L) - splat(q[at + j])
            total = fma(d, d, total)
        if any_lt(total, best):
            where = select_lt(total, best, splat(np.float32(block)), where)
            best = select_lt(total, best, total, best)
    store(room, 0, where)
    # The smallest lane; a tiny increment makes the comparison "less than" find it.
    lane = trailing_zeros(mask_lt(best, splat(hmin(best) * np.float32(1.000001) + np.float32(1e-30))))
    return int(room[lane]) * L + lane


@inner_njit
def trace(nodes, parents, dims, capacity, i, k, dof, row, path, most):
    """Write the path that connects two native search trees: from the root of tree 0 to node i, then from node
    k to the root of tree 1.

    Args:
        row: scratch, dims numbers. path: rows of the first dof coordinates, at most `most`.
    Returns:
        Number of rows (0: too many), and the root of tree 1 at which the path ends.
    """
    before, after, root = 0, 0, i
    while root >= 0:
        before, root = before + 1, parents[root]
    root = k
    while root >= 0:
        after, root = after + 1, parents[capacity + root]
    if before + after > most:
        return 0, -1 - root
    for at in range(before - 1, -1, -1):
        get(nodes, dims, i, row, 0)
        for j in range(dof):
            path[at * dof + j] = row[j]
        i = parents[i]
    for at in range(before, before + after):
        get(nodes, dims, capacity + k, row, 0)
        for j in range(dof):
            path[at * dof + j] = row[j]
        k = parents[capacity + k]
    return before + after, -1 - root
