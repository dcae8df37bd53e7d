"""Exact nearest-neighbor search among many tree nodes.

Nodes are stored in leaves of 16 nodes with bounding boxes, and 16 boxes are evaluated at a time. A node joins
its parent's leaf, which is mostly the best leaf: a child is at most one edge away. A full leaf is split
across the widest side of its box. A query first computes a lower bound of its distance to every box, then
examines only the leaves that may hold a nearer node than the best known node, so the result is exact.

Nanoseconds per query for uniform samples, tree.nearest / this search (Zen 4, AVX-512; trees of an
unsolvable Panda problem for 7 joints, else of an RRT in which every second extension fails):

| nodes | 6 joints | 7 joints | 12 joints | 14 joints |
|---|---|---|---|---|
| 256 | 158 / 172 | 207 / 189 | 265 / 349 | 315 / 498 |
| 512 | 387 / 249 | 401 / 203 | 539 / 535 | 684 / 789 |
| 1000 | 733 / 409 | 835 / 416 | 1059 / 829 | 1336 / 1194 |
| 2000 | 3091 / 715 | 1405 / 501 | 3187 / 1535 | 2095 / 2047 |
| 4000 | 3935 / 1226 | 2164 / 857 | 5199 / 4216 | 4555 / 3322 |
| 16000 | 7488 / 5763 | | 15069 / 9370 | 18326 / 7616 |

Joining a leaf costs 40 to 250 ns per node. Trees with fewer than `LEAF_THRESHOLD` nodes therefore have no
leaves; at this number, all nodes join at once.
"""

# pyright: reportCallIssue=false
# Numba calls intrinsics without their typing context, and splices tuples into compiled calls.
from __future__ import annotations

import numpy as np

from armcell._inner_njit import inner_njit
from armcell.collision.kernel.simd import (
    L,
    fma,
    hmin,
    load,
    mask_lt,
    select_lt,
    splat,
    store,
    trailing_zeros,
    vmax,
)
from armcell.planning.planners.native.tree import FAR, JOINED, LEAVES, SIZES, most_leaves, nearest

LEAF_THRESHOLD = 1000  # number of nodes above which leaves are faster


@inner_njit
def nearest_node(t, tree, count, q, at):
    """Find the nearest neighbor of the configuration q[at : at + dims] among the first `count` nodes of a
    search tree.

    New nodes join their leaves first. `t` holds the memory of both trees (see `tree_pointers`).
    """
    floats, ints, dims, first = t.leaves, t.leaf_ints, t.dims, tree * t.capacity
    if count < LEAF_THRESHOLD:
        return nearest(t.nodes, dims, first, count, q, at, t.lanes)
    most = most_leaves(t.capacity)
    f, i = tree * most * ((L + 2) * dims + 1), tree * (SIZES + most * (L + 1) + t.capacity)
    boxes, bounds = f + most * L * dims, f + most * (L + 2) * dims
    inside, leaf_of = i + SIZES + most, i + SIZES + most * (L + 1)
    for node in range(ints[i + JOINED], count):
        leaf = 0
        if ints[i + LEAVES] == 0:
            ints[i + LEAVES] = 1
            _clear(floats, ints, dims, f, boxes, i, 0)
        elif t.parents[first + node] >= 0:
            leaf = ints[leaf_of + t.parents[first + node]]
        _join(t.nodes, floats, ints, dims, first, f, boxes, i, inside, leaf_of, leaf, node)
    ints[i + JOINED] = count
    leaves = ints[i + LEAVES]
    k = _nearest(floats, dims, f, boxes, bounds, leaves, q, at, t.lanes)
    return int(ints[inside + k])


@inner_njit
def _clear(floats, ints, dims, f, boxes, i, leaf):
    """Initialize an empty leaf of the nearest-neighbor search.

    The first leaf of a vector also empties the boxes that share the vector.
    """
    ints[i + SIZES + leaf] = 0
    box = boxes + (leaf // L) * 2 * dims * L
    for j in range(dims):
        store(floats, f + (leaf * dims + j) * L, splat(np.float32(FAR)))
        if leaf % L == 0:
            store(floats, box + j * L, splat(np.float32(FAR)))
            store(floats, box + (dims + j) * L, splat(np.float32(-FAR)))
        floats[box + j * L + leaf % L] = np.float32(FAR)
        floats[box + (dims + j) * L + leaf % L] = np.float32(-FAR)


@inner_njit
def _put(floats, ints, dims, f, boxes, i, inside, leaf_of, leaf, node, source, at):
    """Append a node to a leaf of the nearest-neighbor index. The leaf must not be full: it holds L = 16
    nodes, one per SIMD lane.

    The node's coordinates are source[at::L].
    """
    lane = ints[i + SIZES + leaf]
    ints[i + SIZES + leaf] = lane + 1
    box = boxes + (leaf // L) * 2 * dims * L + leaf % L
    for j in range(dims):
        x = source[at + j * L]
        floats[f + (leaf * dims + j) * L + lane] = x
        floats[box + j * L] = min(floats[box + j * L], x)
        floats[box + (dims + j) * L] = max(floats[box + (dims + j) * L], x)
    ints[inside + leaf * L + lane] = node
    ints[leaf_of + node] = leaf


@inner_njit
def _join(nodes, floats, ints, dims, first, f, boxes, i, inside, leaf_of, leaf, node):
    """Add a node of a search tree to a leaf of the nearest-neighbor search. A full leaf is split first."""
    at = ((first + node) // L) * dims * L + (first + node) % L
    if ints[i + SIZES + leaf] == L:
        box = boxes + (leaf // L) * 2 * dims * L + leaf % L
        axis, widest = 0, np.float32(-1.0)
        for j in range(dims):
            wide = floats[box + (dims + j) * L] - floats[box + j * L]
            if wide > widest:
                axis, widest = j, wide
        row, upper = f + (leaf * dims + axis) * L, 0
        for a in range(L):  # the lanes of the upper half, by rank; equal ones by lane
            rank = 0
            for b in range(L):
                less = floats[row + b] < floats[row + a]
                if less or (floats[row + b] == floats[row + a] and b < a):
                    rank += 1
            if rank >= L // 2:
                upper |= 1 << a
        new, here = ints[i + LEAVES], leaf
        ints[i + LEAVES] = new + 1
        _clear(floats, ints, dims, f, boxes, i, new)
        ints[i + SIZES + leaf] = 0
        for j in range(dims):
            floats[box + j * L], floats[box + (dims + j) * L] = np.float32(FAR), np.float32(-FAR)
        middle = np.float32(-FAR)
        for a in range(L):  # compact the lower half in place: writes never overtake reads
            other = ints[inside + leaf * L + a]
            target = new if upper & (1 << a) else leaf
            if target == leaf:
                middle = max(middle, floats[row + a])
            _put(
                floats,
                ints,
                dims,
                f,
                boxes,
                i,
                inside,
                leaf_of,
                target,
                other,
                floats,
                f + leaf * dims * L + a,
            )
        for a in range(L // 2, L):
            for j in range(dims):
                floats[f + (leaf * dims + j) * L + a] = np.float32(FAR)
        if nodes[at + axis * L] > middle:
            here = new
        leaf = here
    _put(floats, ints, dims, f, boxes, i, inside, leaf_of, leaf, node, nodes, at)


@inner_njit
def _nearest(floats, dims, f, boxes, bounds, leaves, q, at, lanes):
    """Search all leaves of the nearest-neighbor index for the node nearest to configuration q[at : at +
    dims]. Return its slot: 16 times the leaf number, plus the SIMD lane in the leaf.
    """
    zero, least, first = splat(np.float32(0.0)), np.float32(FAR * FAR), 0
    blocks = (leaves + L - 1) // L
    for b in range(blocks):
        box, total = boxes + b * 2 * dims * L, zero
        for j in range(dims):
            x = splat(q[at + j])
            d = vmax(vmax(load(floats, box + j * L) - x, x - load(floats, box + (dims + j) * L)), zero)
            total = fma(d, d, total)
        # Rounding may raise a bound slightly: reduce it so that no nearer node is skipped.
        total = total * splat(np.float32(1 - 1e-5))
        store(floats, bounds + b * L, total)
        m = hmin(total)
        if m < least:
            least = m
            first = b * L + trailing_zeros(
                mask_lt(total, splat(m * np.float32(1.000001) + np.float32(1e-30)))
            )
    best, where = splat(np.float32(FAR * FAR)), zero
    best, where = _look(floats, dims, f, first, q, at, best, where)
    limit = hmin(best)
    for b in range(blocks):
        bound = load(floats, bounds + b * L)
        mask = mask_lt(bound, splat(limit))
        while mask != 0:
            leaf = b * L + trailing_zeros(mask)
            mask &= mask - 1
            if leaf == first:
                continue
            best, where = _look(floats, dims, f, leaf, q, at, best, where)
            nearer = hmin(best)
            if nearer < limit:
                limit = nearer
                mask &= mask_lt(bound, splat(limit))
    store(lanes, 0, where)
    lane = trailing_zeros(mask_lt(best, splat(limit * np.float32(1.000001) + np.float32(1e-30))))
    return int(lanes[lane]) * L + lane


@inner_njit(forceinline=True)
def _look(floats, dims, f, leaf, q, at, best, where):
    """Scan one more leaf in a nearest-neighbor search. For each slot (SIMD lane), update the smallest
    distance and the leaf where it occurs.
    """
    base, total = f + leaf * dims * L, splat(np.float32(0.0))
    for j in range(dims):
        d = load(floats, base + j * L) - splat(q[at + j])
        total = fma(d, d, total)
    return select_lt(total, best, total, best), select_lt(total, best, splat(np.float32(leaf)), where)
