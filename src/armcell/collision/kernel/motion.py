"""Motions in the kernel: quickly checked at samples, or proven free between them as well."""

# pyright: reportCallIssue=false
# Numba calls intrinsics without their typing context, and splices tuples into compiled calls.
from __future__ import annotations

import numpy as np
from numba import njit

from armcell.collision.kernel.block import EXACT, PADDED, check_block
from armcell.collision.kernel.layout import BODIES, DOF, PAIR_REACH, PAIRS, REACH
from armcell.collision.kernel.simd import L, fma, iota, pointer, splat, store

MIN_MARGIN = 2e-4
"""[m] Intervals whose motion is below this are not cut further: closer than that counts as touching."""

MAX_DEPTH = 24


@njit(cache=True, forceinline=True)
def spread(I, w, a, b, at, step):
    """16 configurations on the way from a to b (pointers), at fractions at, at + step, ..."""
    t = fma(iota(), splat(step), splat(at))
    for j in range(I[DOF]):
        store(w, j * L, fma(t, splat(b[j] - a[j]), splat(a[j])))


@njit(cache=True)
def edge_free(I, F, D, w, stamps, s, none, none_pair, a, b, step):
    """Whether the straight motion from a to b is free at samples at most `step` [rad] apart, b included.

    The first 16 samples are spread over the whole edge, so a blocked one is mostly found at once.
    """
    length = 0.0
    for j in range(I[DOF]):
        length += (b[j] - a[j]) ** 2
    blocks = max(int(np.ceil(np.sqrt(length) / (L * step))), 1)
    for k in range(blocks):
        spread(I, w, a, b, (1.0 - k / blocks) / L, 1.0 / L)
        if check_block(I, F, D, w, stamps, s, none, none_pair, EXACT | PADDED):
            return False
    return True


@njit(cache=True)
def certify_edge(I, F, D, w, stamps, s, extra, extra_pair, a, b, slack, padded):
    """Fraction of the motion from a to b that is proven free: 2.0 if all of it is, else where it is not.

    Around each of 16 configurations every body is grown by the most that its points can move until halfway
    to the next one; what is free then is free in between. Where that cannot be shown the interval is halved.

    Args:
        extra, extra_pair: room for (bodies,) and (pairs,) float32 margins.
        slack: (dof,) how far each joint may be off the straight line [rad].
        padded: keep the bodies' padding as well, not only clear of contact.
    """
    dof, depth = I[DOF], 0
    mode = EXACT | PADDED if padded else EXACT
    left = np.empty(MAX_DEPTH + 2)
    width = np.empty(MAX_DEPTH + 2)
    left[0], width[0] = 0.0, 1.0
    while depth >= 0:
        t, size = left[depth], width[depth]
        depth -= 1
        half, largest = size / (2 * L), 0.0
        for k in range(I[BODIES]):
            m = 1e-5
            for j in range(dof):
                m += D[I[REACH] + dof * k + j] * (abs(b[j] - a[j]) * half + slack[j])
            largest = max(largest, m)
            extra[k] = np.float32(m)
        for k in range(I[PAIRS]):
            m = 1e-5
            for j in range(dof):
                m += D[I[PAIR_REACH] + dof * k + j] * (abs(b[j] - a[j]) * half + slack[j])
            extra_pair[k] = np.float32(m)
        spread(I, w, a, b, np.float32(t + half), np.float32(2 * half))
        if not check_block(I, F, D, w, stamps, s, extra, extra_pair, mode):
            continue
        # Is it the margin, or does it touch?
        for k in range(I[BODIES]):
            extra[k] = np.float32(0.0)
        for k in range(I[PAIRS]):
            extra_pair[k] = np.float32(0.0)
        spread(I, w, a, b, np.float32(t + half), np.float32(2 * half))
        touching = check_block(I, F, D, w, stamps, s, extra, extra_pair, mode)
        if touching or largest < MIN_MARGIN or depth + 2 > MAX_DEPTH:
            return t + size / 2
        left[depth + 1], width[depth + 1] = t + size / 2, size / 2
        left[depth + 2], width[depth + 2] = t, size / 2
        depth += 2
    return 2.0


@njit(cache=True, nogil=True)
def free_edge(I, F, D, w, stamps, s, extra, extra_pair, a, b, step):
    """`edge_free` on arrays."""
    extra[:] = 0
    extra_pair[:] = 0
    return edge_free(
        pointer(I), pointer(F), pointer(D), pointer(w), pointer(stamps), pointer(s), pointer(extra),
        pointer(extra_pair), pointer(a), pointer(b), step,
    )  # fmt: skip


@njit(cache=True, nogil=True)
def certify_points(I, F, D, w, stamps, s, extra, extra_pair, points, slack, padded):
    """Where on a piecewise linear motion (k, dof) the proof fails, counted in edges; -1.0 if nowhere."""
    for i in range(len(points) - 1):
        t = certify_edge(
            pointer(I), pointer(F), pointer(D), pointer(w), pointer(stamps), pointer(s), pointer(extra),
            pointer(extra_pair), pointer(points[i]), pointer(points[i + 1]), pointer(slack), padded,
        )  # fmt: skip
        if t <= 1.0:
            return i + t
    return -1.0
