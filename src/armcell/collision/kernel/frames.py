"""Forward kinematics of 16 configurations at once: link frames, their twists, and centers of spheres.

See `workspace` for the arrays of the arguments.
"""

from __future__ import annotations

import numpy as np

from armcell._inner_njit import inner_njit
from armcell.collision.kernel.pack import (
    COLUMN,
    DOF,
    FIXED,
    FRAMES,
    KIND,
    MULTIPLIER,
    OFFSET,
    PARENT,
)
from armcell.collision.kernel.simd import L, fma, load, select_lt, splat, store, vabs, vround, vsqrt
from armcell.collision.kernel.workspace import (
    NOW,
    PROVE,
    STAMPS,
    center_at,
    frame_at,
    interval_half_width_at,
    rate_at,
    twist_at,
    velocity_at,
)

# pyright: reportCallIssue=false
# Numba calls intrinsics without their typing context, and splices tuples into compiled calls.

REVOLUTE = 1


@inner_njit(forceinline=True)
def _sincos(x):
    """Compute the sine and cosine of joint angles in SIMD lanes, to compute link frames. The error is below
    1e-6 for |x| < 1000.
    """
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
    g = f - two * vround(f * half - quarter)  # 0 or 1: change both signs
    sign = one - two * g
    sine = select_lt(half, odd, c, s) * sign
    cosine = select_lt(half, odd, splat(np.float32(0.0)) - s, c) * sign
    return sine, cosine


@inner_njit
def fk_block(I, F, w):
    """Compute the link frames of 16 configurations by forward kinematics.

    The positions of joint j are at w[j * L:].
    """
    zero, one = splat(np.float32(0.0)), splat(np.float32(1.0))
    base = frame_at(I, 0)
    for i in range(12):
        store(w, base + i * L, one if i % 5 == 0 else zero)
    for f in range(1, I[FRAMES]):
        src, dst, m = frame_at(I, I[I[PARENT] + f]), frame_at(I, f), I[FIXED] + 12 * f
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


@inner_njit
def twist_block(I, F, w):
    """Compute the twists of all link frames along the current edge of a motion, for 16 configurations at
    once.

    A twist is the angular velocity and the velocity of the origin. Run `fk_block` before. The function also
    sums up the rotation of all revolute joints, which bounds the change of the velocities.
    """
    zero, turning = splat(np.float32(0.0)), splat(np.float32(0.0))
    base = twist_at(I, 0)
    for i in range(6):
        store(w, base + i * L, zero)
    for f in range(1, I[FRAMES]):
        p = I[I[PARENT] + f]
        src, dst, frame, parent = twist_at(I, p), twist_at(I, f), frame_at(I, f), frame_at(I, p)
        wx, wy, wz = load(w, src), load(w, src + L), load(w, src + 2 * L)
        rx = load(w, frame + 3 * L) - load(w, parent + 3 * L)
        ry = load(w, frame + 7 * L) - load(w, parent + 7 * L)
        rz = load(w, frame + 11 * L) - load(w, parent + 11 * L)
        vx = load(w, src + 3 * L) + wy * rz - wz * ry
        vy = load(w, src + 4 * L) + wz * rx - wx * rz
        vz = load(w, src + 5 * L) + wx * ry - wy * rx
        rate = load(w, rate_at(I, I[I[COLUMN] + f])) * splat(F[I[MULTIPLIER] + f])
        ax, ay, az = (
            load(w, frame + 2 * L) * rate,
            load(w, frame + 6 * L) * rate,
            load(w, frame + 10 * L) * rate,
        )
        turns = I[I[KIND] + f] == REVOLUTE
        store(w, dst, wx + ax if turns else wx)
        store(w, dst + L, wy + ay if turns else wy)
        store(w, dst + 2 * L, wz + az if turns else wz)
        store(w, dst + 3 * L, vx if turns else vx + ax)
        store(w, dst + 4 * L, vy if turns else vy + ay)
        store(w, dst + 5 * L, vz if turns else vz + az)
        turning = turning + (vabs(rate) if turns else zero)
    store(w, interval_half_width_at(I) + L, turning)


@inner_njit(forceinline=True)
def center(I, F, w, state, i, f, sphere, mode):
    """Transform a sphere's center by its link frame in 16 configurations, only once per collision check.
    Return the index of the transformed center in the workspace array `w`.

    The center is F[sphere:] in frame f. In a proof, its velocity and speed are computed as well.
    """
    at = center_at(I, i)
    if state[STAMPS + i] != state[NOW]:
        state[STAMPS + i] = state[NOW]
        frame = frame_at(I, f)
        x, y, z = splat(F[sphere]), splat(F[sphere + 1]), splat(F[sphere + 2])
        for k in range(3):
            row = frame + 4 * k * L
            value = fma(
                load(w, row), x, fma(load(w, row + L), y, fma(load(w, row + 2 * L), z, load(w, row + 3 * L)))
            )
            store(w, at + k * L, value)
        if mode & PROVE:
            out, twist = velocity_at(I, i), twist_at(I, f)
            rx = load(w, at) - load(w, frame + 3 * L)
            ry = load(w, at + L) - load(w, frame + 7 * L)
            rz = load(w, at + 2 * L) - load(w, frame + 11 * L)
            wx, wy, wz = load(w, twist), load(w, twist + L), load(w, twist + 2 * L)
            vx = load(w, twist + 3 * L) + wy * rz - wz * ry
            vy = load(w, twist + 4 * L) + wz * rx - wx * rz
            vz = load(w, twist + 5 * L) + wx * ry - wy * rx
            store(w, out, vx)
            store(w, out + L, vy)
            store(w, out + 2 * L, vz)
            store(w, out + 3 * L, vsqrt(fma(vx, vx, fma(vy, vy, vz * vz))))
    return at


@inner_njit
def motion_margin(I, F, w, reach, slack):
    """Return the margin that is added to a body's spheres when the kernel certifies a motion. It covers path
    deviations and changes of velocity.

    A proof needs this margin in addition to half width times speed. The accelerations of a body's points are
    at most the joints' summed rotation times `reach` (index in F: meters per unit of each joint), doubled for
    prismatic joints. This bound times the squared half width covers the motion that the velocity in the
    middle of the interval does not include.
    """
    at = interval_half_width_at(I)
    total = splat(np.float32(0.0))
    for j in range(I[DOF]):
        total = fma(vabs(load(w, rate_at(I, j))), splat(F[reach + j]), total)
    half = load(w, at)
    return fma(half * half, load(w, at + L) * total, splat(slack))
