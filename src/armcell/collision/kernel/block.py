"""Sixteen configurations at once: forward kinematics and the question "does it touch?".

The hierarchy, outside in: a body's bounding sphere against the boxes of 16 world shapes at a time, the
bounding sphere against the shape, groups of at most 8 spheres, spheres. A sphere's outer radius decides
"certainly free", its inner radius "certainly touching"; what lies between goes to exact convex pieces (gjk),
for just the pair and the lanes in question.

Everywhere `I`, `F`, `D` are the flat pack (see layout), `w` the lanes' workspace, `stamps` tells what in it
is of this block (`now`), `s` is float64 scratch; all are bare pointers (see simd).
"""

# pyright: reportCallIssue=false
# Numba calls intrinsics without their typing context, and splices tuples into compiled calls.
from __future__ import annotations

import numpy as np
from numba import njit

from armcell.collision.kernel import gjk
from armcell.collision.kernel.layout import (
    BLOCKS,
    BODIES,
    BODY_GROUPS,
    BODY_PIECES,
    BODY_SPHERE,
    BOXES,
    COLUMN,
    DOF,
    FIXED,
    FRAME,
    FRAMES,
    GROUP_SPHERE,
    GROUP_SPHERES,
    GROUPS,
    KIND,
    MARGIN,
    MULTIPLIER,
    OFFSET,
    PADDING,
    PAIR,
    PAIR_REACH,
    PAIRS,
    PARENT,
    PIECE_KIND,
    PIECE_POINTS,
    PIECE_POSE,
    PIECE_SIZE,
    PLANES,
    POINTS,
    REACH,
    SHAPE_KIND,
    SHAPE_PIECES,
    SHAPE_PLANES,
    SHAPE_POSE,
    SHAPE_SIZE,
    SHAPES,
    SPHERE,
    SPHERES,
    Flat,
)
from armcell.collision.kernel.simd import (
    L,
    any_lt,
    fma,
    hmax,
    hmin,
    load,
    mask_lt,
    pointer,
    select_lt,
    splat,
    store,
    trailing_zeros,
    vabs,
    vmax,
    vround,
    vsqrt,
)

REVOLUTE = 1
EXACT, PADDED = 1, 2  # bits of `mode`
# Where in the float64 scratch the transforms of exact pieces are: A, B and A in B's frame.
AT_A, AT_B, AT_RELATIVE, SCRATCH = gjk.SCRATCH, gjk.SCRATCH + 12, gjk.SCRATCH + 24, gjk.SCRATCH + 36

Workspace = tuple[np.ndarray, np.ndarray, np.ndarray]


def workspace(flat: Flat) -> Workspace:
    """Scratch for one thread: lanes (float32, 64-byte aligned), stamps (int64), exact tests (float64)."""
    I = flat[0]
    centres = int(I[BODIES] + I[GROUPS] + I[SPHERES])
    size = int(I[DOF] + 12 * I[FRAMES] + 3 * centres) * L
    raw = np.zeros(size + 16, np.float32)
    start = (-raw.ctypes.data % 64) // 4
    return raw[start : start + size], np.zeros(centres + 1, np.int64), np.zeros(SCRATCH, np.float64)


@njit(cache=True, forceinline=True)
def _frame_at(I, f):
    """Where frame f's 12 vectors are in w (rows of 3x4)."""
    return (I[DOF] + 12 * f) * L


@njit(cache=True, forceinline=True)
def _centre_at(I, i):
    """Where the centre of body i, group (bodies + i) or sphere (bodies + groups + i) is kept in w."""
    return (I[DOF] + 12 * I[FRAMES] + 3 * i) * L


@njit(cache=True, forceinline=True)
def _sincos(x):
    """Sine and cosine (Cephes polynomials, below 1e-6 for |x| < 1000)."""
    n = vround(x * splat(np.float32(0.6366197723675814)))
    y = fma(n, splat(np.float32(-1.5703125)), x)
    y = fma(n, splat(np.float32(-4.837512969970703e-4)), y)
    y = fma(n, splat(np.float32(-7.549789948768648e-8)), y)
    z = y * y
    s = fma(z, splat(np.float32(-1.9515295891e-4)), splat(np.float32(8.3321608736e-3)))
    s = fma(s, z, splat(np.float32(-1.6666654611e-1)))
    s = fma(s * z, y, y)
    c = fma(z, splat(np.float32(2.443315711809948e-5)), splat(np.float32(-1.388731625493765e-3)))
    c = fma(c, z, splat(np.float32(4.166664568298827e-2)))
    c = fma(c * z, z, fma(z, splat(np.float32(-0.5)), splat(np.float32(1.0))))
    quarter = splat(np.float32(0.25))
    half = splat(np.float32(0.5))
    two = splat(np.float32(2.0))
    one = splat(np.float32(1.0))
    f = vround(n * half - quarter)  # floor(n / 2)
    odd = n - two * f  # 0 or 1: swap sine and cosine
    g = f - two * vround(f * half - quarter)  # 0 or 1: turn both round
    sign = one - two * g
    sine = select_lt(half, odd, c, s) * sign
    cosine = select_lt(half, odd, splat(np.float32(0.0)) - s, c) * sign
    return sine, cosine


@njit(cache=True)
def fk_block(I, F, w):
    """Frames of 16 configurations whose positions lie at w[j * L:] per joint j."""
    zero, one = splat(np.float32(0.0)), splat(np.float32(1.0))
    base = _frame_at(I, 0)
    for i in range(12):
        store(w, base + i * L, one if i % 5 == 0 else zero)
    for f in range(1, I[FRAMES]):
        src, dst, m = _frame_at(I, I[I[PARENT] + f]), _frame_at(I, f), I[FIXED] + 12 * f
        value = load(w, I[I[COLUMN] + f] * L) * splat(F[I[MULTIPLIER] + f]) + splat(F[I[OFFSET] + f])
        turns = I[I[KIND] + f] == REVOLUTE
        sine, cosine = _sincos(value)
        for i in range(3):
            row = src + 4 * i * L
            a, b, c, t = load(w, row), load(w, row + L), load(w, row + 2 * L), load(w, row + 3 * L)
            x = fma(a, splat(F[m]), fma(b, splat(F[m + 4]), c * splat(F[m + 8])))
            y = fma(a, splat(F[m + 1]), fma(b, splat(F[m + 5]), c * splat(F[m + 9])))
            z = fma(a, splat(F[m + 2]), fma(b, splat(F[m + 6]), c * splat(F[m + 10])))
            o = fma(a, splat(F[m + 3]), fma(b, splat(F[m + 7]), fma(c, splat(F[m + 11]), t)))
            row = dst + 4 * i * L
            store(w, row, fma(x, cosine, y * sine) if turns else x)
            store(w, row + L, y * cosine - x * sine if turns else y)
            store(w, row + 2 * L, z)
            store(w, row + 3 * L, o if turns else fma(z, value, o))


@njit(cache=True, forceinline=True)
def _centre(I, F, w, stamps, now, i, frame, sphere):
    """Where centre i is kept; computed on its first use in this block from F[sphere:] in its frame."""
    at = _centre_at(I, i)
    if stamps[i + 1] != now:
        stamps[i + 1] = now
        x, y, z = splat(F[sphere]), splat(F[sphere + 1]), splat(F[sphere + 2])
        for k in range(3):
            row = frame + 4 * k * L
            value = fma(
                load(w, row), x, fma(load(w, row + L), y, fma(load(w, row + 2 * L), z, load(w, row + 3 * L)))
            )
            store(w, at + k * L, value)
    return at


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
    """Bits of the shapes of a block whose box meets the box given."""
    at = I[BOXES] + block * 6 * L
    mask = mask_lt(load(F, at), splat(hx)) & mask_lt(load(F, at + L), splat(hy))
    mask &= mask_lt(load(F, at + 2 * L), splat(hz)) & mask_lt(splat(lx), load(F, at + 3 * L))
    return mask & mask_lt(splat(ly), load(F, at + 4 * L)) & mask_lt(splat(lz), load(F, at + 5 * L))


# --- the exact tier ---
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
    """Distance of piece a at s[AT_A:] to piece b at s[AT_B:] [m]."""
    A, B, R = AT_A, AT_B, AT_RELATIVE
    for i in range(3):
        for j in range(4):
            s[R + 4 * i + j] = s[B + i] * s[A + j] + s[B + 4 + i] * s[A + 4 + j] + s[B + 8 + i] * s[A + 8 + j]
        s[R + 4 * i + 3] -= s[B + i] * s[B + 3] + s[B + 4 + i] * s[B + 7] + s[B + 8 + i] * s[B + 11]
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
    frame, best = _frame_at(I, I[I[FRAME] + body]), 1e9
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
    fi, fj, best = _frame_at(I, I[I[FRAME] + i]), _frame_at(I, I[I[FRAME] + j]), 1e9
    for a in range(I[I[BODY_PIECES] + i], I[I[BODY_PIECES] + i + 1]):
        _world_piece(I, D, w, a, fi, lane, s, AT_A)
        for b in range(I[I[BODY_PIECES] + j], I[I[BODY_PIECES] + j + 1]):
            _world_piece(I, D, w, b, fj, lane, s, AT_B)
            best = min(best, _piece_distance(I, D, a, b, min(best, enough), s))
            if best <= 0.0:
                return 0.0
    return best


@njit(cache=True)
def _exact_lanes(I, D, w, s, i, o, lanes, margin, pair):
    """Whether in any of the lanes (bits) the exact pieces of body i and of o are within the margin.

    `o` is a world shape where `pair` is negative, else the other body of that pair. What is found d apart
    in one lane is free in every lane that cannot have moved by more than d - margin.
    """
    dof = I[DOF]
    reach = I[REACH] + dof * i if pair < 0 else I[PAIR_REACH] + dof * pair
    while lanes != 0:
        lane = trailing_zeros(lanes)
        lanes &= lanes - 1
        if pair < 0:
            d = exact_to_shape(I, D, w, s, i, o, lane, margin + 0.05)
        else:
            d = exact_pair(I, D, w, s, i, o, lane, margin + 0.05)
        if d <= margin:
            return True
        rest = lanes
        while rest != 0:
            other = trailing_zeros(rest)
            rest &= rest - 1
            moved = 1e-6
            for c in range(dof):
                moved += abs(w[c * L + other] - w[c * L + lane]) * D[reach + c]
            if moved < d - margin:
                lanes &= ~(np.int64(1) << other)
    return False


# --- bodies against the world ---
@njit(cache=True)
def _body_to_shape(I, F, D, w, stamps, now, s, body, o, margin, exact):
    """A body against one world shape, from its groups down. See `check_block`."""
    frame, bodies = _frame_at(I, I[I[FRAME] + body]), I[BODIES]
    first_sphere = bodies + I[GROUPS]
    # The inner ball proves contact only where the gap is no mere lower bound.
    certain = I[I[SHAPE_KIND] + o] != gjk.CONE and I[I[SHAPE_KIND] + o] != gjk.POINTS
    open_lanes = np.int64(0)
    for g in range(I[I[BODY_GROUPS] + body], I[I[BODY_GROUPS] + body + 1]):
        sphere = I[GROUP_SPHERE] + 4 * g
        at = _centre(I, F, w, stamps, now, bodies + g, frame, sphere)
        if not any_lt(shape_gap(I, F, o, w, at), splat(F[sphere + 3] + margin)):
            continue
        for k in range(I[I[GROUP_SPHERES] + g], I[I[GROUP_SPHERES] + g + 1]):
            sphere = I[SPHERE] + 5 * k
            at = _centre(I, F, w, stamps, now, first_sphere + k, frame, sphere)
            gap = shape_gap(I, F, o, w, at)
            lanes = mask_lt(gap, splat(F[sphere + 3] + margin))
            if lanes == 0:
                continue
            if not exact:
                return True
            if certain and F[sphere + 4] > 0 and any_lt(gap, splat(F[sphere + 4])):
                return True
            open_lanes |= lanes
    return open_lanes != 0 and _exact_lanes(I, D, w, s, body, o, open_lanes, margin, -1)


@njit(cache=True)
def env_block(I, F, D, w, stamps, now, s, extra, mode):
    """Bodies against the world; `extra` (bodies,) [m] is added to the margins. See `check_block`."""
    for body in range(I[BODIES]):
        if I[I[FRAME] + body] == 0:
            continue
        padding, sphere = (
            F[I[PADDING] + body] if mode & PADDED else np.float32(0.0),
            I[BODY_SPHERE] + 4 * body,
        )
        at = _centre(I, F, w, stamps, now, body, _frame_at(I, I[I[FRAME] + body]), sphere)
        x, y, z, r = load(w, at), load(w, at + L), load(w, at + 2 * L), F[sphere + 3] + padding + extra[body]
        lx, ly, lz, hx, hy, hz = hmin(x) - r, hmin(y) - r, hmin(z) - r, hmax(x) + r, hmax(y) + r, hmax(z) + r
        for block in range(I[BLOCKS]):
            hit = _boxes_hit(I, F, block, lx, ly, lz, hx, hy, hz)
            while hit != 0:
                o = block * L + trailing_zeros(hit)
                hit &= hit - 1
                margin = F[I[MARGIN] + I[SHAPES] * body + o]
                if margin < 0.0 or not any_lt(shape_gap(I, F, o, w, at), splat(r)):
                    continue
                margin = (margin if mode & PADDED else np.float32(0.0)) + extra[body]
                if _body_to_shape(I, F, D, w, stamps, now, s, body, o, margin, mode & EXACT):
                    return True
    return False


# --- bodies against each other ---
@njit(cache=True, forceinline=True)
def _apart2(w, a, b):
    """Squared distance between two kept centres."""
    dx, dy = load(w, a) - load(w, b), load(w, a + L) - load(w, b + L)
    dz = load(w, a + 2 * L) - load(w, b + 2 * L)
    return fma(dx, dx, fma(dy, dy, dz * dz))


@njit(cache=True, forceinline=True)
def _square(r):
    return splat(r * r)


@njit(cache=True)
def _groups_of_pair(I, F, w, stamps, now, g, h, fi, fj, margin, exact):
    """Spheres of group g against those of group h: -1 certain contact, else the lanes where covers touch."""
    first_group, first_sphere = I[BODIES], I[BODIES] + I[GROUPS]
    sh = I[GROUP_SPHERE] + 4 * h
    ah, lanes = _centre(I, F, w, stamps, now, first_group + h, fj, sh), np.int64(0)
    for k in range(I[I[GROUP_SPHERES] + g], I[I[GROUP_SPHERES] + g + 1]):
        sk = I[SPHERE] + 5 * k
        ak = _centre(I, F, w, stamps, now, first_sphere + k, fi, sk)
        if not any_lt(_apart2(w, ak, ah), _square(F[sk + 3] + F[sh + 3] + margin)):
            continue
        for m in range(I[I[GROUP_SPHERES] + h], I[I[GROUP_SPHERES] + h + 1]):
            sm = I[SPHERE] + 5 * m
            apart = _apart2(w, ak, _centre(I, F, w, stamps, now, first_sphere + m, fj, sm))
            hit = mask_lt(apart, _square(F[sk + 3] + F[sm + 3] + margin))
            if hit == 0:
                continue
            if not exact or any_lt(apart, _square(F[sk + 4] + F[sm + 4])):
                return np.int64(-1)
            lanes |= hit
    return lanes


@njit(cache=True)
def _pair_of_bodies(I, F, D, w, stamps, now, s, pair, margin, exact):
    i, j = I[I[PAIR] + 2 * pair], I[I[PAIR] + 2 * pair + 1]
    fi, fj, bodies = _frame_at(I, I[I[FRAME] + i]), _frame_at(I, I[I[FRAME] + j]), I[BODIES]
    sj, open_lanes = I[BODY_SPHERE] + 4 * j, np.int64(0)
    aj = _centre(I, F, w, stamps, now, j, fj, sj)
    for g in range(I[I[BODY_GROUPS] + i], I[I[BODY_GROUPS] + i + 1]):
        sg = I[GROUP_SPHERE] + 4 * g
        ag = _centre(I, F, w, stamps, now, bodies + g, fi, sg)
        if not any_lt(_apart2(w, ag, aj), _square(F[sg + 3] + F[sj + 3] + margin)):
            continue
        for h in range(I[I[BODY_GROUPS] + j], I[I[BODY_GROUPS] + j + 1]):
            sh = I[GROUP_SPHERE] + 4 * h
            ah = _centre(I, F, w, stamps, now, bodies + h, fj, sh)
            if not any_lt(_apart2(w, ag, ah), _square(F[sg + 3] + F[sh + 3] + margin)):
                continue
            lanes = _groups_of_pair(I, F, w, stamps, now, g, h, fi, fj, margin, exact)
            if lanes < 0:
                return True
            open_lanes |= lanes
    return open_lanes != 0 and _exact_lanes(I, D, w, s, i, j, open_lanes, margin, pair)


@njit(cache=True)
def self_block(I, F, D, w, stamps, now, s, extra_pair, exact):
    """Pairs of bodies; `extra_pair` (pairs,) [m] is the margin of each pair."""
    for pair in range(I[PAIRS]):
        i, j = I[I[PAIR] + 2 * pair], I[I[PAIR] + 2 * pair + 1]
        si, sj, margin = I[BODY_SPHERE] + 4 * i, I[BODY_SPHERE] + 4 * j, extra_pair[pair]
        ai = _centre(I, F, w, stamps, now, i, _frame_at(I, I[I[FRAME] + i]), si)
        aj = _centre(I, F, w, stamps, now, j, _frame_at(I, I[I[FRAME] + j]), sj)
        if any_lt(_apart2(w, ai, aj), _square(F[si + 3] + F[sj + 3] + margin)) and _pair_of_bodies(
            I, F, D, w, stamps, now, s, pair, margin, exact
        ):
            return True
    return False


@njit(cache=True)
def check_block(I, F, D, w, stamps, s, extra, extra_pair, mode):
    """Whether any of 16 configurations (positions at w[j * L:]) touches anything.

    Args:
        extra, extra_pair: margins [m] per body (beside its padding) and per pair of bodies.
        mode: bits. EXACT: decide by exact pieces what the covers cannot, else covers that touch count as
            contact. PADDED: bodies keep their padding from world shapes.
    """
    now = stamps[0] + 1
    stamps[0] = now
    fk_block(I, F, w)
    if env_block(I, F, D, w, stamps, now, s, extra, mode):
        return True
    return self_block(I, F, D, w, stamps, now, s, extra_pair, mode & EXACT)


@njit(cache=True)
def check(I, F, D, w, stamps, s, extra, extra_pair, mode, q):
    """`check_block` on arrays, for one configuration (dof,)."""
    for j in range(len(q)):
        for lane in range(L):
            w[j * L + lane] = q[j]
    return check_block(
        pointer(I), pointer(F), pointer(D), pointer(w), pointer(stamps), pointer(s), pointer(extra),
        pointer(extra_pair), mode,
    )  # fmt: skip
