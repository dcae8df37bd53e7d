"""PRM kernel: grow a roadmap and search it with as few collision checks as possible.

Vertices are checked sixteen at a time, edges only when a shortest path uses them (Bohlin and Kavraki, "Path
planning using lazy PRM", ICRA 2000). Check results of vertices and edges carry the stamp of their scene:
+stamp means free, -stamp not free; any other value must be checked again. Each new vertex is joined with
its k nearest, k = e (1 + 1/d) log n (PRM*: Karaman and Frazzoli, IJRR 2011).
"""

# pyright: reportCallIssue=false
# Numba calls intrinsics without their typing context, and splices tuples into compiled calls.
from __future__ import annotations

import numpy as np
from numba import njit

from armcell._inner_njit import inner_njit
from armcell.collision.kernel.block import EXACT, PADDED, PROVE, check_block, ints, lanes_of
from armcell.collision.kernel.frames import half_at, rate_at
from armcell.collision.kernel.layout import DOF
from armcell.collision.kernel.motion import edge_free, loosen
from armcell.collision.kernel.simd import L, fma, load, mask_lt, pointer, splat, store, trailing_zeros
from armcell.planning.planners.native.tree import FAR, get, put

MAX_NEIGHBORS = 32
SAME = 1e-6  # [rad] vertices with a smaller distance count as one

# Contents of `counts`: vertices, edges, vertex checks, edge checks, searches.
VERTICES, EDGES, VERTEX_CHECKS, EDGE_CHECKS, SEARCHES, COUNTS = range(6)


@inner_njit
def _nearest_vertices(nodes, dof, count, q, at, k, ids, near, room):
    """Find in a compiled kernel the k vertices of a PRM roadmap that are nearest to q[at:], sorted by
    distance.

    Write their numbers to ids and their squared distances to near. Return the count.
    """
    n, worst = 0, np.float32(FAR)
    for block in range((count + L - 1) // L):
        total = splat(np.float32(0.0))
        for j in range(dof):
            d = load(nodes, (block * dof + j) * L) - splat(q[at + j])
            total = fma(d, d, total)
        mask = mask_lt(total, splat(worst))
        store(room, 0, total)
        while mask != 0:
            lane = trailing_zeros(mask)
            mask &= mask - 1
            d2 = room[lane]
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
def _link(a, b, length, stamp, head, following, to, lengths, edge_stamps, counts):
    """Add an edge between two vertices to a PRM roadmap, in the compiled kernel.

    Edge e is entry 2 e at vertex a and entry 2 e + 1 at vertex b.
    """
    e = counts[EDGES]
    if 2 * e + 2 > 2 * len(lengths):
        return
    counts[EDGES] = e + 1
    to[2 * e], following[2 * e], head[a] = b, head[a], 2 * e
    to[2 * e + 1], following[2 * e + 1], head[b] = a, head[b], 2 * e + 1
    lengths[e], edge_stamps[e] = length, stamp


@inner_njit
def _add(nodes, dof, q, at, stamp, head, following, to, lengths, vertex_stamps, edge_stamps, counts, ids,
         near, room):  # fmt: skip
    """Add a collision-free configuration as a vertex to a PRM roadmap, and connect it with its nearest
    vertices.

    Return the number of the vertex (-1: the roadmap is full).
    """
    n = counts[VERTICES]
    k = int(np.ceil(np.e * (1 + 1 / dof) * np.log(n + 2)))
    found = _nearest_vertices(
        nodes, dof, n, q, at, min(k, MAX_NEIGHBORS), pointer(ids), pointer(near), pointer(room)
    )
    if found > 0 and near[0] < SAME * SAME:
        vertex_stamps[ids[0]] = stamp
        return ids[0]
    if n == len(head):
        return -1
    put(nodes, dof, n, q, at)
    head[n], vertex_stamps[n] = -1, stamp
    counts[VERTICES] = n + 1
    for i in range(found):
        _link(n, ids[i], np.sqrt(near[i]), 0, head, following, to, lengths, edge_stamps, counts)
    return n


@inner_njit
def _not_free(k, lanes):
    """Return a bit mask of the configurations in the PRM kernel's buffer that are not collision-free.
    Each bit stands for one SIMD lane.
    """
    I, w = ints(k), lanes_of(k)
    for j in range(I[DOF]):
        store(w, rate_at(I, j), splat(np.float32(0.0)))
    store(w, half_at(I), splat(np.float32(0.0)))
    return check_block(k, lanes, np.int64(EXACT | PADDED | PROVE))


@njit(cache=True, nogil=True)
def recheck(handle, no_room, nodes, vertex_stamps, stamp, counts, stop):
    """Check every vertex of a PRM roadmap for collisions in the current scene, and mark it with a stamp:
    positive if it is collision-free, else negative.

    no_room: zeros (dof,).
    """
    dof, n, W, x = len(no_room), counts[VERTICES], lanes_of(pointer(handle)), pointer(nodes)
    loosen(pointer(handle), pointer(no_room))
    for first in range(0, n, L):
        if stop[0] != 0:
            return
        lanes = np.int64(0)
        for lane in range(L):
            known = first + lane >= n or abs(vertex_stamps[first + lane]) == stamp
            lanes |= np.int64(0 if known else 1) << lane
            for j in range(dof):
                W[j * L + lane] = x[first * dof + j * L + (lane if first + lane < n else 0)]
        if lanes == 0:
            continue
        bad = _not_free(
            pointer(handle), lanes,
        )  # fmt: skip
        for lane in range(L):
            if lanes & (np.int64(1) << lane):
                vertex_stamps[first + lane] = -stamp if bad & (np.int64(1) << lane) else stamp
                counts[VERTEX_CHECKS] += 1


@njit(cache=True, nogil=True)
def grow(handle, no_room, nodes, head, following, to, lengths, vertex_stamps,
         edge_stamps, counts, ids, near, room, stamp, lower, upper, steps, sample, block, blocks,
         stop):  # fmt: skip
    """Extend a PRM roadmap in the compiled kernel: sample `blocks` times 16 configurations, and add the
    collision-free ones.

    Args:
        steps, sample: (dof,), see rrt_connect.kronecker_steps. block: scratch (16, dof).
    """
    dof, W = len(lower), lanes_of(pointer(handle))
    loosen(pointer(handle), pointer(no_room))
    for _ in range(blocks):
        if stop[0] != 0:
            return
        for lane in range(L):
            for j in range(dof):
                u = sample[j] + steps[j]
                sample[j] = u - 1.0 if u >= 1.0 else u
                block[lane, j] = lower[j] + (upper[j] - lower[j]) * sample[j]
                W[j * L + lane] = np.float32(block[lane, j])
        bad = _not_free(
            pointer(handle), (np.int64(1) << L) - 1,
        )  # fmt: skip
        counts[VERTEX_CHECKS] += L
        for lane in range(L):
            if bad & (np.int64(1) << lane) == 0:
                _add(
                    pointer(nodes), dof, pointer(block), lane * dof, stamp, head, following, to, lengths,
                    vertex_stamps, edge_stamps, counts, ids, near, room,
                )  # fmt: skip


@njit(cache=True, nogil=True)
def insert(nodes, head, following, to, lengths, vertex_stamps, edge_stamps, counts, ids, near, room, stamp,
           path, numbers, joined):  # fmt: skip
    """Add the collision-free rows of a path (m, dof) as vertices to a PRM roadmap, and return the numbers of
    these vertices.

    Args:
        joined: whether the path's edges are also known to be free.
    """
    m, dof = path.shape
    for i in range(m):
        numbers[i] = _add(
            pointer(nodes), dof, pointer(path), i * dof, stamp, head, following, to, lengths, vertex_stamps,
            edge_stamps, counts, ids, near, room,
        )  # fmt: skip
        if not joined or i == 0 or numbers[i] < 0 or numbers[i - 1] < 0 or numbers[i] == numbers[i - 1]:
            continue
        length = 0.0
        for j in range(dof):
            length += (path[i, j] - path[i - 1, j]) ** 2
        _link(
            numbers[i], numbers[i - 1], np.sqrt(length), stamp, head, following, to, lengths, edge_stamps,
            counts,
        )  # fmt: skip


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
def _shortest(nodes, dof, head, following, to, lengths, vertex_stamps, edge_stamps, stamp, start, goals,
              number, mark, cost, came, keys, items, ends, stop):  # fmt: skip
    """Find a shortest path on a PRM roadmap to a goal by A*. Return the goal, or -1 if there is no path.

    Only edges that are known to be blocked are excluded.
    """
    mark[start], cost[start], came[start] = number, 0.0, -1
    e = pointer(ends)
    _push(keys, items, 0, _to_go(nodes, dof, start, goals, e), start)
    n = 1
    while n > 0 and stop[0] == 0:
        _pop(keys, items, n)
        n -= 1
        key, v = keys[n], items[n]
        left = _to_go(nodes, dof, v, goals, e)
        if key > cost[v] + left + 1e-9:
            continue  # outdated entry: a cheaper path to v was found later
        if left == 0.0:
            return v
        k = head[v]
        while k >= 0:
            u = to[k]
            through = cost[v] + lengths[k // 2]
            blocked = edge_stamps[k // 2] == -stamp or vertex_stamps[u] == -stamp
            if not blocked and (mark[u] != number or through < cost[u] - 1e-9) and n < len(keys):
                mark[u], cost[u], came[u] = number, through, k
                _push(keys, items, n, through + _to_go(nodes, dof, u, goals, e), u)
                n += 1
            k = following[k]
    return -1


@njit(cache=True, nogil=True)
def query(handle, nodes, head, following, to, lengths, vertex_stamps,
          edge_stamps, counts, stamp, start, goals, step, mark, cost, came, keys, items, ends, route, path,
          stop):  # fmt: skip
    """Find the shortest collision-free path on a PRM roadmap in a compiled kernel, and write it to `path` (m,
    dof).

    The path is free at samples `step` [rad] apart.

    Args:
        start: vertex. goals: vertices (-1: none). route: receives the path's edges (m,).
    Returns:
        Number of waypoints; 0 if there is no path yet.
    """
    dof, x, e = path.shape[1], pointer(nodes), pointer(ends)
    while stop[0] == 0:
        counts[SEARCHES] += 1
        goal = _shortest(
            x, dof, head, following, to, lengths, vertex_stamps, edge_stamps, stamp, start, goals,
            counts[SEARCHES], mark, cost, came, keys, items, ends, stop,
        )  # fmt: skip
        if goal < 0:
            return 0
        n, v, free = 1, goal, True
        while came[v] >= 0 and stop[0] == 0:
            k = came[v]
            u = to[k ^ 1]
            if edge_stamps[k // 2] != stamp:
                counts[EDGE_CHECKS] += 1
                get(x, dof, u, e, 0)
                get(x, dof, v, e, dof)
                good = edge_free(
                    pointer(handle), e, 0, dof, step,
                )  # fmt: skip
                edge_stamps[k // 2] = stamp if good else -stamp
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
                route[row - 1] = came[v] // 2
                v = to[came[v] ^ 1]
        return n
    return 0
