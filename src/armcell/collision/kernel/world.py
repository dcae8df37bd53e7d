"""Bodies against the world: boxes of 16 shapes at a time, bounding spheres, groups, spheres."""

# pyright: reportCallIssue=false
# Numba calls intrinsics without their typing context, and splices tuples into compiled calls.
from __future__ import annotations

import numpy as np
from numba import njit

from armcell.collision.kernel import gjk
from armcell.collision.kernel.frames import (
    ALIVE,
    MAX_STACK,
    STACK,
    bend,
    centre,
    frame_at,
    half_at,
    speed,
)
from armcell.collision.kernel.layout import (
    BODIES,
    BODY_GROUPS,
    BODY_SPHERE,
    BOXES,
    CHILD,
    DOF,
    FRAME,
    GROUP_SPHERE,
    GROUP_SPHERES,
    GROUPS,
    MARGIN,
    OBJECTS,
    PADDING,
    PLANES,
    RATE,
    SHAPE_KIND,
    SHAPE_OBJECT,
    SHAPE_PLANES,
    SHAPE_POSE,
    SHAPE_SIZE,
    SPHERE,
)
from armcell.collision.kernel.simd import (
    L,
    fma,
    hmax,
    hmin,
    load,
    mask_lt,
    splat,
    trailing_zeros,
    vabs,
    vmax,
    vsqrt,
)
from armcell.collision.kernel.undecided import EXACT, PADDED, PROVE, fail, touch, wait

EXACT_BELOW = np.float32(0.008)
"""[m] In a proof, lanes with larger margins than this are cut in halves before the exact tier is asked."""


@njit(cache=True)
def shape_gap(I, F, o, w, at):
    """Distance of the points at w[at:] to world shape o in every lane; a lower bound for cones and meshes."""
    kind, m, size = I[I[SHAPE_KIND] + o], I[SHAPE_POSE] + 12 * o, I[SHAPE_SIZE] + 3 * o
    cx, cy, cz = load(w, at), load(w, at + L), load(w, at + 2 * L)
    zero = splat(np.float32(0.0))
    x = fma(cx, splat(F[m]), fma(cy, splat(F[m + 1]), fma(cz, splat(F[m + 2]), splat(F[m + 3]))))
    y = fma(cx, splat(F[m + 4]), fma(cy, splat(F[m + 5]), fma(cz, splat(F[m + 6]), splat(F[m + 7]))))
    z = fma(cx, splat(F[m + 8]), fma(cy, splat(F[m + 9]), fma(cz, splat(F[m + 10]), splat(F[m + 11]))))
    a, b = splat(F[size]), splat(F[size + 1])
    if kind == gjk.BOX:
        dx, dy = vmax(vabs(x) - a, zero), vmax(vabs(y) - b, zero)
        dz = vmax(vabs(z) - splat(F[size + 2]), zero)
        return vsqrt(fma(dx, dx, fma(dy, dy, dz * dz)))
    if kind == gjk.SPHERE:
        return vsqrt(fma(x, x, fma(y, y, z * z))) - a
    if kind == gjk.CAPSULE:
        dz = vmax(vabs(z) - b, zero)
        return vsqrt(fma(x, x, fma(y, y, dz * dz))) - a
    if kind == gjk.HALFSPACE:
        return z
    if kind == gjk.POINTS:  # the farthest of the hull's planes
        gap = splat(np.float32(-1e9))
        for k in range(I[I[SHAPE_PLANES] + o], I[I[SHAPE_PLANES] + o + 1]):
            n = I[PLANES] + 4 * k
            gap = vmax(
                gap, fma(x, splat(F[n]), fma(y, splat(F[n + 1]), z * splat(F[n + 2]))) - splat(F[n + 3])
            )
        return gap
    r = vsqrt(fma(x, x, y * y))
    if kind == gjk.CYLINDER:
        dr, dz = vmax(r - a, zero), vmax(vabs(z) - b, zero)
        return vsqrt(fma(dr, dr, dz * dz))
    height = b + b  # a cone: the larger of the distances to its base's plane and to its mantle's
    mantle = (r * height + (z - b) * a) / vsqrt(fma(a, a, height * height))
    return vmax(mantle, zero - z - b)


@njit(cache=True, forceinline=True)
def _boxes_hit(I, F, block, lx, ly, lz, hx, hy, hz):
    """Bits of the boxes of a block that meet the box given."""
    at = I[BOXES] + block * 6 * L
    mask = mask_lt(load(F, at), splat(hx)) & mask_lt(load(F, at + L), splat(hy))
    mask &= mask_lt(load(F, at + 2 * L), splat(hz)) & mask_lt(splat(lx), load(F, at + 3 * L))
    return mask & mask_lt(splat(ly), load(F, at + 4 * L)) & mask_lt(splat(lz), load(F, at + 5 * L))


@njit(cache=True)
def _body_to_shape(I, F, D, w, state, s, body, o, room, more, mode):
    """A body against one world shape, from its groups down; True where nothing is left to find out.

    Args:
        room: margins (a vector) of the body's fastest point. more: what a margin has beside the speed.
    """
    f, bodies = I[I[FRAME] + body], I[BODIES]
    frame, first_sphere = frame_at(I, f), bodies + I[GROUPS]
    # The inner ball proves contact only where the gap is no mere lower bound.
    certain = I[I[SHAPE_KIND] + o] != gjk.CONE and I[I[SHAPE_KIND] + o] != gjk.POINTS
    open_lanes, worst = np.int64(0), splat(np.float32(0.0))
    for g in range(I[I[BODY_GROUPS] + body], I[I[BODY_GROUPS] + body + 1]):
        sphere = I[GROUP_SPHERE] + 4 * g
        at = centre(I, F, w, state, bodies + g, frame, sphere)
        gap, radius = shape_gap(I, F, o, w, at), F[sphere + 3]
        if mask_lt(gap, splat(radius) + room) & state[ALIVE] == 0:
            continue
        margin = room
        if mode & PROVE:
            margin = fma(load(w, half_at(I)), speed(I, w, at, radius, f, 0), more)
            if mask_lt(gap, splat(radius) + margin) & state[ALIVE] == 0:
                continue
        near = np.int64(0)
        for k in range(I[I[GROUP_SPHERES] + g], I[I[GROUP_SPHERES] + g + 1]):
            sphere = I[SPHERE] + 5 * k
            at = centre(I, F, w, state, first_sphere + k, frame, sphere)
            gap = shape_gap(I, F, o, w, at)
            lanes = mask_lt(gap, splat(F[sphere + 3]) + margin) & state[ALIVE]
            if lanes == 0:
                continue
            if mode & EXACT == 0:
                if fail(state, lanes, mode):
                    return True
                continue
            if certain and F[sphere + 4] > 0:
                surely = mask_lt(gap, splat(F[sphere + 4])) & lanes
                if surely != 0 and touch(state, surely, mode):
                    return True
                surely = mask_lt(gap, splat(F[sphere + 4]) + margin) & lanes
                if surely != 0 and fail(state, surely, mode):
                    return True
            near |= lanes
        if near != 0:
            if mode & PROVE:
                early = near & mask_lt(splat(EXACT_BELOW), margin)
                if early != 0 and fail(state, early, mode):
                    return True
            open_lanes |= near
            worst = vmax(worst, margin)
    open_lanes &= state[ALIVE]
    return open_lanes != 0 and wait(I, D, w, state, s, body, o, open_lanes, worst, mode)


@njit(cache=True)
def world_block(I, F, D, w, state, s, slack, mode):
    """Bodies against the world; True where nothing is left to find out. See `check_block`.

    Args:
        slack: (bodies,) float32 [m], added to the margins of a proof.
    """
    for body in range(I[BODIES] - 1, -1, -1):  # the tip's bodies first: they touch most often
        f = I[I[FRAME] + body]
        if f == 0:
            continue
        sphere = I[BODY_SPHERE] + 4 * body
        at, radius = centre(I, F, w, state, body, frame_at(I, f), sphere), F[sphere + 3]
        more = splat(np.float32(0.0))
        room = more
        if mode & PROVE:
            more = bend(I, F, w, I[RATE] + I[DOF] * body, slack[body])
            room = fma(load(w, half_at(I)), speed(I, w, at, radius, f, 0), more)
        x, y, z = load(w, at), load(w, at + L), load(w, at + 2 * L)
        r = room + splat(radius + (F[I[PADDING] + body] if mode & PADDED else np.float32(0.0)))
        lx, ly, lz, hx, hy, hz = hmin(x - r), hmin(y - r), hmin(z - r), hmax(x + r), hmax(y + r), hmax(z + r)
        top = 1
        state[STACK] = 0
        while top > 0:
            top -= 1
            block = state[STACK + top]
            hit = _boxes_hit(I, F, block, lx, ly, lz, hx, hy, hz)
            while hit != 0:
                o = I[I[CHILD] + block * L + trailing_zeros(hit)]
                hit &= hit - 1
                if o < 0:  # a block of boxes further down
                    if top < MAX_STACK:  # the tree is built so that it is
                        state[STACK + top] = -o
                        top += 1
                    continue
                pad = F[I[MARGIN] + I[OBJECTS] * body + I[I[SHAPE_OBJECT] + o]]
                if pad < 0.0 or mask_lt(shape_gap(I, F, o, w, at), r) & state[ALIVE] == 0:
                    continue
                extra = splat(pad if mode & PADDED else np.float32(0.0))
                if _body_to_shape(I, F, D, w, state, s, body, o, room + extra, more + extra, mode):
                    return True
    return False
