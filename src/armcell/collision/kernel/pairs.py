"""Bodies against each other: bounding spheres, then the groups that can come near, then spheres."""

# pyright: reportCallIssue=false
# Numba calls intrinsics without their typing context, and splices tuples into compiled calls.
from __future__ import annotations

import numpy as np
from numba import njit

from armcell.collision.kernel.frames import (
    ALIVE,
    bend,
    centre,
    frame_at,
    half_at,
    speed,
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
    PAIR_RATE,
    PAIRS,
    SPHERE,
)
from armcell.collision.kernel.simd import L, fma, load, mask_lt, splat, vmax, vmin
from armcell.collision.kernel.undecided import EXACT, PROVE, fail, touch, wait
from armcell.collision.kernel.world import EXACT_BELOW

DONE = np.int64(-1)


@njit(cache=True, forceinline=True)
def _apart2(w, a, b):
    """Squared distance between two kept centres."""
    dx, dy = load(w, a) - load(w, b), load(w, a + L) - load(w, b + L)
    dz = load(w, a + 2 * L) - load(w, b + 2 * L)
    return fma(dx, dx, fma(dy, dy, dz * dz))


@njit(cache=True, forceinline=True)
def _square(r):
    return r * r


@njit(cache=True)
def _groups_of_pair(I, F, w, state, g, h, fi, fj, margin, mode):
    """Spheres of group g against those of group h: the lanes (bits) where covers touch, or DONE."""
    first_group, first_sphere = I[BODIES], I[BODIES] + I[GROUPS]
    sh = I[GROUP_SPHERE] + 4 * h
    ah, near = centre(I, F, w, state, first_group + h, fj, sh), np.int64(0)
    for k in range(I[I[GROUP_SPHERES] + g], I[I[GROUP_SPHERES] + g + 1]):
        sk = I[SPHERE] + 5 * k
        ak = centre(I, F, w, state, first_sphere + k, fi, sk)
        if mask_lt(_apart2(w, ak, ah), _square(splat(F[sk + 3] + F[sh + 3]) + margin)) & state[ALIVE] == 0:
            continue
        for m in range(I[I[GROUP_SPHERES] + h], I[I[GROUP_SPHERES] + h + 1]):
            sm = I[SPHERE] + 5 * m
            apart = _apart2(w, ak, centre(I, F, w, state, first_sphere + m, fj, sm))
            hit = mask_lt(apart, _square(splat(F[sk + 3] + F[sm + 3]) + margin)) & state[ALIVE]
            if hit == 0:
                continue
            if mode & EXACT:
                surely = mask_lt(apart, _square(splat(F[sk + 4] + F[sm + 4]))) & hit
                if surely != 0 and touch(state, surely, mode):
                    return DONE
            near |= hit
    return near


@njit(cache=True)
def _pair_of_bodies(I, F, D, w, state, s, pair, room, more, mode):
    i, j = I[I[PAIR] + 2 * pair], I[I[PAIR] + 2 * pair + 1]
    f, e, bodies = I[I[FRAME] + i], I[I[FRAME] + j], I[BODIES]
    fi, fj = frame_at(I, f), frame_at(I, e)
    sj, open_lanes, worst = I[BODY_SPHERE] + 4 * j, np.int64(0), splat(np.float32(0.0))
    aj = centre(I, F, w, state, j, fj, sj)
    for a in range(I[I[NEAR] + pair], I[I[NEAR] + pair + 1]):
        g = I[I[NEAR_GROUPS] + a]
        sg = I[GROUP_SPHERE] + 4 * g
        ag = centre(I, F, w, state, bodies + g, fi, sg)
        if mask_lt(_apart2(w, ag, aj), _square(splat(F[sg + 3] + F[sj + 3]) + room)) & state[ALIVE] == 0:
            continue
        for b in range(I[I[MEET] + a], I[I[MEET] + a + 1]):
            h = I[I[MEET_GROUPS] + b]
            sh = I[GROUP_SPHERE] + 4 * h
            ah = centre(I, F, w, state, bodies + h, fj, sh)
            apart, radii, margin = _apart2(w, ag, ah), splat(F[sg + 3] + F[sh + 3]), room
            if mask_lt(apart, _square(radii + margin)) & state[ALIVE] == 0:
                continue
            if mode & PROVE:  # seen from either body, the slower of both views
                fastest = vmin(speed(I, w, ag, F[sg + 3], f, e), speed(I, w, ah, F[sh + 3], e, f))
                margin = fma(load(w, half_at(I)), fastest, more)
                if mask_lt(apart, _square(radii + margin)) & state[ALIVE] == 0:
                    continue
            near = _groups_of_pair(I, F, w, state, g, h, fi, fj, margin, mode)
            if near == 0:
                continue
            if near == DONE:
                return True
            if mode & EXACT == 0:
                if fail(state, near, mode):
                    return True
                continue
            if mode & PROVE:
                early = near & mask_lt(splat(EXACT_BELOW), margin)
                if early != 0 and fail(state, early, mode):
                    return True
            open_lanes |= near
            worst = vmax(worst, margin)
    open_lanes &= state[ALIVE]
    return open_lanes != 0 and wait(I, D, w, state, s, i, -1 - pair, open_lanes, worst, mode)


@njit(cache=True)
def pairs_block(I, F, D, w, state, s, slack, mode):
    """Pairs of bodies; True where nothing is left to find out. See `check_block`.

    Args:
        slack: (pairs,) float32 [m], added to the margins of a proof.
    """
    for pair in range(I[PAIRS]):
        i, j = I[I[PAIR] + 2 * pair], I[I[PAIR] + 2 * pair + 1]
        si, sj = I[BODY_SPHERE] + 4 * i, I[BODY_SPHERE] + 4 * j
        f, e = I[I[FRAME] + i], I[I[FRAME] + j]
        ai = centre(I, F, w, state, i, frame_at(I, f), si)
        aj = centre(I, F, w, state, j, frame_at(I, e), sj)
        more = splat(np.float32(0.0))
        room = more
        apart, radii = _apart2(w, ai, aj), splat(F[si + 3] + F[sj + 3])
        if mode & PROVE:
            more = bend(I, F, w, I[PAIR_RATE] + I[DOF] * pair, slack[pair])
            fastest = vmin(speed(I, w, ai, F[si + 3], f, e), speed(I, w, aj, F[sj + 3], e, f))
            room = fma(load(w, half_at(I)), fastest, more)
        if mask_lt(apart, _square(radii + room)) & state[ALIVE] == 0:
            continue
        if _pair_of_bodies(I, F, D, w, state, s, pair, room, more, mode):
            return True
    return False
