"""Kernel tests of robot bodies against world shapes: boxes, bounding spheres, spheres."""

# pyright: reportCallIssue=false, reportGeneralTypeIssues=false
# Numba calls intrinsics without their typing context, and splices tuples into compiled calls.
from __future__ import annotations

import numpy as np

from armcell._inner_njit import inner_njit
from armcell.collision.kernel import gjk
from armcell.collision.kernel.box_tree import boxes_hit, rotate_to_shape_frame, to_shape_frame
from armcell.collision.kernel.cloud import DONE, body_to_cloud
from armcell.collision.kernel.exact_checks import INSIDE, queue_exact_test
from armcell.collision.kernel.frames import center, motion_margin
from armcell.collision.kernel.pack import (
    BODIES,
    BODY_GROUPS,
    BODY_SPHERE,
    BOXES,
    CHILD,
    CLOUD,
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
    SHAPE_CLOUD,
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
    MAX_STACK,
    PADDED,
    PROVE,
    STACK,
    body_margin_at,
    center_at,
    interval_half_width_at,
    record_collision,
    record_contact,
    velocity_at,
)


@inner_njit
def shape_gap(I, F, o, w, at):
    """Return the distances from points of a body to a world shape, for world collision tests in the kernel.
    The distances are lower bounds for cones and meshes.

    The points are at w[at:], one per lane; o is the index of the shape.
    """
    kind, m, size = I[I[SHAPE_KIND] + o], I[SHAPE_POSE] + 12 * o, I[SHAPE_SIZE] + 3 * o
    cx, cy, cz = load(w, at), load(w, at + L), load(w, at + 2 * L)
    zero = splat(np.float32(0.0))
    x, y, z = to_shape_frame(F, m, cx, cy, cz)
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
    height = b + b  # a cone: the larger of the distances to its base plane and its mantle
    mantle = (r * height + (z - b) * a) / vsqrt(fma(a, a, height * height))
    return vmax(mantle, zero - z - b)


@inner_njit
def shape_rate(I, F, o, w, at, velocity):
    """Return an upper bound on how fast the distance between moving points and a world shape changes, to
    check a motion for collisions with the world.

    The distance is that of `shape_gap`; the velocities are at w[velocity:]. These gaps are convex functions
    of the point, so along a straight motion a gap is never below its tangent: only the velocity component
    along the gradient of the gap brings the point closer.
    """
    kind, m, size = I[I[SHAPE_KIND] + o], I[SHAPE_POSE] + 12 * o, I[SHAPE_SIZE] + 3 * o
    cx, cy, cz = load(w, at), load(w, at + L), load(w, at + 2 * L)
    ux, uy, uz = load(w, velocity), load(w, velocity + L), load(w, velocity + 2 * L)
    zero, tiny = splat(np.float32(0.0)), splat(np.float32(1e-12))
    x, y, z = to_shape_frame(F, m, cx, cy, cz)
    vx, vy, vz = rotate_to_shape_frame(F, m, ux, uy, uz)
    a, b = splat(F[size]), splat(F[size + 1])
    if kind == gjk.HALFSPACE:
        return vabs(vz)
    if kind == gjk.POINTS:
        gap, rate = splat(np.float32(-1e9)), zero
        for k in range(I[I[SHAPE_PLANES] + o], I[I[SHAPE_PLANES] + o + 1]):
            n = I[PLANES] + 4 * k
            d = fma(x, splat(F[n]), fma(y, splat(F[n + 1]), z * splat(F[n + 2]))) - splat(F[n + 3])
            along = fma(vx, splat(F[n]), fma(vy, splat(F[n + 1]), vz * splat(F[n + 2])))
            rate = select_lt(gap, d, along, rate)
            gap = vmax(gap, d)
        return vabs(rate)
    if kind == gjk.BOX:  # the vector from the nearest point: the excess beyond the faces
        x = x - vmax(vmin(x, a), zero - a)
        y = y - vmax(vmin(y, b), zero - b)
        c = splat(F[size + 2])
        z = z - vmax(vmin(z, c), zero - c)
    elif kind == gjk.CAPSULE:
        z = z - vmax(vmin(z, b), zero - b)
    elif kind == gjk.CYLINDER or kind == gjk.CONE:
        r = vsqrt(fma(x, x, fma(y, y, tiny)))
        out = fma(x, vx, y * vy) / r  # velocity away from the axis
        if kind == gjk.CYLINDER:
            dr, dz = vmax(r - a, zero), z - vmax(vmin(z, b), zero - b)
            return vabs(fma(dr, out, dz * vz)) / vsqrt(fma(dr, dr, fma(dz, dz, tiny)))
        height = b + b
        slope = vsqrt(fma(a, a, height * height))
        mantle = (r * height + (z - b) * a) / slope
        return vabs(select_lt(zero - z - b, mantle, (out * height + vz * a) / slope, vz))
    return vabs(fma(x, vx, fma(y, vy, z * vz))) / vsqrt(fma(x, x, fma(y, y, fma(z, z, tiny))))


@inner_njit(forceinline=True)
def _near(I, F, w, state, o, i, at, radius, more, mode):
    """Return a bit mask of the SIMD lanes in which a ball around a robot body may collide with a world shape.

    The ball is around center i, the shape is o. Also returns the gap and the gap that is required. In a
    proof, the ball is clear if its gap, shrinking at its rate, lasts for half the interval. A ball does not
    change by rotation, so only the velocity of its center counts.
    """
    gap = shape_gap(I, F, o, w, at)
    if mode & PROVE == 0:
        return mask_lt(gap, splat(radius) + more) & state[ALIVE], gap, more
    half, velocity = load(w, interval_half_width_at(I)), velocity_at(I, i)
    need = fma(half, load(w, velocity + 3 * L), more)
    lanes = mask_lt(gap, splat(radius) + need) & state[ALIVE]
    if lanes != 0:
        need = fma(half, shape_rate(I, F, o, w, at, velocity), more)
        lanes &= mask_lt(gap, splat(radius) + need)
    return lanes, gap, need


@inner_njit
def _body_to_cloud(I, F, D, w, state, s, slack, slack_pair, body, o, more, mode):
    """Test a robot body for collisions with a world shape that the kernel stores as a cloud of spheres, cubes
    or triangles.

    The shape is the bounding box of the cloud.
    """
    other = np.int64(o)  # the type that the exact tier uses; otherwise shared functions are compiled twice
    lanes = body_to_cloud(I, F, w, state, body, other, more, state[ALIVE], mode)
    if lanes == DONE:
        return True
    if lanes != 0 and queue_exact_test(I, F, D, w, state, s, slack, slack_pair, body, other, lanes, mode):
        return True
    if I[I[CLOUD] + 4 * I[I[SHAPE_CLOUD] + o] + 3] == 0:
        return False
    gap = shape_gap(I, F, o, w, center_at(I, body))  # a closed mesh
    lanes = mask_lt(gap, splat(F[I[BODY_SPHERE] + 4 * body + 3])) & state[ALIVE]
    return lanes != 0 and queue_exact_test(
        I, F, D, w, state, s, slack, slack_pair, body, other + INSIDE, lanes, mode
    )


@inner_njit
def _body_to_shape(I, F, D, w, state, s, slack, slack_pair, body, o, more, mode):
    """Test a robot body for collisions with one world shape, one group of spheres at a time. Return True if
    no further test is needed.
    """
    if I[I[SHAPE_CLOUD] + o] >= 0:
        return _body_to_cloud(I, F, D, w, state, s, slack, slack_pair, body, o, more, mode)
    f, bodies = I[I[FRAME] + body], I[BODIES]
    first_sphere = bodies + I[GROUPS]
    # The inner ball proves contact only if the gap is exact, not a lower bound.
    certain = I[I[SHAPE_KIND] + o] != gjk.CONE and I[I[SHAPE_KIND] + o] != gjk.POINTS
    open_lanes = np.int64(0)
    for g in range(I[I[BODY_GROUPS] + body], I[I[BODY_GROUPS] + body + 1]):
        sphere = I[GROUP_SPHERE] + 4 * g
        at = center(I, F, w, state, bodies + g, f, sphere, mode)
        lanes, gap, need = _near(I, F, w, state, o, bodies + g, at, F[sphere + 3], more, mode)
        if lanes == 0:
            continue
        for k in range(I[I[GROUP_SPHERES] + g], I[I[GROUP_SPHERES] + g + 1]):
            sphere = I[SPHERE] + 5 * k
            at = center(I, F, w, state, first_sphere + k, f, sphere, mode)
            lanes, gap, need = _near(I, F, w, state, o, first_sphere + k, at, F[sphere + 3], more, mode)
            if lanes == 0:
                continue
            if mode & EXACT == 0:
                if record_collision(state, lanes, mode):
                    return True
                continue
            if certain and F[sphere + 4] > 0:
                surely = mask_lt(gap, splat(F[sphere + 4] + np.float32(s[gjk.CLOSE]))) & lanes
                if surely != 0 and record_contact(state, surely, mode):
                    return True
                # If the inner ball is too near, no exact test can prove the lane free.
                surely = mask_lt(gap, splat(F[sphere + 4]) + need) & lanes
                if surely != 0 and record_collision(state, surely, mode):
                    return True
            open_lanes |= lanes & state[ALIVE]
    open_lanes &= state[ALIVE]
    return open_lanes != 0 and queue_exact_test(
        I, F, D, w, state, s, slack, slack_pair, body, o, open_lanes, mode
    )


@inner_njit
def world_block(I, F, D, w, state, s, slack, slack_pair, mode):
    """Test all robot bodies for collisions with the world in a block of 16 configurations. Return True if no
    further test is needed.

    See `_check_arrays`.
    """
    for body in range(I[BODIES] - 1, -1, -1):  # the tip's bodies first: they touch most often
        f = I[I[FRAME] + body]
        if f == 0:
            continue
        sphere = I[BODY_SPHERE] + 4 * body
        at, radius = center(I, F, w, state, body, f, sphere, mode), F[sphere + 3]
        pad = F[I[PADDING] + body] if mode & PADDED else np.float32(0.0)
        more = splat(np.float32(0.0))
        r = splat(radius + pad)
        if mode & PROVE:
            more = motion_margin(I, F, w, I[RATE] + I[DOF] * body, slack[body])
            store(w, body_margin_at(I, body), more)
            r = fma(load(w, interval_half_width_at(I)), load(w, velocity_at(I, body) + 3 * L), r + more)
        x, y, z = load(w, at), load(w, at + L), load(w, at + 2 * L)
        lx, ly, lz, hx, hy, hz = hmin(x - r), hmin(y - r), hmin(z - r), hmax(x + r), hmax(y + r), hmax(z + r)
        top = 1
        state[STACK] = 0
        while top > 0:
            top -= 1
            block = state[STACK + top]
            hit = boxes_hit(F, I[BOXES] + block * 6 * L, lx, ly, lz, hx, hy, hz)
            while hit != 0:
                o = I[I[CHILD] + block * L + trailing_zeros(hit)]
                hit &= hit - 1
                if o < 0:  # a block of boxes further down
                    if top < MAX_STACK // 2:  # 16 ** 8 shapes fit; a cloud's stack is above
                        state[STACK + top] = -o
                        top += 1
                    continue
                pad = F[I[MARGIN] + I[OBJECTS] * body + I[I[SHAPE_OBJECT] + o]]
                if pad < 0.0:
                    continue
                extra = more + splat(pad) if mode & PADDED else more
                lanes, _gap, _need = _near(I, F, w, state, o, body, at, radius, extra, mode)
                if lanes != 0 and _body_to_shape(
                    I, F, D, w, state, s, slack, slack_pair, body, o, extra, mode
                ):
                    return True
    return False
