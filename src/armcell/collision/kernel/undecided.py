"""The exact tier: pairs that the covers cannot decide wait here and go to exact convex pieces last.

Last, because another pair of the same block may touch for certain, and then none of this is needed.
"""

# pyright: reportCallIssue=false
# Numba calls intrinsics without their typing context, and splices tuples into compiled calls.
from __future__ import annotations

import numpy as np
from numba import njit

from armcell.collision.kernel import gjk
from armcell.collision.kernel.frames import (
    ALIVE,
    AT_A,
    AT_B,
    AT_RELATIVE,
    ENTRIES,
    MAX_WAITING,
    TOUCHING,
    WAITING,
    frame_at,
    margin_at,
)
from armcell.collision.kernel.layout import (
    BODY_PIECES,
    DOF,
    FRAME,
    PAIR,
    PAIR_REACH,
    PIECE_BALL,
    PIECE_KIND,
    PIECE_POINTS,
    PIECE_POSE,
    PIECE_SIZE,
    POINTS,
    REACH,
    SHAPE_PIECES,
)
from armcell.collision.kernel.simd import L, store, trailing_zeros

EXACT, PADDED, PROVE, FIRST = 1, 2, 4, 8  # bits of `mode`, see `check_block`
SHARE = 0.03  # [m] how far beyond the margin distances are computed: what is known serves other lanes


@njit(cache=True)
def fail(state, lanes, mode):
    """Note that these lanes are not free; True where nothing is left to find out."""
    state[ALIVE] &= ~lanes
    return mode & PROVE == 0 or state[ALIVE] == 0


@njit(cache=True)
def touch(state, lanes, mode):
    """As `fail`, for lanes that touch for certain."""
    state[TOUCHING] |= lanes
    return fail(state, lanes, mode) or mode & FIRST != 0


@njit(cache=True)
def wait(I, D, w, state, s, body, other, lanes, margin, mode):
    """Have the exact tier decide these lanes of a body against world shape `other` (or pair -1 - `other`)."""
    if state[WAITING] == MAX_WAITING and decide(I, D, w, state, s, mode):
        return True
    at = state[WAITING]
    state[WAITING] = at + 1
    state[ENTRIES + 3 * at], state[ENTRIES + 3 * at + 1], state[ENTRIES + 3 * at + 2] = body, other, lanes
    store(w, margin_at(I, at), margin)
    return False


@njit(cache=True)
def decide(I, D, w, state, s, mode):
    """Decide all that waits; True where nothing is left to find out."""
    waiting = state[WAITING]
    state[WAITING] = 0
    for k in range(waiting):
        entry = ENTRIES + 3 * k
        if _exact_lanes(I, D, w, state, s, state[entry], state[entry + 1], state[entry + 2],
                        margin_at(I, k), mode):  # fmt: skip
            return True
    return False


@njit(cache=True)
def _world_piece(I, D, w, e, frame, lane, s, out):
    """World transform (12 numbers at s[out:]) of a body's exact piece in one lane."""
    m = I[PIECE_POSE] + 12 * e
    for i in range(3):
        row = frame + 4 * i * L + lane
        a, b, c, t = w[row], w[row + L], w[row + 2 * L], w[row + 3 * L]
        for j in range(4):
            s[out + 4 * i + j] = a * D[m + j] + b * D[m + 4 + j] + c * D[m + 8 + j]
        s[out + 4 * i + 3] += t


@njit(cache=True)
def _piece_distance(I, D, a, b, enough, s):
    """Distance of piece a at s[AT_A:] to piece b at s[AT_B:] [m]; above `enough` a lower bound."""
    A, B, R = AT_A, AT_B, AT_RELATIVE
    ball_a, ball_b, gap2 = I[PIECE_BALL] + 4 * a, I[PIECE_BALL] + 4 * b, 0.0
    for i in range(3):
        x = s[A + 4 * i + 3] - s[B + 4 * i + 3]
        for j in range(3):
            x += s[A + 4 * i + j] * D[ball_a + j] - s[B + 4 * i + j] * D[ball_b + j]
        gap2 += x * x
    apart = enough + D[ball_a + 3] + D[ball_b + 3]
    if gap2 > apart * apart:
        return np.sqrt(gap2) - D[ball_a + 3] - D[ball_b + 3]
    for i in range(3):
        for j in range(3):
            s[R + 4 * i + j] = s[B + i] * s[A + j] + s[B + 4 + i] * s[A + 4 + j] + s[B + 8 + i] * s[A + 8 + j]
        x, y, z = s[A + 3] - s[B + 3], s[A + 7] - s[B + 7], s[A + 11] - s[B + 11]
        s[R + 4 * i + 3] = s[B + i] * x + s[B + 4 + i] * y + s[B + 8 + i] * z
    ka, kb = I[I[PIECE_KIND] + a], I[I[PIECE_KIND] + b]
    sa, sb = I[PIECE_SIZE] + 3 * a, I[PIECE_SIZE] + 3 * b
    pa, pb = I[PIECE_POINTS] + 2 * a, I[PIECE_POINTS] + 2 * b
    fa, fb = I[POINTS] + 3 * I[pa], I[POINTS] + 3 * I[pb]
    if kb == gjk.HALFSPACE:  # the lowest point of a along the plane's normal
        nx, ny, nz = s[R + 8], s[R + 9], s[R + 10]
        gjk.support(D, ka, sa, fa, I[pa + 1], -nx, -ny, -nz, s, 48)
        return max(nx * s[48] + ny * s[49] + nz * s[50] + s[R + 11], 0.0)
    return gjk.distance(D, R, ka, sa, fa, I[pa + 1], kb, sb, fb, I[pb + 1], enough, s)


@njit(cache=True)
def exact_to_shape(I, D, w, s, body, o, lane, enough):
    """Distance [m] of a body's exact pieces to world shape o in a lane; above `enough` a lower bound."""
    frame, best = frame_at(I, I[I[FRAME] + body]), 1e9
    for a in range(I[I[BODY_PIECES] + body], I[I[BODY_PIECES] + body + 1]):
        _world_piece(I, D, w, a, frame, lane, s, AT_A)
        for b in range(I[I[SHAPE_PIECES] + o], I[I[SHAPE_PIECES] + o + 1]):
            for k in range(12):
                s[AT_B + k] = D[I[PIECE_POSE] + 12 * b + k]
            best = min(best, _piece_distance(I, D, a, b, min(best, enough), s))
            if best <= 0.0:
                return 0.0
    return best


@njit(cache=True)
def exact_pair(I, D, w, s, i, j, lane, enough):
    """Distance [m] of two bodies in a lane by their exact pieces; above `enough` a lower bound."""
    fi, fj, best = frame_at(I, I[I[FRAME] + i]), frame_at(I, I[I[FRAME] + j]), 1e9
    for a in range(I[I[BODY_PIECES] + i], I[I[BODY_PIECES] + i + 1]):
        _world_piece(I, D, w, a, fi, lane, s, AT_A)
        for b in range(I[I[BODY_PIECES] + j], I[I[BODY_PIECES] + j + 1]):
            _world_piece(I, D, w, b, fj, lane, s, AT_B)
            best = min(best, _piece_distance(I, D, a, b, min(best, enough), s))
            if best <= 0.0:
                return 0.0
    return best


@njit(cache=True)
def _exact_lanes(I, D, w, state, s, body, other, lanes, margin, mode):
    """Decide some lanes of one waiting pair; True where nothing is left to find out.

    What is found d apart in one lane is free in every lane that cannot have moved by more than d - margin.
    """
    dof, pair = I[DOF], -1 - other
    reach = I[REACH] + dof * body if other >= 0 else I[PAIR_REACH] + dof * pair
    lanes &= state[ALIVE]
    while lanes != 0:
        lane = trailing_zeros(lanes)
        lanes &= lanes - 1
        need = float(w[margin + lane])
        if other >= 0:
            d = exact_to_shape(I, D, w, s, body, other, lane, need + SHARE)
        else:
            d = exact_pair(I, D, w, s, I[I[PAIR] + 2 * pair], I[I[PAIR] + 2 * pair + 1], lane, need + SHARE)
        if d <= need:
            bit = np.int64(1) << lane
            if touch(state, bit, mode) if d <= 0.0 else fail(state, bit, mode):
                return True
            continue
        rest = lanes
        while rest != 0:
            other_lane = trailing_zeros(rest)
            rest &= rest - 1
            moved = 1e-6
            for c in range(dof):
                moved += abs(w[c * L + other_lane] - w[c * L + lane]) * D[reach + c]
            if moved < d - w[margin + other_lane]:
                lanes &= ~(np.int64(1) << other_lane)
    return False
