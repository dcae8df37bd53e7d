"""Kernel tests of body pairs: bounding spheres, groups that can come near, single spheres."""

# pyright: reportCallIssue=false
# Numba calls intrinsics without their typing context, and splices tuples into compiled calls.
from __future__ import annotations

import numpy as np

from armcell._inner_njit import inner_njit
from armcell.collision.kernel import gjk
from armcell.collision.kernel.exact_checks import queue_exact_test
from armcell.collision.kernel.frames import (
    ALIVE,
    EXACT,
    PROVE,
    body_margin_at,
    center,
    center_at,
    interval_half_width_at,
    motion_margin,
    velocity_at,
)
from armcell.collision.kernel.layout import (
    BODIES,
    BODY_SPHERE,
    DOF,
    FRAME,
    GROUP_SPHERE,
    GROUP_SPHERES,
    GROUPS,
    MEET,
    MEET_GROUPS,
    NEAR,
    NEAR_GROUPS,
    PAIR,
    PAIR_MARGIN,
    PAIR_RATE,
    PAIRS,
    SPHERE,
)
from armcell.collision.kernel.record_result import record_collision, record_contact
from armcell.collision.kernel.simd import L, fma, load, mask_lt, splat, vabs, vsqrt

DONE = np.int64(-1)


@inner_njit(forceinline=True)
def _near(I, w, state, i, j, radii, more, mode):
    """Return a bit mask of the SIMD lanes in which two balls may overlap.
    Each ball encloses one body of a pair.

    In a proof, the balls are clear if their distance, shrinking at its rate (the relative velocity along the
    connecting line), lasts for half the interval; the distance of two points is a convex function of either
    point.
    """
    a, b = center_at(I, i), center_at(I, j)
    dx, dy = load(w, a) - load(w, b), load(w, a + L) - load(w, b + L)
    dz = load(w, a + 2 * L) - load(w, b + 2 * L)
    apart2, need = fma(dx, dx, fma(dy, dy, dz * dz)), splat(radii) + more
    if mode & PROVE == 0:
        return mask_lt(apart2, need * need) & state[ALIVE]
    u, v, half = velocity_at(I, i), velocity_at(I, j), load(w, interval_half_width_at(I))
    apart = vsqrt(apart2 + splat(np.float32(1e-12)))
    rate = dx * (load(w, u) - load(w, v))
    rate = fma(dy, load(w, u + L) - load(w, v + L), rate)
    rate = fma(dz, load(w, u + 2 * L) - load(w, v + 2 * L), rate)
    return mask_lt(apart, fma(half, vabs(rate) / apart, need)) & state[ALIVE]


@inner_njit(forceinline=True)
def _far(I, F, w, state, i, j, radii):
    """Return whether a cheap test of a body pair shows in all SIMD lanes that the two bodies do not touch.

    The test ignores the directions of motion.
    """
    a, b = center_at(I, i), center_at(I, j)
    dx, dy = load(w, a) - load(w, b), load(w, a + L) - load(w, b + L)
    dz = load(w, a + 2 * L) - load(w, b + 2 * L)
    need, half = splat(radii), load(w, interval_half_width_at(I))
    for body in (i, j):
        if I[I[FRAME] + body] > 0:
            need = fma(half, load(w, velocity_at(I, body) + 3 * L), need + load(w, body_margin_at(I, body)))
    return mask_lt(fma(dx, dx, fma(dy, dy, dz * dz)), need * need) & state[ALIVE] == 0


@inner_njit
def _groups_of_pair(I, F, w, state, s, g, h, f, e, more, close, mode):
    """Test each sphere of one group against each sphere of another, for a pair of bodies.
    Return a bit mask of the SIMD lanes in which spheres may touch, or DONE if the check can stop early.

    The groups are g and h. Lanes are bits. Spheres whose inner balls are at most `close` apart are certainly
    too near.
    """
    first_group, first_sphere, near = I[BODIES], I[BODIES] + I[GROUPS], np.int64(0)
    sh = I[GROUP_SPHERE] + 4 * h
    for k in range(I[I[GROUP_SPHERES] + g], I[I[GROUP_SPHERES] + g + 1]):
        sk = I[SPHERE] + 5 * k
        center(I, F, w, state, first_sphere + k, f, sk, mode)
        if _near(I, w, state, first_sphere + k, first_group + h, F[sk + 3] + F[sh + 3], more, mode) == 0:
            continue
        for m in range(I[I[GROUP_SPHERES] + h], I[I[GROUP_SPHERES] + h + 1]):
            sm = I[SPHERE] + 5 * m
            center(I, F, w, state, first_sphere + m, e, sm, mode)
            hit = _near(I, w, state, first_sphere + k, first_sphere + m, F[sk + 3] + F[sm + 3], more, mode)
            if hit == 0:
                continue
            if mode & EXACT:
                surely = hit & _near(
                    I,
                    w,
                    state,
                    first_sphere + k,
                    first_sphere + m,
                    F[sk + 4] + F[sm + 4],
                    splat(close),
                    np.int64(EXACT),
                )
                if surely != 0 and record_contact(state, surely, mode):
                    return DONE
            near |= hit
    return near


@inner_njit
def _pair_of_bodies(I, F, D, w, state, s, slack, slack_pair, pair, more, close, mode):
    i, j = I[I[PAIR] + 2 * pair], I[I[PAIR] + 2 * pair + 1]
    f, e, bodies = I[I[FRAME] + i], I[I[FRAME] + j], I[BODIES]
    sj, open_lanes = I[BODY_SPHERE] + 4 * j, np.int64(0)
    for a in range(I[I[NEAR] + pair], I[I[NEAR] + pair + 1]):
        g = I[I[NEAR_GROUPS] + a]
        sg = I[GROUP_SPHERE] + 4 * g
        center(I, F, w, state, bodies + g, f, sg, mode)
        if _near(I, w, state, bodies + g, j, F[sg + 3] + F[sj + 3], more, mode) == 0:
            continue
        for b in range(I[I[MEET] + a], I[I[MEET] + a + 1]):
            h = I[I[MEET_GROUPS] + b]
            sh = I[GROUP_SPHERE] + 4 * h
            center(I, F, w, state, bodies + h, e, sh, mode)
            if _near(I, w, state, bodies + g, bodies + h, F[sg + 3] + F[sh + 3], more, mode) == 0:
                continue
            near = _groups_of_pair(I, F, w, state, s, g, h, f, e, more, close, mode)
            if near == DONE:
                return True
            if near != 0 and mode & EXACT == 0 and record_collision(state, near, mode):
                return True
            open_lanes |= near
    open_lanes &= state[ALIVE]
    return (
        mode & EXACT != 0
        and open_lanes != 0
        and queue_exact_test(I, F, D, w, state, s, slack, slack_pair, i, -1 - pair, open_lanes, mode)
    )


@inner_njit
def pairs_block(I, F, D, w, state, s, slack, slack_pair, mode):
    """Test all pairs of robot bodies against each other in 16 SIMD lanes.
    Return True if no further test is needed.

    See `_check_arrays`.
    """
    for pair in range(I[PAIRS]):
        i, j = I[I[PAIR] + 2 * pair], I[I[PAIR] + 2 * pair + 1]
        si, sj = I[BODY_SPHERE] + 4 * i, I[BODY_SPHERE] + 4 * j
        center(I, F, w, state, i, I[I[FRAME] + i], si, mode)
        center(I, F, w, state, j, I[I[FRAME] + j], sj, mode)
        margin = F[I[PAIR_MARGIN] + pair]
        more = splat(margin)
        if mode & PROVE:
            if _far(I, F, w, state, i, j, F[si + 3] + F[sj + 3] + margin + slack_pair[pair]):
                continue
            more = more + motion_margin(I, F, w, I[PAIR_RATE] + I[DOF] * pair, slack_pair[pair])
        if _near(I, w, state, i, j, F[si + 3] + F[sj + 3], more, mode) == 0:
            continue
        close = max(np.float32(s[gjk.CLOSE]), margin)
        if _pair_of_bodies(I, F, D, w, state, s, slack, slack_pair, pair, more, close, mode):
            return True
    return False
