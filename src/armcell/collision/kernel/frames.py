"""Forward kinematics of 16 configurations at once, and the workspace of the SIMD lanes with their results.

Everywhere in the kernel, `I`, `F`, `D` are the flat arrays of the pack (`pack`), `w` is the workspace of
the lanes, `state` its integers (`workspace`), and `s` float64 scratch memory; all are bare pointers
(`simd`). Velocities are per unit of the edge on which the lanes are.
"""

from __future__ import annotations

import numpy as np

from armcell._inner_njit import inner_njit
from armcell.collision.kernel import gjk
from armcell.collision.kernel.cover import GROUP
from armcell.collision.kernel.pack import (
    BODIES,
    COLUMN,
    DOF,
    FIXED,
    FRAMES,
    GROUPS,
    KIND,
    MULTIPLIER,
    OFFSET,
    PARENT,
    SPHERES,
    Flat,
)
from armcell.collision.kernel.simd import L, fma, load, select_lt, splat, store, vabs, vround, vsqrt

# pyright: reportCallIssue=false
# Numba calls intrinsics without their typing context, and splices tuples into compiled calls.


REVOLUTE = 1

EXACT, PADDED, PROVE, FIRST, STILL = 1, 2, 4, 8, 16  # bits of `mode`, see `_check_arrays`

# Contents of `state`: number of the block, undecided lanes (bits), lanes that certainly touch (bits), and the
# pairs that wait for the exact tier (three numbers each); then the blocks in which the centers were computed,
# and the stack of the walk through the world's boxes (a cloud's boxes are above them in the stack).
NOW, ALIVE, TOUCHING, WAITING, ENTRIES = 0, 1, 2, 3, 4
MAX_WAITING = 64
STACK = ENTRIES + 3 * MAX_WAITING
MAX_STACK = 256
LISTED = STACK + MAX_STACK  # parts of a cloud that wait for the exact tier, in one lane
MAX_LISTED = 512
PLACED = LISTED + MAX_LISTED  # the group whose spheres are transformed to a cloud's frame
STAMPS = PLACED + 1

# Indices in the float64 scratch of the transforms of exact pieces: A, B and A in B's frame.
AT_A, AT_B, AT_RELATIVE = gjk.SCRATCH, gjk.SCRATCH + 12, gjk.SCRATCH + 24
SCRATCH = gjk.SCRATCH + 36

Workspace = tuple[np.ndarray, np.ndarray, np.ndarray]


def workspace(flat: Flat) -> Workspace:
    """Allocate the workspace of the kernel for one thread: link frames and other values per SIMD lane
    (float32), state (int64) and scratch memory (float64).

    The lanes are 64-byte aligned and hold, in this order:

    - positions (dof); motion of each joint per unit of the edge (dof); half the width of each lane's interval
      in that unit; the joints' summed rotation in the interval; 8 vectors of the exact tier
    - frames (12 each), their twists (6 each: angular velocity, velocity of the origin), centers (3 each)
    - in a proof: velocities and speeds of the centers (4 each), and margins of the bodies without speed
    - centers and velocities (6 each) of one group's spheres in a cloud's frame, and their bounding ball (4)
    """
    I = flat[0]
    centers = int(I[BODIES] + I[GROUPS] + I[SPHERES])
    size = int(2 * I[DOF] + 10 + 18 * I[FRAMES] + 7 * centers + I[BODIES] + 6 * GROUP + 4) * L
    raw = np.zeros(size + 16, np.float32)
    start = (-raw.ctypes.data % 64) // 4
    return raw[start : start + size], np.zeros(STAMPS + centers, np.int64), np.zeros(SCRATCH, np.float64)


@inner_njit(forceinline=True)
def rate_at(I, j):
    """Return where the workspace array `w`, which also holds the link frames, stores the travel of joint j
    along the current edge of a motion.
    """
    return (I[DOF] + j) * L


@inner_njit(forceinline=True)
def interval_half_width_at(I):
    """Return where the workspace array `w`, which also holds the link frames, stores the half width of the
    motion interval to certify. It has one value per SIMD lane.

    The joints' summed rotation in the interval is stored next.
    """
    return 2 * I[DOF] * L


@inner_njit(forceinline=True)
def required_distance_at(I):
    """Return where the workspace array `w` of link frames stores the inputs of an exact test: the required
    distance [m] and the relative velocity of two bodies (8 SIMD vectors).
    """
    return (2 * I[DOF] + 2) * L


@inner_njit(forceinline=True)
def frame_at(I, f):
    """Return the index of a link frame in the kernel's workspace array `w`. The frame is stored as a 3x4
    matrix, row by row, with one SIMD vector per entry.
    """
    return (2 * I[DOF] + 10 + 12 * f) * L


@inner_njit(forceinline=True)
def twist_at(I, f):
    return (2 * I[DOF] + 10 + 12 * I[FRAMES] + 6 * f) * L


@inner_njit(forceinline=True)
def center_at(I, i):
    """Return where the workspace array `w` of link frames stores the center of a body, sphere group or
    sphere.

    Index i counts bodies first, then groups (bodies + i), then spheres (bodies + groups + i).
    """
    return (2 * I[DOF] + 10 + 18 * I[FRAMES] + 3 * i) * L


@inner_njit(forceinline=True)
def velocity_at(I, i):
    """Return where the workspace array `w` of link frames stores the velocity vector of a sphere center. The
    norm of the vector (speed) follows it.

    Both are per unit of the edge.
    """
    return center_at(I, I[BODIES] + I[GROUPS] + I[SPHERES]) + 4 * i * L


@inner_njit(forceinline=True)
def body_margin_at(I, body):
    """Return where the workspace array `w` of link frames stores the margin that the kernel adds to a body's
    size to certify a motion.

    The margin covers deviations and changes of velocity, but not the motion at constant speed
    (see `motion_margin`).
    """
    return velocity_at(I, I[BODIES] + I[GROUPS] + I[SPHERES]) + body * L


@inner_njit(forceinline=True)
def local_at(I):
    """Return where the workspace array `w` of link frames stores a sphere group's centers and velocities,
    transformed to a cloud's frame.

    Each sphere has 6 vectors.
    """
    return body_margin_at(I, I[BODIES])


@inner_njit(forceinline=True)
def ball_at(I):
    """Return where the workspace array `w` of link frames stores a sphere group's bounding ball, in the frame
    of the cloud under test.
    """
    return local_at(I) + 6 * GROUP * L


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
    Return the index of the stored center in the workspace array `w`.

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


FREE, UNPROVEN, CONTACT = 0, 1, 2


@inner_njit
def record_collision(state, lanes, mode):
    """Record that the configurations in some SIMD lanes are not collision-free.
    Return True if the collision check can stop early.
    """
    state[ALIVE] &= ~lanes
    return mode & PROVE == 0 or state[ALIVE] == 0


@inner_njit
def record_contact(state, lanes, mode):
    """Record that the configurations in some SIMD lanes are in contact.
    Return True if the collision check can stop early.
    """
    state[TOUCHING] |= lanes
    return record_collision(state, lanes, mode) or mode & FIRST != 0
