"""PRM kernel: grow a roadmap and search it with as few collision checks as possible.

Vertices are checked sixteen at a time, edges only when a shortest path uses them (Bohlin and Kavraki, "Path
planning using lazy PRM", ICRA 2000). Check results of vertices and edges carry the stamp of their scene:
+stamp means free, -stamp not free; any other value must be checked again. Each new vertex is joined with
its k nearest, k = e (1 + 1/d) log n (PRM*: Karaman and Frazzoli, IJRR 2011).
"""

# pyright: reportCallIssue=false
# Numba calls intrinsics without their typing context, and splices tuples into compiled calls.
from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit

from armcell._inner_njit import inner_njit
from armcell.collision.kernel.block import EXACT, PADDED, PROVE, check_block, ints, lanes_of
from armcell.collision.kernel.motion import deviation_margins, edge_free
from armcell.collision.kernel.pack import DOF
from armcell.collision.kernel.simd import L, fma, load, mask_lt, pointer, splat, store, trailing_zeros
from armcell.collision.kernel.workspace import interval_half_width_at, rate_at
from armcell.planning.planners.native.rrt_connect import next_sample
from armcell.planning.planners.native.tree import FAR, get, put

MAX_NEIGHBORS = 32
SAME = 1e-6  # [rad] vertices with a smaller distance count as one

# Contents of `counts`: vertices, edges, vertex checks, edge checks, searches.
VERTICES, EDGES, VERTEX_CHECKS, EDGE_CHECKS, SEARCHES, COUNTS = range(6)


class Graph(NamedTuple):
    """Arrays of a PRM roadmap, bundled as one argument of the kernels. Edge e has two entries in the
    adjacency lists: entry 2 e at one of its vertices, and entry 2 e + 1 at the other.

    Attributes:
        nodes: float32, blocks of (dof, L) coordinates.
        head: int32 (vertices,), a vertex's first entry (-1: none). following: int32, the vertex's next entry.
        to: int32, the vertex to which an entry leads. lengths: float32 (edges,) [rad].
        vertex_stamps, edge_stamps: int32, results of checks.
        counts: int64, see VERTICES.
        ids, near, lanes: scratch memory of a nearest-neighbor query.
    """

    nodes: Any
    head: Any
    following: Any
    to: Any
    lengths: Any
    vertex_stamps: Any
    edge_stamps: Any
    counts: Any
    ids: Any
    near: Any
    lanes: Any


class Search(NamedTuple):
    """State of one A* search on a PRM roadmap, bundled into a single argument for the compiled kernels.

    Attributes:
        mark: int64 (vertices,), the number of the last search that reached a vertex. cost: (vertices,).
        came: int32 (vertices,), entry by which the vertex was reached.
        keys, items: priority queue. ends: scratch memory of 2 dof numbers.
    """

    mark: Any
    cost: Any
    came: Any
    keys: Any
    items: Any
    ends: Any


@inner_njit
def _nearest_vertices(g, dof, q, at, k):
    """Find the k vertices of a roadmap nearest to the configuration q[at:], sorted by distance, in the PRM
    kernel.

    Write their numbers to g.ids and their squared distances to g.near. Return the count.
    """
    nodes, ids, near, lanes = pointer(g.nodes), pointer(g.ids), pointer(g.near), pointer(g.lanes)
    count = g.counts[VERTICES]
    n, worst = 0, np.float32(FAR)
    for block in range((count + L - 1) // L):
        total = splat(np.float32(0.0))
        for j in range(dof):
            d = load(nodes, (block * dof + j) * L) - splat(q[at + j])
            total = fma(d, d, total)
        mask = mask_lt(total, splat(worst))
        store(lanes, 0, total)
        while mask != 0:
            lane = trailing_zeros(mask)
            mask &= mask - 1
            d2 = lanes[lane]
            if d2 >= worst:
                continue
            i = min(n, k - 1)
            while i > 0 and near[i - 1] > d2:
                near[i], ids[i] = near[i - 1], ids[i - 1]
                i -= 1
            near[i], ids[i] = d2, block * L + lane
            n = min(n + 1, k)
            if n == k:
                worst = near[k - 1]
    return n


@inner_njit
def _link(g, a, b, length, stamp):
    """Add an edge between two vertices to a PRM roadmap, in the compiled kernel."""
    e = g.counts[EDGES]
    if 2 * e + 2 > 2 * len(g.lengths):
        return
    g.counts[EDGES] = e + 1
    g.to[2 * e], g.following[2 * e], g.head[a] = b, g.head[a], 2 * e
    g.to[2 * e + 1], g.following[2 * e + 1], g.head[b] = a, g.head[b], 2 * e + 1
    g.lengths[e], g.edge_stamps[e] = length, stamp


@inner_njit
def _add(g, dof, q, at, stamp):
    """Add a collision-free configuration as a vertex to a roadmap, and connect it with its nearest vertices,
    in the PRM kernel.

    Return the number of the vertex (-1: the roadmap is full).
    """
    n = g.counts[VERTICES]
    k = int(np.ceil(np.e * (1 + 1 / dof) * np.log(n + 2)))
    found = _nearest_vertices(g, dof, q, at, min(k, MAX_NEIGHBORS))
    if found > 0 and g.near[0] < SAME * SAME:
        g.vertex_stamps[g.ids[0]] = stamp
        return g.ids[0]
    if n == len(g.head):
        return -1
    put(pointer(g.nodes), dof, n, q, at)
    g.head[n], g.vertex_stamps[n] = -1, stamp
    g.counts[VERTICES] = n + 1
    for i in range(found):
        _link(g, n, g.ids[i], np.sqrt(g.near[i]), 0)
    return n


@inner_njit
def _not_free(k, lanes):
    """Return a bit mask of the configurations in the PRM kernel's buffer that are not collision-free.
    Each bit stands for one SIMD lane.
    """
    I, w = ints(k), lanes_of(k)
    for j in range(I[DOF]):
        store(w, rate_at(I, j), splat(np.float32(0.0)))
    store(w, interval_half_width_at(I), splat(np.float32(0.0)))
    return check_block(k, lanes, np.int64(EXACT | PADDED | PROVE))


@njit(cache=True, nogil=True)
def recheck(handle, no_room, g, stamp, stop):
    """Check every vertex of a roadmap for collisions in the current scene, in the PRM kernel, and mark it
    with a stamp: positive if it is collision-free, else negative.

    no_room: zeros (dof,).
    """
    dof, n, W, x = len(no_room), g.counts[VERTICES], lanes_of(pointer(handle)), pointer(g.nodes)
    deviation_margins(pointer(handle), pointer(no_room))
    for first in range(0, n, L):
        if stop[0] != 0:
            return
        lanes = np.int64(0)
        for lane in range(L):
            known = first + lane >= n or abs(g.vertex_stamps[first + lane]) == stamp
            lanes |= np.int64(0 if known else 1) << lane
            for j in range(dof):
                W[j * L + lane] = x[first * dof + j * L + (lane if first + lane < n else 0)]
        if lanes == 0:
            continue
        bad = _not_free(pointer(handle), lanes)
        for lane in range(L):
            if lanes & (np.int64(1) << lane):
                g.vertex_stamps[first + lane] = -stamp if bad & (np.int64(1) << lane) else stamp
                g.counts[VERTEX_CHECKS] += 1


@njit(cache=True, nogil=True)
def grow(handle, no_room, g, stamp, samples, block, blocks, stop):
    """Extend a PRM roadmap in the compiled kernel: sample `blocks` times 16 configurations, and add the
    collision-free ones.

    Args:
        samples: see rrt_connect.Samples. block: scratch (16 dof,).
    """
    dof, W, q = len(no_room), lanes_of(pointer(handle)), pointer(block)
    deviation_margins(pointer(handle), pointer(no_room))
    for _ in range(blocks):
        if stop[0] != 0:
            return
        for lane in range(L):
            next_sample(samples, dof, q, lane * dof)
            for j in range(dof):
                W[j * L + lane] = np.float32(q[lane * dof + j])
        bad = _not_free(pointer(handle), (np.int64(1) << L) - 1)
        g.counts[VERTEX_CHECKS] += L
        for lane in range(L):
            if bad & (np.int64(1) << lane) == 0:
                _add(g, dof, q, lane * dof, stamp)


@njit(cache=True, nogil=True)
def insert(g, stamp, path, numbers, joined):
    """Add the collision-free configurations of a path (m, dof) to a PRM roadmap as vertices, in the compiled
    kernel. Write the numbers of the vertices to `numbers`.

    Args:
        joined: whether the path's edges are also known to be free.
    """
    m, dof = path.shape
    for i in range(m):
        numbers[i] = _add(g, dof, pointer(path), i * dof, stamp)
        if not joined or i == 0 or numbers[i] < 0 or numbers[i - 1] < 0 or numbers[i] == numbers[i - 1]:
            continue
        length = 0.0
        for j in range(dof):
            length += (path[i, j] - path[i - 1, j]) ** 2
        _link(g, numbers[i], numbers[i - 1], np.sqrt(length), stamp)


@inner_njit
def _push(keys, items, n, key, item):
    i = n
    while i > 0 and keys[(i - 1) // 2] > key:
        keys[i], items[i] = keys[(i - 1) // 2], items[(i - 1) // 2]
        i = (i - 1) // 2
    keys[i], items[i] = key, item


@inner_njit
def _pop(keys, items, n):
    """Remove the smallest of n entries from the heap that A* uses on a roadmap, and store it behind the
    remaining entries.
    """
    top_key, top = keys[0], items[0]
    key, item, i = keys[n - 1], items[n - 1], 0
    while 2 * i + 1 < n - 1:
        child = 2 * i + 1
        if child + 1 < n - 1 and keys[child + 1] < keys[child]:
            child += 1
        if keys[child] >= key:
            break
        keys[i], items[i] = keys[child], items[child]
        i = child
    keys[i], items[i] = key, item
    keys[n - 1], items[n - 1] = top_key, top


@inner_njit
def _to_go(nodes, dof, v, goals, room):
    """Return the distance from vertex v of a roadmap to the nearest goal.
    A* uses it as an estimate of the remaining cost.
    """
    least = np.inf
    get(nodes, dof, v, room, 0)
    for g in goals:
        if g < 0:
            continue
        get(nodes, dof, g, room, dof)
        total = 0.0
        for j in range(dof):
            total += (room[j] - room[dof + j]) ** 2
        least = min(least, total)
    return np.sqrt(least)


@inner_njit
def _shortest(g, dof, stamp, start, goals, s, stop):
    """Find a shortest path on a roadmap to a goal by A*, in the PRM kernel. Return the goal, or -1 if there
    is no path.

    Only edges that are known to be blocked are excluded.
    """
    number, nodes, e = g.counts[SEARCHES], pointer(g.nodes), pointer(s.ends)
    s.mark[start], s.cost[start], s.came[start] = number, 0.0, -1
    _push(s.keys, s.items, 0, _to_go(nodes, dof, start, goals, e), start)
    n = 1
    while n > 0 and stop[0] == 0:
        _pop(s.keys, s.items, n)
        n -= 1
        key, v = s.keys[n], s.items[n]
        left = _to_go(nodes, dof, v, goals, e)
        if key > s.cost[v] + left + 1e-9:
            continue  # outdated entry: a cheaper path to v was found later
        if left == 0.0:
            return v
        k = g.head[v]
        while k >= 0:
            u = g.to[k]
            through = s.cost[v] + g.lengths[k // 2]
            blocked = g.edge_stamps[k // 2] == -stamp or g.vertex_stamps[u] == -stamp
            if not blocked and (s.mark[u] != number or through < s.cost[u] - 1e-9) and n < len(s.keys):
                s.mark[u], s.cost[u], s.came[u] = number, through, k
                _push(s.keys, s.items, n, through + _to_go(nodes, dof, u, goals, e), u)
                n += 1
            k = g.following[k]
    return -1


@njit(cache=True, nogil=True)
def query(handle, g, stamp, start, goals, step, s, route, path, stop):
    """Find the shortest collision-free path on a PRM roadmap in a compiled kernel, and write it to `path` (m,
    dof).

    The path is free at samples `step` [rad] apart.

    Args:
        start: vertex. goals: vertices (-1: none). s: see `Search`. route: receives the path's edges (m,).
    Returns:
        Number of waypoints; 0 if there is no path yet.
    """
    dof, x, e = path.shape[1], pointer(g.nodes), pointer(s.ends)
    while stop[0] == 0:
        g.counts[SEARCHES] += 1
        goal = _shortest(g, dof, stamp, start, goals, s, stop)
        if goal < 0:
            return 0
        n, v, free = 1, goal, True
        while s.came[v] >= 0 and stop[0] == 0:
            k = s.came[v]
            u = g.to[k ^ 1]
            if g.edge_stamps[k // 2] != stamp:
                g.counts[EDGE_CHECKS] += 1
                get(x, dof, u, e, 0)
                get(x, dof, v, e, dof)
                good = edge_free(pointer(handle), e, 0, dof, step)
                g.edge_stamps[k // 2] = stamp if good else -stamp
                free = free and good
            n, v = n + 1, u
        if stop[0] != 0 or n > len(path):
            return 0
        if not free:
            continue
        v = goal
        for row in range(n - 1, -1, -1):
            get(x, dof, v, pointer(path), row * dof)
            if row > 0:
                route[row - 1] = s.came[v] // 2
                v = g.to[s.came[v] ^ 1]
        return n
    return 0
