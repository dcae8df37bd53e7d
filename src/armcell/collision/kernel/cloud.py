"""Kernel tests of robot bodies against clouds, which are world shapes with very many parts.

`cloud_part` describes the parts. Groups of spheres descend the cloud's bounding-box tree: first 16 boxes at a
time against all lanes together, then each box against every lane. At a block of parts, the SIMD lanes hold 16
parts, and one sphere in one configuration is tested against them. The kernel does not store which parts the
exact tier must test; the exact tier finds them again, only for the undecided configurations.
"""

# pyright: reportCallIssue=false, reportGeneralTypeIssues=false
# Numba calls intrinsics without their typing context, and splices tuples into compiled calls.
from __future__ import annotations

import numpy as np

from armcell._inner_njit import inner_njit
from armcell.collision.kernel import gjk
from armcell.collision.kernel.box_tree import boxes_hit, rotate_to_shape_frame, to_shape_frame
from armcell.collision.kernel.frames import center
from armcell.collision.kernel.pack import (
    BODIES,
    BODY_GROUPS,
    BODY_SPHERE,
    CLOUD,
    CLOUD_BOXES,
    CLOUD_CHILD,
    CLOUD_PARTS,
    FRAME,
    GROUP_SPHERE,
    GROUP_SPHERES,
    GROUPS,
    SHAPE_CLOUD,
    SHAPE_POSE,
    SPHERE,
)
from armcell.collision.kernel.simd import (
    L,
    fma,
    hmax,
    hmin,
    load,
    mask_lt,
    select_lt,
    splat,
    store,
    trailing_zeros,
    vabs,
    vmax,
    vmin,
    vsqrt,
)
from armcell.collision.kernel.workspace import (
    ALIVE,
    EXACT,
    LISTED,
    MAX_LISTED,
    MAX_STACK,
    PLACED,
    PROVE,
    STACK,
    ball_at,
    interval_half_width_at,
    local_at,
    record_collision,
    record_contact,
    required_distance_at,
    velocity_at,
)

NO_GROUP = np.int64(-1)
DONE = np.int64(-1)


@inner_njit(forceinline=True)
def _cloud_of(I, o):
    """Return the index in the kernel's integer array where the data of
    a cloud (spheres, cubes or triangles) starts.
    """
    return I[CLOUD] + 4 * I[I[SHAPE_CLOUD] + o]


@inner_njit(forceinline=True)
def _side(F, at, u, v, x, y, z):
    """Return the vector from the nearest point on a triangle's edge to a given point, for 16 triangles of a
    cloud at once.

    The triangles are at F[at:]; their edges lead from corner u to corner v. Also returns on which side of the
    edge the point is, positive on the inner side.
    """
    ux, uy, uz = load(F, at + 3 * u * L), load(F, at + (3 * u + 1) * L), load(F, at + (3 * u + 2) * L)
    ex = load(F, at + 3 * v * L) - ux
    ey = load(F, at + (3 * v + 1) * L) - uy
    ez = load(F, at + (3 * v + 2) * L) - uz
    px, py, pz = x - ux, y - uy, z - uz
    along = fma(px, ex, fma(py, ey, pz * ez))
    length2 = vmax(fma(ex, ex, fma(ey, ey, ez * ez)), splat(np.float32(1e-30)))
    t = vmax(vmin(along / length2, splat(np.float32(1.0))), splat(np.float32(0.0)))
    nx, ny, nz = (
        load(F, at + 9 * L),
        load(F, at + 10 * L),
        load(F, at + 11 * L),
    )
    inside = fma(nx, ey * pz - ez * py, fma(ny, ez * px - ex * pz, nz * (ex * py - ey * px)))
    return px - t * ex, py - t * ey, pz - t * ez, inside


@inner_njit(forceinline=True)
def _apart(F, kind, at, x, y, z):
    """Return the distances from a point to 16 spheres, cubes or triangles of a cloud, and the vectors from
    the nearest point of each to the given point.

    The parts are at F[at:]. All these distances are convex functions of the point. The length of a vector is
    the distance, except for balls, where the vector begins at the center.
    """
    zero = splat(np.float32(0.0))
    if kind == gjk.TRIANGLE:
        # The nearest point is on a side, or on the face if the point is on the inner side of all three sides
        # (n . edge x point > 0). The normal was computed in float64, so that it is accurate for slivers, too.
        ax, ay, az, a = _side(F, at, 0, 1, x, y, z)
        bx, by, bz, b = _side(F, at, 1, 2, x, y, z)
        cx, cy, cz, c = _side(F, at, 2, 0, x, y, z)
        a2 = fma(ax, ax, fma(ay, ay, az * az))
        b2 = fma(bx, bx, fma(by, by, bz * bz))
        c2 = fma(cx, cx, fma(cy, cy, cz * cz))
        dx, dy, dz = select_lt(b2, a2, bx, ax), select_lt(b2, a2, by, ay), select_lt(b2, a2, bz, az)
        best = vmin(a2, b2)
        dx, dy, dz = select_lt(c2, best, cx, dx), select_lt(c2, best, cy, dy), select_lt(c2, best, cz, dz)
        nx, ny, nz = load(F, at + 9 * L), load(F, at + 10 * L), load(F, at + 11 * L)
        px, py, pz = x - load(F, at), y - load(F, at + L), z - load(F, at + 2 * L)
        h = fma(nx, px, fma(ny, py, nz * pz))
        inner = vmin(a, vmin(b, c))
        dx = select_lt(zero, inner, h * nx, dx)
        dy = select_lt(zero, inner, h * ny, dy)
        dz = select_lt(zero, inner, h * nz, dz)
        return vsqrt(fma(dx, dx, fma(dy, dy, dz * dz))), dx, dy, dz
    dx, dy, dz = x - load(F, at), y - load(F, at + L), z - load(F, at + 2 * L)
    r = load(F, at + 3 * L)
    if kind == gjk.CELL:
        dx = dx - vmax(vmin(dx, r), zero - r)
        dy = dy - vmax(vmin(dy, r), zero - r)
        dz = dz - vmax(vmin(dz, r), zero - r)
        return vsqrt(fma(dx, dx, fma(dy, dy, dz * dz))), dx, dy, dz
    return vsqrt(fma(dx, dx, fma(dy, dy, dz * dz))) - r, dx, dy, dz


@inner_njit(forceinline=True)
def _block_at(I, c, block):
    """Return the index in the kernel's float array where a block of 16 spheres,
    cubes or triangles of a cloud starts.
    """
    rows = 12 if I[c] == gjk.TRIANGLE else 4
    return I[CLOUD_PARTS] + I[c + 2] + block * rows * L


@inner_njit
def _local(I, F, w, state, o, g, f, mode):
    """Transform the sphere centers of a group of spheres to the frame of a cloud, in all SIMD lanes.

    The centers of group g in the frame of shape o are written to w[local_at:]. In a proof, the velocities are
    written as well.
    """
    m, out, first = I[SHAPE_POSE] + 12 * o, local_at(I), I[BODIES] + I[GROUPS]
    for k in range(I[I[GROUP_SPHERES] + g], I[I[GROUP_SPHERES] + g + 1]):
        at = center(I, F, w, state, first + k, f, I[SPHERE] + 5 * k, mode)
        x, y, z = to_shape_frame(F, m, load(w, at), load(w, at + L), load(w, at + 2 * L))
        store(w, out, x)
        store(w, out + L, y)
        store(w, out + 2 * L, z)
        if mode & PROVE:
            v = velocity_at(I, first + k)
            x, y, z = rotate_to_shape_frame(F, m, load(w, v), load(w, v + L), load(w, v + 2 * L))
            store(w, out + 3 * L, x)
            store(w, out + 4 * L, y)
            store(w, out + 5 * L, z)
        out += 6 * L


@inner_njit
def _group_to_parts(I, F, w, state, o, g, f, kind, at, lane, more, mode):
    """Test one sphere group of a robot body against 16 parts (spheres, cubes or triangles) of a cloud.
    The robot's configuration is that of one SIMD lane.

    The group's bounding ball is tested before its spheres. The parts are at F[at:]. `more` is the margin that
    a gap must exceed in addition to the radius and, in a proof, to the motion in half the interval.

    Returns:
        Three bit masks of parts: parts that a sphere is not clear of, parts that certainly touch a sphere,
        and parts so near that no exact test can prove them clear.
    """
    near, sure, close = np.int64(0), np.int64(0), np.int64(0)
    b, tiny, first = ball_at(I) + lane, splat(np.float32(1e-12)), I[I[GROUP_SPHERES] + g]
    for k in range(first - 1, I[I[GROUP_SPHERES] + g + 1]):
        gap, dx, dy, dz = _apart(F, kind, at, splat(w[b]), splat(w[b + L]), splat(w[b + 2 * L]))
        if k < first:
            if mask_lt(gap, splat(w[b + 3 * L])) == 0:
                break
            b = local_at(I) + lane
            if state[PLACED] != g:
                _local(I, F, w, state, o, g, f, mode)
                state[PLACED] = g
            continue
        sphere = I[SPHERE] + 5 * k
        need = splat(more)
        if mode & PROVE:
            rate = fma(dx, splat(w[b + 3 * L]), fma(dy, splat(w[b + 4 * L]), dz * splat(w[b + 5 * L])))
            length = vsqrt(fma(dx, dx, fma(dy, dy, fma(dz, dz, tiny))))
            need = fma(splat(w[interval_half_width_at(I) + lane]), vabs(rate) / length, need)
        b += 6 * L
        hit = mask_lt(gap, splat(F[sphere + 3]) + need)
        if hit == 0:
            continue
        near |= hit
        if F[sphere + 4] > 0:
            sure |= mask_lt(gap, splat(F[sphere + 4]))
            close |= mask_lt(gap, splat(F[sphere + 4]) + need)
    return near, sure, close


@inner_njit
def _parts_block(I, F, w, state, o, g, f, kind, at, lanes, open_lanes, more_at, mode):
    """Test one sphere group of a robot body against 16 parts (spheres, cubes or triangles) of a cloud, in the
    configurations of several SIMD lanes.

    Returns the undecided lanes, or DONE.
    """
    while lanes != 0:
        lane = trailing_zeros(lanes)
        lanes &= lanes - 1
        near, sure, close = _group_to_parts(I, F, w, state, o, g, f, kind, at, lane, w[more_at + lane], mode)
        if near == 0:
            continue
        bit = np.int64(1) << lane
        if mode & EXACT == 0:
            if record_collision(state, bit, mode):
                return DONE
        elif sure != 0:
            if record_contact(state, bit, mode):
                return DONE
        elif close != 0:
            if record_collision(state, bit, mode):
                return DONE
        else:
            open_lanes |= bit
    return open_lanes


@inner_njit
def _keep_ball(I, w, state, x, y, z, reach):
    """Store the bounding ball of a robot body's sphere group in the frame of a cloud. The kernel transforms
    the spheres of the group only if the ball comes near a part of the cloud.
    """
    ball = ball_at(I)
    store(w, ball, x)
    store(w, ball + L, y)
    store(w, ball + 2 * L, z)
    store(w, ball + 3 * L, reach)
    state[PLACED] = NO_GROUP


@inner_njit
def _walk(I, F, w, state, o, g, f, x, y, z, reach, lanes, more_at, mode):
    """Test one ball per SIMD lane against a cloud of spheres, cubes or triangles. The search visits only
    boxes of the cloud's tree that a ball overlaps.

    The balls have radius `reach` around (x, y, z), in shape o's frame.

    Returns:
        With NO_GROUP, the first lanes that reach a block of parts; otherwise the result of `_parts_block` for
        group g.
    """
    c, stack = _cloud_of(I, o), STACK + MAX_STACK // 2
    zero, open_lanes = splat(np.float32(0.0)), np.int64(0)
    lx, ly, lz = hmin(x - reach), hmin(y - reach), hmin(z - reach)
    hx, hy, hz = hmax(x + reach), hmax(y + reach), hmax(z + reach)
    reach2, top = reach * reach, 1
    _keep_ball(I, w, state, x, y, z, reach)
    state[stack] = 0
    while top > 0:
        top -= 1
        block = I[c + 1] + state[stack + top]
        at = I[CLOUD_BOXES] + block * 6 * L
        hit = boxes_hit(F, at, lx, ly, lz, hx, hy, hz)
        while hit != 0:
            k = trailing_zeros(hit)
            hit &= hit - 1
            low = at + k
            dx = vmax(vmax(splat(F[low]) - x, x - splat(F[low + 3 * L])), zero)
            dy = vmax(vmax(splat(F[low + L]) - y, y - splat(F[low + 4 * L])), zero)
            dz = vmax(vmax(splat(F[low + 2 * L]) - z, z - splat(F[low + 5 * L])), zero)
            here = mask_lt(fma(dx, dx, fma(dy, dy, dz * dz)), reach2) & lanes & state[ALIVE]
            if mode & PROVE:  # the exact tier decides open lanes
                here &= ~open_lanes
            if here == 0:
                continue
            child = I[I[CLOUD_CHILD] + block * L + k]
            if child < 0:
                if top < MAX_STACK // 2:  # 16 ** 8 parts fit
                    state[stack + top] = -child
                    top += 1
                continue
            if g == NO_GROUP:
                return here
            first = _block_at(I, c, child)
            open_lanes = _parts_block(I, F, w, state, o, g, f, I[c], first, here, open_lanes, more_at, mode)
            if open_lanes == DONE:
                return DONE
    return open_lanes


@inner_njit(forceinline=True)
def _grown(I, w, i, radius, more, mode):
    """Return the enlarged radius of a robot body's bounding ball for a test against a cloud. The radius grows
    by a margin and, to certify a motion, by the distance that the ball moves.

    The ball is around center i.
    """
    reach = splat(radius) + more
    return (
        fma(load(w, interval_half_width_at(I)), load(w, velocity_at(I, i) + 3 * L), reach)
        if mode & PROVE
        else reach
    )


@inner_njit
def body_to_cloud(I, F, w, state, body, o, more, lanes, mode):
    """Test a robot body against a cloud of spheres, cubes or triangles, in one configuration per SIMD lane.
    Return a bit mask of the lanes that need an exact test, or DONE to end the check early.
    """
    f, bodies, m, open_lanes = I[I[FRAME] + body], I[BODIES], I[SHAPE_POSE] + 12 * o, np.int64(0)
    more_at = required_distance_at(I) + L
    store(w, more_at, more)
    at = center(I, F, w, state, body, f, I[BODY_SPHERE] + 4 * body, mode)
    x, y, z = to_shape_frame(F, m, load(w, at), load(w, at + L), load(w, at + 2 * L))
    reach = _grown(I, w, body, F[I[BODY_SPHERE] + 4 * body + 3], more, mode)
    if _walk(I, F, w, state, o, NO_GROUP, f, x, y, z, reach, lanes, more_at, mode) == 0:
        return open_lanes
    for g in range(I[I[BODY_GROUPS] + body], I[I[BODY_GROUPS] + body + 1]):
        sphere = I[GROUP_SPHERE] + 4 * g
        at = center(I, F, w, state, bodies + g, f, sphere, mode)
        x, y, z = to_shape_frame(F, m, load(w, at), load(w, at + L), load(w, at + 2 * L))
        reach = _grown(I, w, bodies + g, F[sphere + 3], more, mode)
        left = lanes & ~open_lanes if mode & PROVE else lanes
        found = _walk(I, F, w, state, o, np.int64(g), f, x, y, z, reach, left, more_at, mode)
        if found == DONE:
            return DONE
        open_lanes |= found
    return open_lanes & state[ALIVE]


@inner_njit
def next_parts(I, F, w, state, body, o, lane, mode, group, top, count):
    """List the parts of a cloud (spheres, cubes or triangles) that may touch a robot body and so need an
    exact test. Each call continues where the previous call stopped.

    Call the function repeatedly with its own last result; begin with the body's first group, 0 and 0. It
    writes the index in F of each part to state[LISTED:].

    Returns:
        group, top: position where the walk stopped; after the body's last group, the walk is complete.
        count: number of listed parts.
    """
    f, bodies, m, c = I[I[FRAME] + body], I[BODIES], I[SHAPE_POSE] + 12 * o, _cloud_of(I, o)
    need, more = (
        w[required_distance_at(I) + lane],
        w[required_distance_at(I) + (L if mode & PROVE else 0) + lane],
    )
    zero, stack = splat(np.float32(0.0)), STACK + MAX_STACK // 2
    while group < I[I[BODY_GROUPS] + body + 1]:
        sphere = I[GROUP_SPHERE] + 4 * group
        at = center(I, F, w, state, bodies + group, f, sphere, mode)
        x, y, z = to_shape_frame(
            F, m, splat(w[at + lane]), splat(w[at + L + lane]), splat(w[at + 2 * L + lane])
        )
        reach = splat(F[sphere + 3] + need)
        if top == 0:
            state[stack] = 0
            top = 1
        _keep_ball(I, w, state, x, y, z, reach)
        while top > 0:
            if count + L * L > MAX_LISTED:
                return group, top, count
            top -= 1
            block = I[c + 1] + state[stack + top]
            at = I[CLOUD_BOXES] + block * 6 * L
            dx = vmax(vmax(load(F, at) - x, x - load(F, at + 3 * L)), zero)
            dy = vmax(vmax(load(F, at + L) - y, y - load(F, at + 4 * L)), zero)
            dz = vmax(vmax(load(F, at + 2 * L) - z, z - load(F, at + 5 * L)), zero)
            hit = mask_lt(fma(dx, dx, fma(dy, dy, dz * dz)), reach * reach)
            while hit != 0:
                k = trailing_zeros(hit)
                hit &= hit - 1
                child = I[I[CLOUD_CHILD] + block * L + k]
                if child < 0:
                    if top < MAX_STACK // 2:
                        state[stack + top] = -child
                        top += 1
                    continue
                first = _block_at(I, c, child)
                near, _sure, _close = _group_to_parts(
                    I, F, w, state, o, group, f, I[c], first, lane, more, mode
                )
                while near != 0:
                    state[LISTED + count] = first + trailing_zeros(near)
                    near &= near - 1
                    count += 1
        group += 1
    return group, top, count


@inner_njit(forceinline=True)
def _turns(F, at, u, v, x, y):
    """Return how an edge of a cloud's triangle crosses the ray from a point along +x in the xy plane, for 16
    triangles at once: 1 = counterclockwise, -1 = clockwise, 0 = no crossing.

    Edges lead from corner u to corner v. 1 is counter-clockwise. Each edge is computed from its lower end, so
    that the two triangles at an edge agree to the last bit.
    """
    ux, uy = load(F, at + 3 * u * L), load(F, at + (3 * u + 1) * L)
    vx, vy = load(F, at + 3 * v * L), load(F, at + (3 * v + 1) * L)
    one, zero = splat(np.float32(1.0)), splat(np.float32(0.0))
    lx, ly = select_lt(uy, vy, ux, vx), vmin(uy, vy)
    hx, hy = select_lt(uy, vy, vx, ux), vmax(uy, vy)
    spans = select_lt(y, ly, zero, select_lt(y, hy, one, zero))  # low end at or below, high end above
    left = fma(hx - lx, y - ly, zero - (x - lx) * (hy - ly))
    counts = select_lt(uy, vy, select_lt(zero, left, spans, zero), zero - select_lt(zero, left, spans, zero))
    return counts


@inner_njit
def encloses(I, F, state, o, px, py, pz):
    """Return whether a point (in the shape's frame) is inside a closed triangle mesh.
    The kernel stores the mesh as a cloud of triangles.

    The triangles above the point decide.
    """
    c, stack = _cloud_of(I, o), STACK + MAX_STACK // 2
    x, y, z, half = splat(px), splat(py), splat(pz), splat(np.float32(0.5))
    count, top = 0, 1
    state[stack] = 0
    while top > 0:
        top -= 1
        block = I[c + 1] + state[stack + top]
        at = I[CLOUD_BOXES] + block * 6 * L
        hit = mask_lt(load(F, at), x) & mask_lt(load(F, at + L), y)
        hit &= mask_lt(x, load(F, at + 3 * L)) & mask_lt(y, load(F, at + 4 * L))
        hit &= mask_lt(z, load(F, at + 5 * L))
        while hit != 0:
            k = trailing_zeros(hit)
            hit &= hit - 1
            child = I[I[CLOUD_CHILD] + block * L + k]
            if child < 0:
                if top < MAX_STACK // 2:
                    state[stack + top] = -child
                    top += 1
                continue
            t = _block_at(I, c, child)
            turns = _turns(F, t, 0, 1, x, y) + _turns(F, t, 1, 2, x, y) + _turns(F, t, 2, 0, x, y)
            nx, ny, nz = load(F, t + 9 * L), load(F, t + 10 * L), load(F, t + 11 * L)
            h = fma(nx, x - load(F, t), fma(ny, y - load(F, t + L), nz * (z - load(F, t + 2 * L))))
            above = mask_lt(h * nz, splat(np.float32(0.0)))
            out, into = mask_lt(half, turns) & above, mask_lt(turns, splat(np.float32(-0.5))) & above
            while out != 0:
                count += 1
                out &= out - 1
            while into != 0:
                count -= 1
                into &= into - 1
    return count != 0
