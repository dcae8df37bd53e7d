"""Shorter, smoother paths on the kernel; only edges that are proven free are accepted.

Paths are rows of a flat float64 buffer `p`, behind bare pointers; `k` stands for the kernel's eight arrays.
"""

# pyright: reportCallIssue=false
# Numba calls intrinsics without their typing context, and splices tuples into compiled calls.
from __future__ import annotations

import numpy as np
from numba import njit

from armcell.collision.kernel.layout import DOF
from armcell.collision.kernel.motion import FINEST, PROVEN, loosen, prove
from armcell.collision.kernel.simd import pointer

COARSE = 4e-3
"""[rad] Proofs of what is only meant to be shorter stop at intervals of this half width: a shortcut that
needs finer ones passes within a few millimetres of something and is not worth its proof."""

MIN_CHANGE = 0.01  # [rad] smaller moves of a corner are not tried
ROUNDS = 4
WORTHWHILE = 0.02  # a round that shortens the path by less than this share is the last


@njit(cache=True)
def _distance(p, dof, a, b):
    total = 0.0
    for j in range(dof):
        total += (p[b + j] - p[a + j]) ** 2
    return np.sqrt(total)


@njit(cache=True)
def _copy(p, dof, src, dst):
    for j in range(dof):
        p[dst + j] = p[src + j]


@njit(cache=True)
def _shortcut(I, F, D, w, state, s, slack, slack_pair, p, count, first, last, at, mode, stop):
    """Join each vertex with the farthest later one that a proven straight line reaches."""
    dof, i = I[DOF], 0
    while i < count - 2 and stop[0] == 0:
        for j in range(count - 1, i + 1, -1):
            if stop[0] != 0:
                break
            first[0], last[0] = i * dof, j * dof
            if (
                prove(I, F, D, w, state, s, slack, slack_pair, p, first, last, 1, at, mode, COARSE, False)
                == 0
            ):
                gone = j - i - 1
                for k in range(j, count):
                    _copy(p, dof, k * dof, (k - gone) * dof)
                count -= gone
                break
        i += 1
    return count


@njit(cache=True)
def _round_corners(I, F, D, w, state, s, slack, slack_pair, p, count, room, first, last, at, mode):
    """Move corners towards the middle between the midpoints of their edges, where that is proven free.

    p: rows, count of them, and as many again as `room` behind them for what is tried. Returns count, changed.
    """
    dof, tried = I[DOF], 0
    base = room * dof  # triples: midpoint before, corner moved, midpoint after
    for i in range(1, count - 1):
        a, b, c = (i - 1) * dof, i * dof, (i + 1) * dof
        t, change = base + 3 * i * dof, 0.0
        for j in range(dof):
            before, after = 0.5 * (p[a + j] + p[b + j]), 0.5 * (p[b + j] + p[c + j])
            corner = 0.5 * p[b + j] + 0.25 * (before + after)
            p[t + j], p[t + dof + j], p[t + 2 * dof + j] = before, corner, after
            change += (corner - p[b + j]) ** 2
        at[2 * i] = -1.0
        if change > MIN_CHANGE * MIN_CHANGE:
            first[2 * tried], last[2 * tried] = t, t + dof
            first[2 * tried + 1], last[2 * tried + 1] = t + dof, t + 2 * dof
            tried += 1
    if tried == 0:
        return count, False
    prove(I, F, D, w, state, s, slack, slack_pair, p, first, last, 2 * tried, at, mode, COARSE, True)
    # Write the new path behind the triples, then over the old one.
    out, n, k, changed = base + 3 * count * dof, 0, 0, False
    _copy(p, dof, 0, out)
    n = 1
    for i in range(1, count - 1):
        t = base + 3 * i * dof
        moved = k < tried and first[2 * k] == t
        if moved:
            good = at[2 * k] == PROVEN and at[2 * k + 1] == PROVEN
            k += 1
            if good and n + 4 < room:
                changed = True
                if _distance(p, dof, out + (n - 1) * dof, t) > 1e-9:
                    _copy(p, dof, t, out + n * dof)
                    n += 1
                _copy(p, dof, t + dof, out + n * dof)
                _copy(p, dof, t + 2 * dof, out + (n + 1) * dof)
                n += 2
                continue
        _copy(p, dof, i * dof, out + n * dof)
        n += 1
    if not changed or n + 1 > room:
        return count, False
    if _distance(p, dof, out + (n - 1) * dof, (count - 1) * dof) > 1e-9:
        _copy(p, dof, (count - 1) * dof, out + n * dof)
        n += 1
    for i in range(n):
        _copy(p, dof, out + i * dof, i * dof)
    return n, True


@njit(cache=True, nogil=True)
def simplify(I, F, D, w, state, s, slack, slack_pair, path, count, space, index, room, mode, stop):
    """Prove path[:count], then shorten it in place; every edge it returns is proven free.

    Args:
        path: (m, dof). space: float64 scratch of 6 m dof + 2 m numbers. index: int64 scratch
            of 4 m. room: (dof,) how far each joint may be off
            the edges [rad]. stop: stop[0] != 0 ends the shortening; set by another thread.
    Returns:
        The new count; 0 if the path as given cannot be proven.
    """
    Ip, Fp, Dp, wp, tp, sp = pointer(I), pointer(F), pointer(D), pointer(w), pointer(state), pointer(s)
    lp, lq, h = pointer(slack), pointer(slack_pair), pointer(stop)
    m, dof = path.shape
    p, a, f, t = pointer(space), pointer(space[6 * m * dof :]), pointer(index), pointer(index[2 * m :])
    for i in range(count):
        for j in range(dof):
            p[i * dof + j] = path[i, j]
    loosen(Ip, Dp, pointer(room), lp, lq)
    for i in range(count - 1):
        f[i], t[i] = i * dof, (i + 1) * dof
    if prove(Ip, Fp, Dp, wp, tp, sp, lp, lq, p, f, t, count - 1, a, 0, FINEST, False) != 0:
        return 0
    length = 1e300
    for _ in range(ROUNDS):
        count = _shortcut(Ip, Fp, Dp, wp, tp, sp, lp, lq, p, count, f, t, a, mode, h)
        before, length = length, 0.0
        for i in range(count - 1):
            length += _distance(p, dof, i * dof, (i + 1) * dof)
        if h[0] != 0 or count <= 2 or length > (1 - WORTHWHILE) * before:
            break
        count, changed = _round_corners(Ip, Fp, Dp, wp, tp, sp, lp, lq, p, count, m, f, t, a, mode)
        if not changed:
            break
    for i in range(count):
        for j in range(dof):
            path[i, j] = p[i * dof + j]
    return count
