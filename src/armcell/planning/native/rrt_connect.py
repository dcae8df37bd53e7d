"""RRT-Connect (Kuffner and LaValle, ICRA 2000) on the kernel, with a dynamic domain (Yershova et al. 2005)
and Halton samples; the choices follow VAMP (Thomason, Kingston and Kavraki, ICRA 2024).
"""

# pyright: reportCallIssue=false
# Numba calls intrinsics without their typing context, and splices tuples into compiled calls.
from __future__ import annotations

import numpy as np
from numba import njit

from armcell.collision.kernel.motion import edge_free
from armcell.collision.kernel.simd import pointer
from armcell.planning.native.tree import get, nearest, put

PRIMES = np.array(
    [2, 3, 5, 7, 11, 13, 17, 19, 23, 29, 31, 37, 41, 43, 47, 53, 59, 61, 67, 71, 73, 79, 83, 89]
)
DOMAIN = 4.0  # [rad] radius of a node's domain after its first failure
DOMAIN_MIN = 1.0
DOMAIN_STEP = 1e-4


@njit(cache=True)
def halton(index, base):
    """Van der Corput number of an index in a base."""
    result, f = 0.0, 1.0
    while index > 0:
        f /= base
        result += f * (index % base)
        index //= base
    return result


@njit(cache=True, nogil=True)
def rrt_connect(
    I,
    F,
    D,
    w,
    stamps,
    s,
    extra,
    extra_pair,
    start,
    goals,
    lower,
    upper,
    shift,
    reach,
    step,
    nodes_a,
    parents_a,
    radii_a,
    nodes_b,
    parents_b,
    radii_b,
    room,
    stop,
    max_iterations,
    path,
):
    """Waypoints from the start to one of the goals, into path (m, dof).

    Args:
        goals: (g, dof). shift: (dof,) in [0, 1), moves the Halton points (the seed).
        reach: longest edge [rad]. step: between validity checks [rad].
        nodes, parents, radii: trees from the start and from the goals. room: float32 scratch.
        stop: stop[0] != 0 ends the search at once; set by another thread.
    Returns:
        Number of waypoints (0: none found), iterations, nodes.
    """  # fmt: skip
    dof = len(start)
    Ip, Fp, Dp, wp, tp, sp = pointer(I), pointer(F), pointer(D), pointer(w), pointer(stamps), pointer(s)
    none, none_pair, spare = pointer(extra), pointer(extra_pair), pointer(room)
    q, near, new = np.empty(dof), np.empty(dof), np.empty(dof)
    qp, np_, newp = pointer(q), pointer(near), pointer(new)
    capacity = len(parents_a)
    a, pa, ra = nodes_a, parents_a, radii_a
    b, pb, rb = nodes_b, parents_b, radii_b
    put(pointer(a), dof, 0, pointer(start))
    pa[0], ra[0] = -1, 1e9
    for g in range(len(goals)):
        put(pointer(b), dof, g, pointer(goals[g]))
        pb[g], rb[g] = -1, 1e9
    na, nb, from_start = 1, len(goals), True
    iteration = 0
    while iteration < max_iterations and stop[0] == 0 and na + 64 < capacity and nb + 64 < capacity:
        iteration += 1
        if na > nb:  # grow the smaller tree
            a, b, pa, pb, ra, rb = b, a, pb, pa, rb, ra
            na, nb = nb, na
            from_start = not from_start
        ap, bp = pointer(a), pointer(b)
        for j in range(dof):
            u = halton(iteration, PRIMES[j]) + shift[j]
            q[j] = lower[j] + (upper[j] - lower[j]) * (u - np.floor(u))
        i = nearest(ap, dof, na, qp, spare)
        get(ap, dof, i, np_)
        distance = 0.0
        for j in range(dof):
            distance += (q[j] - near[j]) ** 2
        distance = np.sqrt(distance)
        if distance > ra[i]:
            continue
        f = min(1.0, reach / max(distance, 1e-9))
        for j in range(dof):
            new[j] = near[j] + f * (q[j] - near[j])
        if not edge_free(Ip, Fp, Dp, wp, tp, sp, none, none_pair, np_, newp, step):
            ra[i] = DOMAIN if ra[i] > 1e8 else max(ra[i] * (1 - DOMAIN_STEP), DOMAIN_MIN)
            continue
        if ra[i] < 1e8:
            ra[i] *= 1 + DOMAIN_STEP
        put(ap, dof, na, newp)
        pa[na], ra[na] = i, 1e9
        na += 1
        # Connect the other tree to the new node, step by step.
        k = nearest(bp, dof, nb, newp, spare)
        get(bp, dof, k, np_)
        distance = 0.0
        for j in range(dof):
            distance += (new[j] - near[j]) ** 2
        count = max(int(np.ceil(np.sqrt(distance) / reach)), 1)
        last, reached = k, True
        for j in range(dof):
            q[j] = (new[j] - near[j]) / count
        for c in range(count):
            for j in range(dof):
                new[j] = near[j] + q[j]
            if not edge_free(Ip, Fp, Dp, wp, tp, sp, none, none_pair, np_, newp, step):
                reached = False
                break
            if c < count - 1:
                put(bp, dof, nb, newp)
                pb[nb], rb[nb] = last, 1e9
                last = nb
                nb += 1
            for j in range(dof):
                near[j] = new[j]
        if not reached:
            continue
        # Join: from the new node of a to its root, and from `last` of b to its root.
        return _join(dof, a, pa, na - 1, b, pb, last, from_start, path), iteration, na + nb
    return 0, iteration, na + nb


@njit(cache=True)
def _join(dof, a, pa, i, b, pb, k, a_from_start, path):
    first, pf, f0, second, ps, s0 = a, pa, i, b, pb, k
    if not a_from_start:
        first, pf, f0, second, ps, s0 = b, pb, k, a, pa, i
    m, node = 0, f0
    while node >= 0:
        m += 1
        node = pf[node]
    total, node = m, s0
    while node >= 0:
        total += 1
        node = ps[node]
    if total > len(path):
        return 0
    node, row = f0, m - 1
    while node >= 0:
        get(pointer(first), dof, node, pointer(path[row]))
        node, row = pf[node], row - 1
    node, row = s0, m
    while node >= 0:
        get(pointer(second), dof, node, pointer(path[row]))
        node, row = ps[node], row + 1
    return total
