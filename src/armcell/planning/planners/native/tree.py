"""Memory of two search trees, with nodes in blocks of 16, and the steps that all searches on two trees share:
taking turns, nearest neighbors by brute force, and writing the path.
"""

# pyright: reportCallIssue=false
# Numba calls intrinsics without their typing context, and splices tuples into compiled calls.
from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit

from armcell._inner_njit import inner_njit
from armcell.collision.kernel.simd import (
    L,
    any_lt,
    fma,
    hmin,
    load,
    mask_lt,
    pointer,
    select_lt,
    splat,
    store,
    trailing_zeros,
)

FAR = 1e9


# Integer array of each tree's leaves: number of joined nodes, number of leaves; then the leaves' sizes, the
# nodes in their lanes, and each node's leaf. Float array: the leaves (dims, L), the boxes (16 at a time: dims
# lower sides, dims upper sides, L each), and the bounds of a query.
JOINED, LEAVES, SIZES = 0, 1, 2


class Trees(NamedTuple):
    """Arrays of two search trees, bundled as one argument of the compiled planners.

    The fields hold arrays in Python and pointers in the kernels (see `tree_pointers`). Node i of tree t is
    node t * capacity + i.

    Attributes:
        nodes: float32, blocks of (dims, L) coordinates.
        parents: int32, -1 - r for root r.
        radii: float64, radius of each node's domain, or its longest edge [rad].
        leaves, leaf_ints: float32 and int32, see nearest_neighbors.
        lanes: float32 scratch memory, L numbers.
        capacity: number of nodes for which each tree has space; a multiple of L, the number of nodes per
            block.
        dims: coordinates per node.
    """

    nodes: Any
    parents: Any
    radii: Any
    leaves: Any
    leaf_ints: Any
    lanes: Any
    capacity: int
    dims: int


def new_trees(dims: int, capacity: int) -> Trees:
    """Allocate the memory for two native search trees of `capacity` nodes each, with `dims` coordinates per
    node. `put` fills the blocks of nodes in order.
    """
    most = most_leaves(capacity)
    return Trees(
        np.empty(2 * capacity * dims, np.float32),
        np.empty(2 * capacity, np.int32),
        np.empty(2 * capacity),
        np.empty(2 * most * ((L + 2) * dims + 1), np.float32),
        np.zeros(2 * (SIZES + most * (L + 1) + capacity), np.int32),
        np.zeros(L, np.float32),
        capacity,
        dims,
    )


@njit(cache=True)
def most_leaves(capacity):
    """Return the largest number of leaves that a search tree of `capacity` nodes needs for nearest-neighbor
    search.

    Each leaf holds at least half of L nodes.
    """
    return (2 * capacity // L + L) // L * L


@inner_njit
def tree_pointers(trees):
    """Convert the arrays of two native search trees to pointers."""
    return Trees(
        pointer(trees.nodes), pointer(trees.parents), pointer(trees.radii), pointer(trees.leaves),
        pointer(trees.leaf_ints), pointer(trees.lanes), trees.capacity, trees.dims,
    )  # fmt: skip


@inner_njit
def remove_nodes(t):
    """Remove the nodes of both native search trees from the index of nearest neighbors by emptying its
    leaves.
    """
    size = SIZES + most_leaves(t.capacity) * (L + 1) + t.capacity
    for tree in range(2):
        t.leaf_ints[tree * size + JOINED] = t.leaf_ints[tree * size + LEAVES] = 0


@inner_njit(forceinline=True)
def put(nodes, dof, i, q, at):
    """Store configuration q[at : at + dof] as node i in the node array of a native search tree.

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
def nearest(nodes, dof, first, count, q, at, lanes):
    """Find the node of a native search tree nearest to configuration q[at : at + dof], by a linear scan of
    `count` nodes from node `first` on. Return its index relative to `first`.

    `first` is a multiple of L.

    `lanes` is scratch memory of L floats.
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
    store(lanes, 0, where)
    # The smallest lane; a tiny increment makes the comparison "less than" find it.
    lane = trailing_zeros(mask_lt(best, splat(hmin(best) * np.float32(1.000001) + np.float32(1e-30))))
    return int(lanes[lane]) * L + lane


@inner_njit(forceinline=True)
def add(t, node, q, at, parent, radius):
    """Store configuration q[at : at + dims] as node `node` in the arrays of the native search trees, with its
    parent and radius.
    """
    put(t.nodes, t.dims, node, q, at)
    t.parents[node], t.radii[node] = parent, radius


@inner_njit
def next_tree(tree, n0, n1):
    """Choose the native search tree to extend next: the two trees take turns, but a tree is extended again
    while the other tree has at least twice as many nodes.

    Args:
        tree: the tree that was extended last. n0, n1: nodes of both trees.
    Returns:
        The tree, its number of nodes, and the other tree's number of nodes.
    """
    mine, other = (n1, n0) if tree == 1 else (n0, n1)
    if abs(mine - other) < mine:
        return 1 - tree, other, mine
    return tree, mine, other


@inner_njit
def trace(t, i, k, dof, row, path, most):
    """Write the path that connects the two native search trees to `path`: from the root of tree 0 to its node
    i, then from node k of tree 1 to the root of tree 1.

    Args:
        row: scratch, as many numbers as a node has coordinates. path: rows of the first dof coordinates, at
            most `most`.
    Returns:
        Number of rows (0: too many), and the root of tree 1 at which the path ends.
    """
    before, after, root = 0, 0, i
    while root >= 0:
        before, root = before + 1, t.parents[root]
    root = k
    while root >= 0:
        after, root = after + 1, t.parents[t.capacity + root]
    if before + after > most:
        return 0, -1 - root
    for at in range(before - 1, -1, -1):
        get(t.nodes, t.dims, i, row, 0)
        for j in range(dof):
            path[at * dof + j] = row[j]
        i = t.parents[i]
    for at in range(before, before + after):
        get(t.nodes, t.dims, t.capacity + k, row, 0)
        for j in range(dof):
            path[at * dof + j] = row[j]
        k = t.parents[t.capacity + k]
    return before + after, -1 - root
