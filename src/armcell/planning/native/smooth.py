"""Shorter, smoother paths on the kernel; only edges that are proven free are accepted."""

# pyright: reportCallIssue=false
# Numba calls intrinsics without their typing context, and splices tuples into compiled calls.
from __future__ import annotations

import numpy as np
from numba import njit

from armcell.collision.kernel.motion import certify_edge, edge_free
from armcell.collision.kernel.simd import pointer


@njit(cache=True, nogil=True)
def certify_path(I, F, D, w, stamps, s, extra, extra_pair, path, count, slack, padded):
    """Whether all edges of path[:count] are proven free."""
    Ip, Fp, Dp, wp, tp, sp = pointer(I), pointer(F), pointer(D), pointer(w), pointer(stamps), pointer(s)
    for i in range(count - 1):
        if certify_edge(Ip, Fp, Dp, wp, tp, sp, pointer(extra), pointer(extra_pair), pointer(path[i]),
                        pointer(path[i + 1]), pointer(slack), padded) <= 1.0:  # fmt: skip
            return False
    return True


@njit(cache=True)
def _proven(I, F, D, w, stamps, s, extra, extra_pair, none, none_pair, a, b, slack, padded, step):
    """First the cheap test that finds most contacts, then the proof."""
    Ip, Fp, Dp, wp, tp, sp = pointer(I), pointer(F), pointer(D), pointer(w), pointer(stamps), pointer(s)
    ap, bp = pointer(a), pointer(b)
    if not edge_free(Ip, Fp, Dp, wp, tp, sp, pointer(none), pointer(none_pair), ap, bp, step):
        return False
    return (
        certify_edge(
            Ip, Fp, Dp, wp, tp, sp, pointer(extra), pointer(extra_pair), ap, bp, pointer(slack), padded
        )
        > 1.0
    )


@njit(cache=True)
def _length(path, i, j):
    total = 0.0
    for k in range(i, j):
        total += np.sqrt(np.sum((path[k + 1] - path[k]) ** 2))
    return total


@njit(cache=True)
def _shortcut(I, F, D, w, stamps, s, extra, extra_pair, none, none_pair, path, count, slack, padded, step):
    """Join each vertex with the farthest later one that a proven straight line reaches."""
    i = 0
    while i < count - 2:
        for j in range(count - 1, i + 1, -1):
            if _proven(
                I,
                F,
                D,
                w,
                stamps,
                s,
                extra,
                extra_pair,
                none,
                none_pair,
                path[i],
                path[j],
                slack,
                padded,
                step,
            ):
                gone = j - i - 1
                for k in range(j, count):
                    path[k - gone] = path[k]
                count -= gone
                break
        i += 1
    return count


@njit(cache=True)
def _cut_corners(
    I, F, D, w, stamps, s, extra, extra_pair, none, none_pair, path, count, slack, padded, step, rng
):
    """Random points on the path joined by proven straight lines."""
    dof = path.shape[1]
    a, b = np.empty(dof), np.empty(dof)
    failures, tries = 0, 0
    while failures < 6 and tries < 24 and count > 2 and count + 2 < len(path):
        tries += 1
        total = _length(path, 0, count - 1)
        rng[0] = (rng[0] * 1103515245 + 12345) % 2147483648
        u = rng[0] / 2147483648.0 * total
        rng[0] = (rng[0] * 1103515245 + 12345) % 2147483648
        v = rng[0] / 2147483648.0 * total
        u, v = min(u, v), max(u, v)
        i, at = 0, 0.0
        while i < count - 2 and at + _length(path, i, i + 1) < u:
            at += _length(path, i, i + 1)
            i += 1
        j, bt = i, at
        while j < count - 2 and bt + _length(path, j, j + 1) < v:
            bt += _length(path, j, j + 1)
            j += 1
        if i == j:
            failures += 1
            continue
        fa = (u - at) / max(_length(path, i, i + 1), 1e-12)
        fb = (v - bt) / max(_length(path, j, j + 1), 1e-12)
        for k in range(dof):
            a[k] = path[i, k] + fa * (path[i + 1, k] - path[i, k])
            b[k] = path[j, k] + fb * (path[j + 1, k] - path[j, k])
        gain = (v - u) - np.sqrt(np.sum((b - a) ** 2))
        if gain < 5e-3 * total or not _proven(
            I, F, D, w, stamps, s, extra, extra_pair, none, none_pair, a, b, slack, padded, step
        ):
            failures += 1
            continue
        failures = 0
        # path[i + 1 .. j] is replaced by a, b: pieces of edges that are proven already.
        move = 2 - (j - i)
        if move > 0:
            for k in range(count - 1, j, -1):
                path[k + move] = path[k]
        elif move < 0:
            for k in range(j + 1, count):
                path[k + move] = path[k]
        path[i + 1] = a
        path[i + 2] = b
        count += move
    return count


@njit(cache=True)
def _spline(I, F, D, w, stamps, s, extra, extra_pair, none, none_pair, path, count, slack, padded, step):
    """One round of B-spline smoothing: midpoints are added, corners move between their neighbours."""
    dof = path.shape[1]
    if 2 * count - 1 > len(path):
        return count, False
    for i in range(count - 1, 0, -1):
        path[2 * i] = path[i]
    count = 2 * count - 1
    for i in range(1, count - 1, 2):
        path[i] = 0.5 * (path[i - 1] + path[i + 1])
    changed, corner = False, np.empty(dof)
    for i in range(2, count - 2, 2):
        corner[:] = 0.25 * path[i - 1] + 0.5 * path[i] + 0.25 * path[i + 1]
        if np.sqrt(np.sum((corner - path[i]) ** 2)) < 5e-3:
            continue
        if _proven(
            I,
            F,
            D,
            w,
            stamps,
            s,
            extra,
            extra_pair,
            none,
            none_pair,
            path[i - 1],
            corner,
            slack,
            padded,
            step,
        ) and _proven(
            I,
            F,
            D,
            w,
            stamps,
            s,
            extra,
            extra_pair,
            none,
            none_pair,
            corner,
            path[i + 1],
            slack,
            padded,
            step,
        ):
            path[i] = corner
            changed = True
    return count, changed


@njit(cache=True, nogil=True)
def smooth(I, F, D, w, stamps, s, extra, extra_pair, none, none_pair, path, count, slack, padded, step, seed):
    """Shorten path[:count] in place; returns the new count. Every edge it makes is proven free.

    Args:
        extra, extra_pair: room for margins. none, none_pair: zeros.
    """
    rng = np.empty(1, np.int64)
    rng[0] = seed
    if count > 2:
        count = _shortcut(
            I, F, D, w, stamps, s, extra, extra_pair, none, none_pair, path, count, slack, padded, step
        )
    if count <= 2:
        return count
    count = _cut_corners(
        I, F, D, w, stamps, s, extra, extra_pair, none, none_pair, path, count, slack, padded, step, rng
    )
    for _ in range(4):
        count, changed = _spline(
            I, F, D, w, stamps, s, extra, extra_pair, none, none_pair, path, count, slack, padded, step
        )
        if not changed:
            break
    return _shortcut(
        I, F, D, w, stamps, s, extra, extra_pair, none, none_pair, path, count, slack, padded, step
    )
