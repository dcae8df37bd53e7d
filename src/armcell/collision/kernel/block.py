"""Collision check of 16 configurations at once: coarse tests first, of body pairs and of the world.

The tests, from coarse to fine: a body's bounding sphere against the bounding boxes of 16 world shapes at
a time, the bounding sphere against the shape, groups of at most 8 spheres, single spheres. Body pairs:
the bounding spheres, the groups that can come near, single spheres. If a sphere's outer radius is clear,
the body is certainly free; if its inner radius touches, the body is certainly in contact. Undecided
cases go to the exact convex pieces (`gjk`), only for the pair and the lanes concerned (`exact_checks`).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numba import cfunc, njit, types

from armcell._inner_njit import inner_njit
from armcell.collision.kernel import gjk
from armcell.collision.kernel.exact_checks import queue_exact_test, run_exact_tests
from armcell.collision.kernel.frames import center, fk_block, motion_margin, twist_block
from armcell.collision.kernel.pack import (
    BODIES,
    BODY_SPHERE,
    DOF,
    FRAME,
    GAP_GRID,
    GAP_TABLE,
    GAPS,
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
from armcell.collision.kernel.simd import (
    L,
    at_address,
    call,
    fma,
    load,
    mask_lt,
    pointer,
    splat,
    store,
    vabs,
    vsqrt,
)
from armcell.collision.kernel.workspace import (
    ALIVE,
    EXACT,
    FIRST,
    NOW,
    PADDED,
    PROVE,
    STILL,
    TOUCHING,
    WAITING,
    body_margin_at,
    center_at,
    interval_half_width_at,
    rate_at,
    record_collision,
    record_contact,
    required_distance_at,
    velocity_at,
)
from armcell.collision.kernel.world_collision import world_block

# pyright: reportCallIssue=false
# Numba calls intrinsics without their typing context, and splices tuples into compiled calls.


DONE = np.int64(-1)
EVERY = np.int64((1 << L) - 1)  # all lanes
__all__ = ["EVERY", "EXACT", "FIRST", "PADDED", "PROVE", "STILL", "check_block", "handle_of", "touches"]


@inner_njit(forceinline=True)
def _near(I, w, state, i, j, radii, more, mode):
    """Return a bit mask of those configurations in a block of 16 in which two balls may overlap. Each ball
    encloses one body of a pair.

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
    """Return whether a cheap test shows for all configurations of a block that two bodies do not touch.

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
    """Test the spheres of one group against those of another body's group in a block of 16 configurations.
    Return the bit mask of possible contacts, or DONE if the check of the block can stop early.

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
def _apart_by_table(I, F, w, pair, slack, mode):
    """Check a pair of robot bodies by its gap table, for a block of configurations. Return a bit mask of the
    SIMD lanes in which the bodies are apart. In a motion proof, they are apart during the whole interval.

    Pairs without a gap table are apart in no lane.
    """
    t = I[GAP_TABLE] + 5 * pair
    if I[t] < 0:
        return np.int64(0)
    need = splat(F[I[PAIR_MARGIN] + pair])
    if mode & PROVE:
        motion, rate = splat(np.float32(0.0)), I[PAIR_RATE] + I[DOF] * pair
        for j in range(I[DOF]):
            motion = fma(vabs(load(w, rate_at(I, j))), splat(F[rate + j]), motion)
        need = fma(load(w, interval_half_width_at(I)), motion, need + splat(slack))
    at, g, first, second = required_distance_at(I), I[GAP_GRID] + 6 * pair, I[t + 1] * L, I[t + 2] * L
    store(w, at, need)
    apart, table = np.int64(0), I[GAPS] + I[t]
    for lane in range(L):
        x, y = (w[first + lane] - F[g]) * F[g + 1], (w[second + lane] - F[g + 3]) * F[g + 4]
        a, b = int(x - F[g + 2] * np.floor(x / F[g + 2])), int(y - F[g + 5] * np.floor(y / F[g + 5]))
        if a < I[t + 3] and b < I[t + 4] and F[table + a * I[t + 4] + b] > w[at + lane]:
            apart |= np.int64(1) << lane
    return apart


@inner_njit
def _pair_of_bodies(I, F, D, w, state, s, slack, slack_pair, pair, more, close, mode):
    i, j = I[I[PAIR] + 2 * pair], I[I[PAIR] + 2 * pair + 1]
    f, e, bodies = I[I[FRAME] + i], I[I[FRAME] + j], I[BODIES]
    sj, open_lanes = I[BODY_SPHERE] + 4 * j, np.int64(0)
    undecided = ~_apart_by_table(I, F, w, pair, slack_pair[pair], mode)
    if state[ALIVE] & undecided == 0:
        return False
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
            near &= undecided
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
    """Test all pairs of robot bodies against each other in a block of 16 configurations. Return True if no
    further test is needed.

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


# Numba calls intrinsics without their typing context, and splices tuples into compiled calls.


# Indices of the addresses in a handle.
AT_I, AT_F, AT_D, AT_W, AT_STATE, AT_S, AT_SLACK, AT_SLACK_PAIR, AT_CHECK, AT_SELF = range(10)


@inner_njit
def _check_arrays(I, F, D, w, state, s, slack, slack_pair, lanes, mode):
    """Check a block of 16 configurations (one per SIMD lane).
    Return a bit mask of those that are not collision-free.

    The positions of joint j are at w[j * L:], one per lane.

    Args:
        slack, slack_pair: [m] margin per body and per pair of bodies, in addition to the margin that a
            proof's intervals need.
        mode: bits. EXACT: use exact pieces where the sphere covers cannot decide; without it, touching covers
            count as contact. PADDED: bodies keep their padding from world shapes. PROVE: a lane is free if
            nothing touches in its whole interval (rates and half widths in w); without it, only the
            configuration itself is checked, and the check stops at the first lane that is not free. FIRST:
            stop at the first certain contact. STILL: the configurations and rates are those of the last
            check, so all frames and centers are still right, and only pairs of robot bodies are tested.
    Returns:
        Bits of the lanes that are not free; `state[TOUCHING]` has the bits of lanes that certainly touch.
    """
    state[ALIVE], state[TOUCHING], state[WAITING] = lanes, 0, 0
    done = False
    if mode & STILL == 0:
        state[NOW] += 1
        fk_block(I, F, w)
        if mode & PROVE:
            twist_block(I, F, w)
        done = world_block(I, F, D, w, state, s, slack, slack_pair, mode)
    done = done or pairs_block(I, F, D, w, state, s, slack, slack_pair, mode)
    if not done and state[WAITING] != 0:
        run_exact_tests(I, F, D, w, state, s, slack, slack_pair, mode)
    return lanes & ~state[ALIVE]


def _check(handle, lanes, mode):
    k = at_address(np.int64, handle)
    return _check_arrays(
        at_address(np.int32, k[AT_I]), at_address(np.float32, k[AT_F]), at_address(np.float64, k[AT_D]),
        at_address(np.float32, k[AT_W]), at_address(np.int64, k[AT_STATE]), at_address(np.float64, k[AT_S]),
        at_address(np.float32, k[AT_SLACK]), at_address(np.float32, k[AT_SLACK_PAIR]), lanes, mode,
    )  # fmt: skip


@lru_cache(maxsize=1)
def check_address() -> int:
    """Return the memory address of the compiled function that checks a block of 16 configurations.

    The function takes the address of a handle, the lanes and the mode. All callers call the function by this
    address. Otherwise, Numba would compile a copy into each caller, which takes minutes.
    """
    return int(cfunc(types.int64(types.int64, types.int64, types.int64), cache=True)(_check).address or 0)


@lru_cache(maxsize=1)
def free_check_address() -> int:
    """Return the memory address of a stub that replaces the compiled block check. The stub always reports no
    collision, and code that calls the stub compiles quickly.
    """
    return int(cfunc(types.int64(types.int64, types.int64, types.int64))(_free_check).address or 0)


def _free_check(handle, lanes, mode):
    return 0


def handle_of(arrays: Sequence[np.ndarray]) -> np.ndarray:
    """Return the handle with which compiled code checks a block of configurations: the memory addresses of
    the kernel's arrays and of the compiled check function.

    The arrays are the pack (I, F, D), the workspace (w, state, s), slack and slack_pair. The handle replaces
    nine arguments, each of which costs half a microsecond in a call from Python. Keep the arrays alive as
    long as the handle.
    """
    handle = np.zeros(10, np.int64)
    handle[:8] = [array.ctypes.data for array in arrays]
    handle[AT_CHECK] = check_address()
    handle[AT_SELF] = handle.ctypes.data
    return handle


@inner_njit(forceinline=True)
def check_block(k, lanes, mode):
    """Check a block of 16 configurations for collisions in one call, given the handle of the check."""
    return call(k[AT_CHECK], k[AT_SELF], lanes, mode)


@inner_njit(forceinline=True)
def ints(k):
    """Return a pointer to the integer array of the kernel, given the handle of a check of a block of
    configurations.
    """
    return at_address(np.int32, k[AT_I])


@inner_njit(forceinline=True)
def lanes_of(k):
    """Return a pointer to the workspace that holds a block of 16 configurations, from the handle of a block
    check.
    """
    return at_address(np.float32, k[AT_W])


@njit(cache=True, nogil=True)
def touches(handle, mode, q):
    """Return whether a block check finds the configuration q (dof,) in collision or cannot rule out a
    collision.

    Python code can call this function. The function copies q to all SIMD lanes before the check.
    """
    k = pointer(handle)
    w = lanes_of(k)
    for j in range(len(q)):
        for lane in range(L):
            w[j * L + lane] = q[j]
    return check_block(k, np.int64(1), np.int64(mode)) != 0
