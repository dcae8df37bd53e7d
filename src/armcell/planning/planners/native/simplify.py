"""Path simplification kernel: shortcuts and rounded corners (Numba).

Every edge of the result is proven free. A proof costs several checks at samples, and later shortcuts replace
most edges. Therefore the kernel first accepts edges that are free at samples, and proves only the edges of
the result. If one of these edges cannot be proven, the kernel starts again and proves every edge it accepts.

Paths are rows of a flat float64 buffer `p`, behind a bare pointer: the joint positions, then the state of the
edge to the next row: `ORIGINAL` or `CHANGED` if it is not yet proven, or `FREE`.
"""

# pyright: reportCallIssue=false
# Numba calls intrinsics without their typing context, and splices tuples into compiled calls.
from __future__ import annotations

import numpy as np
from numba import njit

from armcell._inner_njit import inner_njit
from armcell.collision.kernel.block import FIRST, ints
from armcell.collision.kernel.motion import FINEST, PROVEN, deviation_margins, edge_free, prove
from armcell.collision.kernel.pack import DOF
from armcell.collision.kernel.simd import pointer

COARSE = 1e-3
"""[rad] Proofs of shortcuts stop at intervals of this half width: a shortcut that needs finer intervals
passes within a few millimeters of an obstacle and is not worth its proof."""

SAMPLED = 0.1
"""[rad] Distance of the samples at which an edge is checked before the result is proven. With half of it, a
seventh instead of a quarter of the UR5's results cannot be proven, but the median time is a third longer."""

ONE_BLOCK = 1e3  # [rad] the samples of an edge, however long, are one block of the kernel
MIN_CHANGE = 0.01  # [rad] smaller moves of a corner are not tried
ROUNDS = 2  # with 4, paths of a UR5 and a Panda are 2 % shorter, but planning takes a fifth to a half longer
ORIGINAL, CHANGED, FREE = 0.0, 0.5, 1.0
WORTHWHILE = 0.02  # smallest relative gain that justifies another round


@inner_njit
def _distance(p, dof, a, b):
    total = 0.0
    for j in range(dof):
        total += (p[b + j] - p[a + j]) ** 2
    return np.sqrt(total)


@inner_njit
def _copy(p, width, src, dst):
    for j in range(width):
        p[dst + j] = p[src + j]


@inner_njit
def _shortcut(k, p, count, first, last, at, mode, stop, proofs):
    """Simplify a path in the compiled kernel: connect each vertex with the farthest vertex that it can reach
    on a collision-free straight line.

    proofs: prove the lines; otherwise only samples are checked.
    """
    dof = ints(k)[DOF]
    width, i, step = dof + 1, 0, ONE_BLOCK if proofs else SAMPLED
    while i < count - 2 and stop[0] == 0:
        for j in range(count - 1, i + 1, -1):
            if stop[0] != 0:
                break
            first[0], last[0] = i * width, j * width
            if not edge_free(k, p, first[0], last[0], step):
                continue
            if not proofs or prove(k, p, first, last, np.int64(1), at, mode | FIRST, COARSE) == 0:
                gone = j - i - 1
                for row in range(j, count):
                    _copy(p, width, row * width, (row - gone) * width)
                p[i * width + dof] = FREE if proofs else CHANGED
                count -= gone
                break
        i += 1
    return count


@inner_njit
def _round_corners(k, p, count, room, first, last, at, mode, proofs):
    """Round the corners of a path, in the compiled kernel for path simplification.

    A corner stays sharp if the new edges are not free at samples or, with `proofs`, cannot be proven free.

    p: rows, count of them; behind `room` rows there is memory for three times as many tried rows and then
    for the new path. Returns count, changed.
    """
    dof = ints(k)[DOF]
    width, tried = dof + 1, 0
    edge = FREE if proofs else CHANGED
    base = room * width  # triples: midpoint before, corner moved, midpoint after
    for i in range(1, count - 1):
        a, b, c = (i - 1) * width, i * width, (i + 1) * width
        t, change = base + 3 * i * width, 0.0
        for j in range(dof):
            before, after = 0.5 * (p[a + j] + p[b + j]), 0.5 * (p[b + j] + p[c + j])
            corner = 0.5 * p[b + j] + 0.25 * (before + after)
            p[t + j], p[t + width + j], p[t + 2 * width + j] = before, corner, after
            change += (corner - p[b + j]) ** 2
        p[t + dof], p[t + width + dof], p[t + 2 * width + dof] = edge, edge, p[b + dof]
        if change > MIN_CHANGE * MIN_CHANGE:
            first[2 * tried], last[2 * tried] = t, t + width
            first[2 * tried + 1], last[2 * tried + 1] = t + width, t + 2 * width
            tried += 1
    if tried == 0:
        return count, False
    if proofs:
        prove(k, p, first, last, 2 * tried, at, mode, COARSE)
    else:
        for e in range(2 * tried):
            at[e] = PROVEN if edge_free(k, p, first[e], last[e], SAMPLED) else 0.0
    # Write the new path behind the triples, then over the old one.
    out, n, done, changed = base + 3 * count * width, 1, 0, False
    _copy(p, width, 0, out)
    for i in range(1, count - 1):
        t = base + 3 * i * width
        if done < tried and first[2 * done] == t:
            good = at[2 * done] == PROVEN and at[2 * done + 1] == PROVEN
            done += 1
            if good and n + 4 < room:
                changed = True
                if _distance(p, dof, out + (n - 1) * width, t) > 1e-9:
                    _copy(p, width, t, out + n * width)
                    n += 1
                else:
                    p[out + (n - 1) * width + dof] = edge
                _copy(p, width, t + width, out + n * width)
                _copy(p, width, t + 2 * width, out + (n + 1) * width)
                n += 2
                continue
        if n + 2 >= room:
            return count, False
        _copy(p, width, i * width, out + n * width)
        n += 1
    if not changed:
        return count, False
    _copy(p, width, (count - 1) * width, out + n * width)
    n += 1
    for i in range(n):
        _copy(p, width, out + i * width, i * width)
    return n, True


@inner_njit
def _simplified(k, path, count, p, at, first, last, mode, stop, proofs):
    """Simplify a path (path[:count]) in the compiled kernel, write the result to p, and prove its edges.
    Return the new count, or 0 if an edge cannot be proven.
    """
    m, dof = path.shape
    width, length = dof + 1, 1e300
    for i in range(count):
        for j in range(dof):
            p[i * width + j] = path[i, j]
        p[i * width + dof] = ORIGINAL
    for _ in range(ROUNDS):
        count = _shortcut(k, p, count, first, last, at, mode, stop, proofs)
        before, length = length, 0.0
        for i in range(count - 1):
            length += _distance(p, dof, i * width, (i + 1) * width)
        if stop[0] != 0 or count <= 2 or length > (1 - WORTHWHILE) * before:
            break
        count, changed = _round_corners(k, p, count, m, first, last, at, mode, proofs)
        if not changed:
            break
    # Changed edges keep the padding and pass no obstacle closely; edges of the search need only be free.
    for state, how, finest in ((CHANGED, mode | FIRST, COARSE), (ORIGINAL, np.int64(FIRST), FINEST)):
        n = 0
        for i in range(count - 1):
            if p[i * width + dof] == state:
                first[n], last[n] = i * width, (i + 1) * width
                n += 1
        if n > 0 and prove(k, p, first, last, n, at, how, finest) != 0:
            return 0
    return count


@njit(cache=True, nogil=True)
def simplify_path(handle, path, count, space, index, room, mode, stop):
    """Simplify a path (path[:count]) in place, in a compiled kernel: shorten the path and round its corners.

    This compiled kernel proves that every edge of the resulting path is collision-free.

    Args:
        path: (m, dof). space: float64 scratch of 6 m (dof + 1) + 2 m numbers. index: int64 scratch of 4 m.
        room: (dof,) possible deviation of each joint from the edges [rad].
        stop: stop[0] != 0 ends the shortening; set by another thread.
    Returns:
        The new count; 0 if an edge that could not be replaced cannot be proven.
    """
    k, s = pointer(handle), pointer(stop)
    m, dof = path.shape
    p, at, first, last = (
        pointer(space), pointer(space[6 * m * (dof + 1) :]), pointer(index), pointer(index[2 * m :])
    )  # fmt: skip
    deviation_margins(k, pointer(room))
    n = 0
    for proofs in (False, True):
        if n == 0:
            n = _simplified(k, path, count, p, at, first, last, mode, s, proofs)
    for i in range(n):
        for j in range(dof):
            path[i, j] = p[i * (dof + 1) + j]
    return n
