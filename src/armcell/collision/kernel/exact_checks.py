"""Exact tier of the collision kernel, for pairs that the sphere covers cannot decide.

The pairs wait until all covers have been tested, because another pair of the same block may certainly touch,
which makes the exact tests unnecessary.
"""

# pyright: reportCallIssue=false, reportGeneralTypeIssues=false
# Numba calls intrinsics without their typing context, and splices tuples into compiled calls.
from __future__ import annotations

import numpy as np

from armcell._inner_njit import inner_njit
from armcell.collision.kernel import gjk
from armcell.collision.kernel.cloud import encloses, next_parts
from armcell.collision.kernel.frames import motion_margin
from armcell.collision.kernel.pack import (
    BODY_GROUPS,
    BODY_PIECES,
    BODY_SPHERE,
    CLOUD,
    DOF,
    FRAME,
    MARGIN,
    OBJECTS,
    PAIR,
    PAIR_MARGIN,
    PAIR_RATE,
    PIECE_BALL,
    PIECE_KIND,
    PIECE_POINTS,
    PIECE_POSE,
    PIECE_SIZE,
    POINTS,
    POINTS32,
    RATE,
    SHAPE_CLOUD,
    SHAPE_OBJECT,
    SHAPE_PIECES,
    SHAPE_POSE,
    SHAPE_SIZE,
)
from armcell.collision.kernel.simd import L, fma, load, splat, store, trailing_zeros, vsqrt
from armcell.collision.kernel.workspace import (
    ALIVE,
    AT_A,
    AT_B,
    AT_RELATIVE,
    ENTRIES,
    LISTED,
    MAX_WAITING,
    PADDED,
    PROVE,
    WAITING,
    center_at,
    frame_at,
    interval_half_width_at,
    record_collision,
    record_contact,
    required_distance_at,
    twist_at,
    velocity_at,
)

FREE, UNPROVEN, CONTACT = 0, 1, 2

INSIDE = np.int64(1) << 40
"""Added to the index of a queued world shape: test whether a body is inside its closed mesh."""


@inner_njit
def queue_exact_test(I, F, D, w, state, s, slack, slack_pair, body, other, lanes, mode):
    """Queue an exact test of a robot body against a world shape or another body, for the SIMD lanes in which
    the sphere test was inconclusive.

    `other` is the index of the world shape, or -1 - pair for a pair of bodies. With `INSIDE` added to
    `other`, the exact tier only tests whether the body is inside the shape's mesh. Returns True if all lanes
    are decided.
    """
    if state[WAITING] == MAX_WAITING and run_exact_tests(I, F, D, w, state, s, slack, slack_pair, mode):
        return True
    entry = ENTRIES + 3 * state[WAITING]
    state[WAITING] += 1
    state[entry], state[entry + 1], state[entry + 2] = body, other, lanes
    return False


@inner_njit
def run_exact_tests(I, F, D, w, state, s, slack, slack_pair, mode):
    """Run the exact tests for all queued body pairs that the sphere test left undecided.
    Return True if no further test is needed.
    """
    waiting = state[WAITING]
    state[WAITING] = 0
    for k in range(waiting):
        body, other = state[ENTRIES + 3 * k], state[ENTRIES + 3 * k + 1]
        lanes = state[ENTRIES + 3 * k + 2] & state[ALIVE]
        if lanes == 0:
            continue
        if other < INSIDE:
            _needs(I, F, w, slack, slack_pair, body, other, mode)
        warm = False
        while lanes != 0:
            lane = trailing_zeros(lanes)
            lanes &= lanes - 1
            if other >= INSIDE:
                answer = CONTACT if _is_inside(I, F, D, w, state, s, body, other - INSIDE, lane) else FREE
            elif other >= 0 and I[I[SHAPE_CLOUD] + other] >= 0:
                answer = _cloud_lane(I, F, D, w, state, s, body, other, lane, mode)
            else:
                answer = _exact_lane(I, F, D, w, s, body, other, lane, warm, mode)
            warm = True
            bit = np.int64(1) << lane
            if answer != FREE and (
                record_contact(state, bit, mode) if answer == CONTACT else record_collision(state, bit, mode)
            ):
                return True
    return False


@inner_njit
def _needs(I, F, w, slack, slack_pair, body, other, mode):
    """Compute the distance that two bodies must exceed to pass the kernel's exact check, one value for each
    SIMD lane (configuration).

    The part of the distance that does not depend on speed is also stored.
    """
    at, pair = required_distance_at(I), -1 - other
    more = splat(np.float32(0.0))
    if other < 0:
        more = splat(F[I[PAIR_MARGIN] + pair])
    elif mode & PADDED:
        more = splat(max(F[I[MARGIN] + I[OBJECTS] * body + I[I[SHAPE_OBJECT] + other]], np.float32(0.0)))
    if mode & PROVE == 0:
        store(w, at, more)
        return
    f, g = I[I[FRAME] + body], 0
    if other >= 0:
        more = more + motion_margin(I, F, w, I[RATE] + I[DOF] * body, slack[body])
    else:
        g = I[I[FRAME] + I[I[PAIR] + 2 * pair + 1]]
        more = more + motion_margin(I, F, w, I[PAIR_RATE] + I[DOF] * pair, slack_pair[pair])
    # The relative twist at the body's center: angular velocity and velocity.
    c, v, a, b, o = center_at(I, body), velocity_at(I, body), twist_at(I, f), twist_at(I, g), frame_at(I, g)
    ux, uy, uz = load(w, b), load(w, b + L), load(w, b + 2 * L)
    rx, ry, rz = (
        load(w, c) - load(w, o + 3 * L),
        load(w, c + L) - load(w, o + 7 * L),
        load(w, c + 2 * L) - load(w, o + 11 * L),
    )
    vx = load(w, v) - load(w, b + 3 * L) - uy * rz + uz * ry
    vy = load(w, v + L) - load(w, b + 4 * L) - uz * rx + ux * rz
    vz = load(w, v + 2 * L) - load(w, b + 5 * L) - ux * ry + uy * rx
    wx, wy, wz = load(w, a) - ux, load(w, a + L) - uy, load(w, a + 2 * L) - uz
    speed = fma(
        vsqrt(fma(wx, wx, fma(wy, wy, wz * wz))),
        splat(F[I[BODY_SPHERE] + 4 * body + 3]),
        vsqrt(fma(vx, vx, fma(vy, vy, vz * vz))),
    )
    store(w, at, fma(load(w, interval_half_width_at(I)), speed, more))
    store(w, at + L, more)
    store(w, at + 2 * L, wx)
    store(w, at + 3 * L, wy)
    store(w, at + 4 * L, wz)
    store(w, at + 5 * L, vx)
    store(w, at + 6 * L, vy)
    store(w, at + 7 * L, vz)


@inner_njit
def _world_piece(I, D, w, e, frame, lane, s, out):
    """Compute the transform T_world_piece of a convex piece in one SIMD lane, for an exact collision test.

    The 12 numbers are written to s[out:].
    """
    m = I[PIECE_POSE] + 12 * e
    for i in range(3):
        row = frame + 4 * i * L + lane
        a, b, c, t = w[row], w[row + L], w[row + 2 * L], w[row + 3 * L]
        for j in range(4):
            s[out + 4 * i + j] = a * D[m + j] + b * D[m + 4 + j] + c * D[m + 8 + j]
        s[out + 4 * i + 3] += t


@inner_njit
def _relative(s):
    """Compute the transform from the frame of convex piece A to that of convex piece B,
    for an exact test in the kernel.

    The result is written to s[AT_RELATIVE:].
    """
    A, B, R = AT_A, AT_B, AT_RELATIVE
    for i in range(3):
        for j in range(3):
            s[R + 4 * i + j] = s[B + i] * s[A + j] + s[B + 4 + i] * s[A + 4 + j] + s[B + 8 + i] * s[A + 8 + j]
        x, y, z = s[A + 3] - s[B + 3], s[A + 7] - s[B + 7], s[A + 11] - s[B + 11]
        s[R + 4 * i + 3] = s[B + i] * x + s[B + 4 + i] * y + s[B + 8 + i] * z


@inner_njit(forceinline=True)
def _solid(I, piece):
    """For an exact check, return a convex piece of the kernel's arrays as a solid for GJK."""
    points = I[PIECE_POINTS] + 2 * piece
    return gjk.ConvexSolid(
        I[I[PIECE_KIND] + piece],
        I[PIECE_SIZE] + 3 * piece,
        I[POINTS] + 3 * I[points],
        I[POINTS32] + 3 * I[points],
        I[points + 1],
    )


@inner_njit
def _piece_distance(I, F, D, a, b, enough, warm, s):
    """Return the distance [m] between two convex pieces in the kernel's exact check. If it exceeds `enough`,
    it may be only a lower bound.

    The transforms of pieces a and b are at s[AT_A:] and s[AT_B:].
    """
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
    _relative(s)
    first, second = _solid(I, a), _solid(I, b)
    if second.kind == gjk.HALFSPACE:  # the lowest point of a along the plane's normal
        nx, ny, nz = s[R + 8], s[R + 9], s[R + 10]
        gjk.support(F, D, first, -nx, -ny, -nz, s, np.int64(48))
        s[gjk.NORMAL], s[gjk.NORMAL + 1], s[gjk.NORMAL + 2] = 0.0, 0.0, 1.0
        return max(nx * s[48] + ny * s[49] + nz * s[50] + s[R + 11], 0.0)
    return gjk.distance(F, D, R, first, second, enough, warm, s)


@inner_njit
def _directed_need(I, D, w, s, body, a, lane):
    """Return the clearance [m] that a moving convex piece needs along a given normal to pass the exact
    collision test of one SIMD lane (one configuration).

    The normal is in s[NORMAL:]. Along a fixed direction n, the nearest point of piece a approaches by |n .
    velocity| times half the interval. The velocity is that of the piece's center plus the contribution of its
    rotation, |n x angular| radius.
    """
    nx = ny = nz = 0.0
    for j in range(3):
        nx += s[AT_B + j] * s[gjk.NORMAL + j]
        ny += s[AT_B + 4 + j] * s[gjk.NORMAL + j]
        nz += s[AT_B + 8 + j] * s[gjk.NORMAL + j]
    ball, at, c = I[PIECE_BALL] + 4 * a, required_distance_at(I) + lane, center_at(I, body) + lane
    rx, ry, rz = s[AT_A + 3] - w[c], s[AT_A + 7] - w[c + L], s[AT_A + 11] - w[c + 2 * L]
    for j in range(3):
        rx += s[AT_A + j] * D[ball + j]
        ry += s[AT_A + 4 + j] * D[ball + j]
        rz += s[AT_A + 8 + j] * D[ball + j]
    wx, wy, wz = w[at + 2 * L], w[at + 3 * L], w[at + 4 * L]
    vx = w[at + 5 * L] + wy * rz - wz * ry
    vy = w[at + 6 * L] + wz * rx - wx * rz
    vz = w[at + 7 * L] + wx * ry - wy * rx
    tx, ty, tz = ny * wz - nz * wy, nz * wx - nx * wz, nx * wy - ny * wx
    speed = abs(nx * vx + ny * vy + nz * vz) + np.sqrt(tx * tx + ty * ty + tz * tz) * D[ball + 3]
    return w[interval_half_width_at(I) + lane] * speed + w[at + L]


@inner_njit
def _exact_lane(I, F, D, w, s, body, other, lane, warm, mode):
    """Test the convex pieces of a body against a world shape or another body exactly, in one SIMD lane.

    Returns FREE, UNPROVEN or CONTACT.
    """
    need, frame, pair = float(w[required_distance_at(I) + lane]), frame_at(I, I[I[FRAME] + body]), -1 - other
    second, close = frame, s[gjk.CLOSE]
    if other >= 0:
        first, end = I[I[SHAPE_PIECES] + other], I[I[SHAPE_PIECES] + other + 1]
    else:
        j = I[I[PAIR] + 2 * pair + 1]
        first, end = I[I[BODY_PIECES] + j], I[I[BODY_PIECES] + j + 1]
        second, close = frame_at(I, I[I[FRAME] + j]), max(close, float(F[I[PAIR_MARGIN] + pair]))
    mine, mine_end = I[I[BODY_PIECES] + body], I[I[BODY_PIECES] + body + 1]
    warm = warm and mine_end - mine == 1 and end - first == 1  # else the normal is of another pair of pieces
    for a in range(mine, mine_end):
        _world_piece(I, D, w, a, frame, lane, s, AT_A)
        for b in range(first, end):
            if other >= 0:
                for k in range(12):
                    s[AT_B + k] = D[I[PIECE_POSE] + 12 * b + k]
            else:
                _world_piece(I, D, w, b, second, lane, s, AT_B)
            d = _piece_distance(I, F, D, a, b, need, warm, s)
            if d <= close:
                return CONTACT
            if d <= need and (mode & PROVE == 0 or d <= _directed_need(I, D, w, s, body, a, lane)):
                return UNPROVEN
    return FREE


@inner_njit
def _cloud_lane(I, F, D, w, state, s, body, other, lane, mode):
    """Test a body exactly against the spheres, cubes or triangles
    that represent a world shape, in one SIMD lane.
    """
    group, end = np.int64(I[I[BODY_GROUPS] + body]), I[I[BODY_GROUPS] + body + 1]
    top = np.int64(0)
    while group < end:
        group, top, count = next_parts(I, F, w, state, body, other, lane, mode, group, top, 0)
        if count > 0:
            answer = _listed_parts(I, F, D, w, state, s, body, other, lane, count, mode)
            if answer != FREE:
                return answer
    return FREE


@inner_njit
def _listed_parts(I, F, D, w, state, s, body, other, lane, count, mode):
    """Test the convex pieces of a body exactly against the listed spheres,
    cubes or triangles of a cloud, in one SIMD lane.

    The list has `count` parts at state[LISTED:]. Otherwise the function is like `_exact_lane`.
    """
    need, frame, R = float(w[required_distance_at(I) + lane]), frame_at(I, I[I[FRAME] + body]), AT_RELATIVE
    kind, box = I[I[CLOUD] + 4 * I[I[SHAPE_CLOUD] + other]], I[I[SHAPE_PIECES] + other]
    for k in range(12):
        s[AT_B + k] = D[I[PIECE_POSE] + 12 * box + k]
    for a in range(I[I[BODY_PIECES] + body], I[I[BODY_PIECES] + body + 1]):
        _world_piece(I, D, w, a, frame, lane, s, AT_A)
        _relative(s)
        x, y, z = s[R + 3], s[R + 7], s[R + 11]
        ball = I[PIECE_BALL] + 4 * a
        cx = x + s[R] * D[ball] + s[R + 1] * D[ball + 1] + s[R + 2] * D[ball + 2]
        cy = y + s[R + 4] * D[ball] + s[R + 5] * D[ball + 1] + s[R + 6] * D[ball + 2]
        cz = z + s[R + 8] * D[ball] + s[R + 9] * D[ball + 1] + s[R + 10] * D[ball + 2]
        # The arguments have the types of `_piece_distance` (no constants), or gjk is compiled again.
        warm, unused = a < 0, np.int64(a)
        piece, part = _solid(I, a), gjk.ConvexSolid(kind, unused, unused, unused, kind)
        for k in range(count):
            at = state[LISTED + k]
            px, py, pz = float(F[at]), float(F[at + L]), float(F[at + 2 * L])
            radius = float(F[at + 3 * L])
            if kind == gjk.TRIANGLE:  # relative to its first corner
                radius = 0.0
                for j in range(3):
                    p = at + 3 * j * L
                    s[gjk.PART + 3 * j] = F[p] - px
                    s[gjk.PART + 3 * j + 1] = F[p + L] - py
                    s[gjk.PART + 3 * j + 2] = F[p + 2 * L] - pz
                    b = gjk.PART + 3 * j
                    radius = max(radius, np.sqrt(s[b] * s[b] + s[b + 1] * s[b + 1] + s[b + 2] * s[b + 2]))
            else:
                s[gjk.PART] = radius
                radius *= 1.7320509 if kind == gjk.CELL else 1.0
            apart = need + D[ball + 3] + radius
            if (cx - px) ** 2 + (cy - py) ** 2 + (cz - pz) ** 2 > apart * apart:
                continue
            s[R + 3], s[R + 7], s[R + 11] = x - px, y - py, z - pz
            d = gjk.distance(F, D, R, piece, part, need, warm, s)
            warm = True  # the next part is usually near this one
            if d <= s[gjk.CLOSE]:
                return CONTACT
            if d <= need and (mode & PROVE == 0 or d <= _directed_need(I, D, w, s, body, a, lane)):
                return UNPROVEN
    return FREE


@inner_njit
def _is_inside(I, F, D, w, state, s, body, other, lane):
    """Return whether the kernel's exact check finds a convex piece of a body inside a world shape that is a
    closed mesh.

    No piece of the body may touch the mesh's surface.
    """
    frame, m, size = frame_at(I, I[I[FRAME] + body]), I[SHAPE_POSE] + 12 * other, I[SHAPE_SIZE] + 3 * other
    for a in range(I[I[BODY_PIECES] + body], I[I[BODY_PIECES] + body + 1]):
        _world_piece(I, D, w, a, frame, lane, s, AT_A)
        x, y, z = s[AT_A + 3], s[AT_A + 7], s[AT_A + 11]  # the center of a simple solid
        if I[I[PIECE_KIND] + a] == gjk.POINTS:  # a corner of a hull
            p = I[POINTS] + 3 * I[I[PIECE_POINTS] + 2 * a]
            x += s[AT_A] * D[p] + s[AT_A + 1] * D[p + 1] + s[AT_A + 2] * D[p + 2]
            y += s[AT_A + 4] * D[p] + s[AT_A + 5] * D[p + 1] + s[AT_A + 6] * D[p + 2]
            z += s[AT_A + 8] * D[p] + s[AT_A + 9] * D[p + 1] + s[AT_A + 10] * D[p + 2]
        px = np.float32(F[m] * x + F[m + 1] * y + F[m + 2] * z + F[m + 3])
        py = np.float32(F[m + 4] * x + F[m + 5] * y + F[m + 6] * z + F[m + 7])
        pz = np.float32(F[m + 8] * x + F[m + 9] * y + F[m + 10] * z + F[m + 11])
        within = abs(px) < F[size] and abs(py) < F[size + 1] and abs(pz) < F[size + 2]
        if within and encloses(I, F, state, other, px, py, pz):
            return True
    return False
