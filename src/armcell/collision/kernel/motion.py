"""Collision checks of motions in the kernel: at samples, or as proofs, also of distances between bodies."""

from __future__ import annotations

import numpy as np
from numba import njit

from armcell._inner_njit import inner_njit
from armcell.collision.kernel import gjk
from armcell.collision.kernel.block import (
    AT_D,
    AT_S,
    AT_SLACK,
    AT_SLACK_PAIR,
    AT_STATE,
    EVERY,
    EXACT,
    FIRST,
    PADDED,
    PROVE,
    check_block,
    ints,
    lanes_of,
)
from armcell.collision.kernel.pack import BODIES, DOF, PAIR_REACH, PAIRS, REACH
from armcell.collision.kernel.simd import L, at_address, fma, iota, pointer, splat, store
from armcell.collision.kernel.workspace import TOUCHING, interval_half_width_at, rate_at

# pyright: reportCallIssue=false
# Numba calls intrinsics without their typing context, and splices tuples into compiled calls.


FINEST = 1e-4
"""[rad] Shorter half intervals are not divided: a distance below their motion counts as contact."""

WIDEST = 0.12
"""[rad] Initial length of a proof's intervals, if 16 of them are enough for the edge."""

CERTAIN = np.float32(1e-5)
"""[m] Margin for float32 rounding in every proof."""

PROVEN = 2.0
ROOM = 2048  # capacity of a proof's stack of intervals


@inner_njit(forceinline=True)
def fill_lanes(I, w, p, a, b, at, step):
    """Fill the 16 SIMD lanes with evenly spaced configurations on one edge of a motion, for a collision
    check.

    The edge leads from p[a:] to p[b:]; the fractions of the edge are at, at + step, ...
    """
    t = fma(iota(), splat(step), splat(at))
    for j in range(I[DOF]):
        store(w, j * L, fma(t, splat(p[b + j] - p[a + j]), splat(p[a + j])))


@inner_njit
def edge_free(k, p, a, b, step):
    """Return whether one edge of a motion is collision-free at samples at most `step` [rad] apart.

    The edge leads from p[a:] to p[b:]. The end b is included. The first 16 samples are spread over the whole
    edge, so a blocked edge is usually found at once.
    """
    I, w, length = ints(k), lanes_of(k), 0.0
    for j in range(I[DOF]):
        length += (p[b + j] - p[a + j]) ** 2
    blocks = max(int(np.ceil(np.sqrt(length) / (L * step))), 1)
    for n in range(blocks):
        fill_lanes(I, w, p, a, b, (1.0 - n / blocks) / L, 1.0 / L)
        if check_block(k, EVERY, np.int64(EXACT | PADDED)) != 0:
            return False
    return True


@inner_njit
def prove(k, p, first, last, count, at, mode, finest):
    """Prove in the kernel that the straight edges of a motion are collision-free.
    Return how many edges could not be proven.

    Each edge is divided into intervals. Every body is enlarged, around the middle of an interval, by the
    largest motion of its points in half the interval; if the enlarged bodies are free, the interval is free.
    Otherwise the interval is halved. Sixteen intervals, of any edges, are checked together.

    Args:
        p: configurations; edge e leads from p[first[e]:] to p[last[e]:].
        at: output (count,): PROVEN, or the fraction of the edge where the proof failed.
        mode: PADDED, and FIRST to stop at the first edge that fails. finest: [rad], see FINEST.
    """
    I, w, state = ints(k), lanes_of(k), at_address(np.int64, k[AT_STATE])
    dof, bad, edge, waiting = I[DOF], 0, 0, 0
    which, middle, half = np.empty(ROOM, np.int64), np.empty(ROOM), np.empty(ROOM)
    for e in range(count):
        at[e] = PROVEN
    mode |= EXACT | PROVE
    while True:
        while waiting < L and edge < count:
            length = 0.0
            for j in range(dof):
                length += (p[last[edge] + j] - p[first[edge] + j]) ** 2
            n = min(max(int(np.ceil(np.sqrt(length) / WIDEST)), 1), L)
            for i in range(n):
                which[waiting], middle[waiting], half[waiting] = edge, (i + 0.5) / n, 0.5 / n
                waiting += 1
            edge += 1
        n = 0
        begin = waiting
        while n < L and begin > 0:  # take the newest intervals; drop those of failed edges
            begin -= 1
            if at[which[begin]] != PROVEN:
                continue
            # The taken intervals are stored from the end of the buffer downward.
            slot = ROOM - 1 - n
            which[slot], middle[slot], half[slot] = which[begin], middle[begin], half[begin]
            n += 1
        waiting = begin
        if n == 0:
            if edge >= count:
                return bad
            continue
        for lane in range(L):
            slot = ROOM - 1 - (lane if lane < n else 0)
            a, b, t = first[which[slot]], last[which[slot]], middle[slot]
            for j in range(dof):
                rate = p[b + j] - p[a + j]
                w[j * L + lane] = np.float32(p[a + j] + t * rate)
                w[rate_at(I, j) + lane] = np.float32(rate)
            w[interval_half_width_at(I) + lane] = np.float32(half[slot])
        lanes = (np.int64(1) << n) - 1
        left = check_block(k, lanes, np.int64(mode))
        if left == 0:
            continue
        for lane in range(n):
            if left & (np.int64(1) << lane) == 0:
                continue
            slot = ROOM - 1 - lane
            e = which[slot]
            if at[e] != PROVEN:
                continue
            length = 0.0
            for j in range(dof):
                length = max(length, abs(p[last[e] + j] - p[first[e] + j]))
            t, h = middle[slot], half[slot] / 2
            if state[TOUCHING] & (np.int64(1) << lane) or h * length < finest or waiting + 2 * L > ROOM - L:
                at[e] = t
                bad += 1
                if mode & FIRST:
                    return bad
                continue
            which[waiting], middle[waiting], half[waiting] = e, t + h, h
            which[waiting + 1], middle[waiting + 1], half[waiting + 1] = e, t - h, h
            waiting += 2


@inner_njit
def deviation_margins(k, room):
    """For a motion proof in the kernel, compute how far [m] each body and each pair of bodies can deviate
    from the motion, given the largest deviation of each joint.

    The deviations are room (dof,).
    """
    I, D = ints(k), at_address(np.float64, k[AT_D])
    slack, slack_pair = at_address(np.float32, k[AT_SLACK]), at_address(np.float32, k[AT_SLACK_PAIR])
    dof = I[DOF]
    for b in range(I[BODIES]):
        m = 0.0
        for j in range(dof):
            m += D[I[REACH] + dof * b + j] * room[j]
        slack[b] = np.float32(m) + CERTAIN
    for b in range(I[PAIRS]):
        m = 0.0
        for j in range(dof):
            m += D[I[PAIR_REACH] + dof * b + j] * room[j]
        slack_pair[b] = np.float32(m) + CERTAIN


@njit(cache=True, nogil=True)
def check_edge(handle, ends, step):
    """Return whether the straight motion in joint space between two
    configurations `ends` (2, dof) is collision-free.

    See `edge_free`.
    """
    return edge_free(pointer(handle), pointer(ends), 0, ends.shape[1], step)


@njit(cache=True, nogil=True)
def prove_points(handle, points, room, distance, mode):
    """Prove that a piecewise linear motion (k, dof) is collision-free.
    Return the point of the path at which the proof fails, or -1.0 if the proof succeeds.

    The point is counted in edges from the start: 2.5 is the middle of the third edge.

    Args:
        room: (dof,) largest deviation of each joint from the edges [rad or m].
        distance: [m] clearance of every body from the bodies and objects that it must not touch.
    """
    k, (n, dof) = pointer(handle), points.shape
    I, s = ints(k), at_address(np.float64, k[AT_S])
    slack, slack_pair = at_address(np.float32, k[AT_SLACK]), at_address(np.float32, k[AT_SLACK_PAIR])
    rows, at = np.arange(n) * dof, np.empty(n)  # used after the call, to stay alive
    deviation_margins(k, pointer(room))
    for b in range(I[BODIES]):
        slack[b] += np.float32(distance)
    for b in range(I[PAIRS]):
        slack_pair[b] += np.float32(distance)
    s[gjk.CLOSE] = distance
    prove(
        k,
        pointer(points),
        pointer(rows),
        pointer(rows[1:]),
        n - 1,
        pointer(at),
        np.int64(mode | FIRST),
        FINEST,
    )
    s[gjk.CLOSE] = 0.0
    for e in range(n - 1):
        if at[e] != PROVEN:
            return rows[e] / dof + at[e]
    return -1.0


@njit(cache=True, nogil=True)
def proven_clearance(handle, points, most, tolerance):
    """Find the largest clearance [m] that the kernel can prove for a motion (k, dof), by bisection.

    The result is at most `most`, never above the true minimum distance, and below it by about `tolerance` or
    less.
    """
    k, (n, dof) = pointer(handle), points.shape
    I, s = ints(k), at_address(np.float64, k[AT_S])
    slack, slack_pair = at_address(np.float32, k[AT_SLACK]), at_address(np.float32, k[AT_SLACK_PAIR])
    rows, at = np.arange(n) * dof, np.empty(n)
    low, high, trial = 0.0, most, most
    while high - low > tolerance:
        for b in range(I[BODIES]):
            slack[b] = np.float32(trial) + CERTAIN
        for b in range(I[PAIRS]):
            slack_pair[b] = np.float32(trial) + CERTAIN
        s[gjk.CLOSE] = trial
        bad = prove(
            k, pointer(points), pointer(rows), pointer(rows[1:]), n - 1, pointer(at), np.int64(FIRST),
            0.5 * tolerance,
        )  # fmt: skip
        if bad == 0:
            low = trial
        else:
            high = trial
        trial = 0.5 * (low + high)
    s[gjk.CLOSE] = 0.0
    return low + 0.0 * (rows[0] + at[0])  # used here, so that both stay alive


# Numba calls intrinsics without their typing context, and splices tuples into compiled calls.


@njit(cache=True, nogil=True)
def first_below_clearance(handle, points, room, distance):
    """Return the first position along a motion (k, dof) at which the kernel cannot prove the clearance of two
    bodies of the robot.

    Args:
        room: (dof,) largest deviation of each joint from the edges [rad or m].
        distance: clearance between two bodies [m].
    Returns:
        The position counted in edges, or -1.0 if the clearance is proven on the whole motion.
    """
    k, (n, dof) = pointer(handle), points.shape
    I, s = ints(k), at_address(np.float64, k[AT_S])
    slack_pair = at_address(np.float32, k[AT_SLACK_PAIR])
    rows, at = np.arange(n) * dof, np.empty(n)  # used after the call, to stay alive
    deviation_margins(k, pointer(room))
    for b in range(I[PAIRS]):
        slack_pair[b] += np.float32(distance)
    s[gjk.CLOSE] = distance
    prove(
        k, pointer(points), pointer(rows), pointer(rows[1:]), n - 1, pointer(at), np.int64(FIRST), FINEST
    )  # fmt: skip
    s[gjk.CLOSE] = 0.0
    for e in range(n - 1):
        if at[e] != PROVEN:
            return rows[e] / dof + at[e]
    return -1.0
