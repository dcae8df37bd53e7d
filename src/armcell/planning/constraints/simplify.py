"""Shortening and smoothing of paths on the constraint manifold (Numba).

Every shortcut is proven. Paths are rows of a flat float64 buffer `p`, behind a bare pointer.
"""

# pyright: reportCallIssue=false
# Numba calls intrinsics without their typing context, and splices tuples into compiled calls.
from __future__ import annotations

import numpy as np
from numba import njit

from armcell.collision.kernel.block import FIRST, PADDED
from armcell.collision.kernel.motion import FINEST, PROVEN, deviation_margins, prove
from armcell.collision.kernel.simd import pointer
from armcell.planning.constraints.error_kernels import DOF, manifold_pointers
from armcell.planning.constraints.projection import project
from armcell.planning.constraints.proof import edge_keeps_tolerances
from armcell.planning.constraints.rrt_connect import Steps, walk
from armcell.planning.planners.native.simplify import COARSE

SHORTER = 0.97  # largest length ratio of a shortcut to the part that it replaces
ROUNDS = 3
SWEEPS = 16


@njit(cache=True)
def _length(p, dof, first, last):
    total = 0.0
    for i in range(first, last):
        step = 0.0
        for j in range(dof):
            step += (p[(i + 1) * dof + j] - p[i * dof + j]) ** 2
        total += np.sqrt(step)
    return total


@njit(cache=True)
def _shortcuts(k, n, c, x, p, count, tried, f, t, at, rules, stop):
    """Simplify a path under constraints by shortcuts that are projected onto the constraints. Long parts of
    the path are replaced first, shorter parts later.

    p[tried:] is the walk's buffer.
    """
    dof = n[DOF]
    gap = count - 1
    while gap >= 2 and stop[0] == 0:
        i = 0
        while i + 2 < count:
            j = min(i + gap, count - 1)
            if j - i < 2:
                break
            for d in range(dof):
                p[tried + d] = p[i * dof + d]
                p[tried + dof + d] = p[j * dof + d]
            rows, reached = walk(k, n, c, x, p, tried, tried + dof, tried + 2 * dof, j - i + 1, rules, stop)
            good = False
            rows -= 1  # the last row is row j itself
            if reached and rows <= j - i - 1:
                for d in range(dof):
                    p[tried + dof + d] = p[tried + d]
                if _length(p, dof, tried // dof + 1, tried // dof + 2 + rows) < SHORTER * _length(
                    p, dof, i, j
                ):
                    for e in range(rows + 1):
                        f[e], t[e] = tried + (1 + e) * dof, tried + (2 + e) * dof
                    good = prove(k, p, f, t, rows + 1, at, np.int64(FIRST | PADDED), COARSE) == 0
            if good:
                for r in range(rows):
                    for d in range(dof):
                        p[(i + 1 + r) * dof + d] = p[tried + (2 + r) * dof + d]
                gone = j - i - 1 - rows
                if gone > 0:
                    for r in range(j * dof, count * dof):
                        p[r - gone * dof] = p[r]
                    count -= gone
                i += rows + 1
            else:
                i += max(gap // 2, 1)
        gap //= 2
    return count


@njit(cache=True)
def _sweep(k, n, c, x, p, count, tried, f, t, at, rules):
    """Smooth a path under constraints: move each inner waypoint toward the midpoint of its two neighbors if
    the new edges are proven valid.

    Return the number of moved rows.
    """
    dof = n[DOF]
    for r in range(count * dof):
        p[tried + r] = p[r]
    for i in range(1, count - 1):
        row = tried + i * dof
        for d in range(dof):
            p[row + d] = 0.5 * p[i * dof + d] + 0.25 * (p[(i - 1) * dof + d] + p[(i + 1) * dof + d])
        if not project(n, c, x, p, row, rules.lower, rules.upper):
            for d in range(dof):
                p[row + d] = p[i * dof + d]
    while True:  # undo invalid moves until the remaining ones are valid
        for e in range(count - 1):
            f[e], t[e] = tried + e * dof, tried + (e + 1) * dof
        prove(k, p, f, t, count - 1, at, np.int64(PADDED), COARSE)
        back = 0
        for e in range(count - 1):
            if at[e] == PROVEN and edge_keeps_tolerances(
                n, c, x, p, f[e], t[e], rules.zeros, rules.allowance
            ):
                continue
            for i in range(max(e, 1), min(e + 2, count - 1)):
                moved = False
                for d in range(dof):
                    moved = moved or p[tried + i * dof + d] != p[i * dof + d]
                    p[tried + i * dof + d] = p[i * dof + d]
                back += moved
        if back == 0:
            break
    moved = 0
    for i in range(1, count - 1):
        change = False
        for d in range(dof):
            change = change or p[tried + i * dof + d] != p[i * dof + d]
            p[i * dof + d] = p[tried + i * dof + d]
        moved += change
    return moved


@njit(cache=True, nogil=True)
def shorten(handle, constraints, path, count, space, index, rules, stop):
    """Shorten and smooth a path (path[:count]) on the constraint manifold, in place.

    Args:
        path: (m, dof). space: float64 scratch of 2 m + 8 rows and m numbers. index: int64 scratch of 2 m.
        rules: see `Steps`, with arrays.
    Returns:
        The new count; 0 if an edge cannot be proven free or within the constraints.
    """
    k, (n, c, x) = pointer(handle), manifold_pointers(constraints)
    m, dof = path.shape
    p, at, f, t = pointer(space), pointer(space[(2 * m + 8) * dof :]), pointer(index), pointer(index[m:])
    halt = pointer(stop)
    rules = Steps(
        pointer(rules.lower), pointer(rules.upper), pointer(rules.zeros), rules.delta, rules.step,
        rules.allowance, True,
    )  # fmt: skip
    for i in range(count):
        for j in range(dof):
            p[i * dof + j] = path[i, j]
    deviation_margins(k, rules.zeros)
    tried = m * dof
    length = _length(p, dof, 0, count - 1)
    for _ in range(ROUNDS):
        before = length
        count = _shortcuts(k, n, c, x, p, count, tried, f, t, at, rules, halt)
        length = _length(p, dof, 0, count - 1)
        if halt[0] != 0 or length > SHORTER * before:
            break
    for _ in range(SWEEPS):
        if halt[0] != 0 or _sweep(k, n, c, x, p, count, tried, f, t, at, rules) == 0:
            break
    for e in range(count - 1):
        f[e], t[e] = e * dof, (e + 1) * dof
        if not edge_keeps_tolerances(n, c, x, p, f[e], t[e], rules.zeros, rules.allowance):
            return 0
    if prove(k, p, f, t, count - 1, at, np.int64(FIRST), FINEST) != 0:
        return 0
    for i in range(count):
        for j in range(dof):
            path[i, j] = p[i * dof + j]
    return count
