"""Workspace of the kernel: where its arrays store the values of the SIMD lanes and the results of a check.

Everywhere in the kernel, `I`, `F`, `D` are the flat arrays of the pack (`pack`), `w` is the workspace of
the lanes, `state` its integers, and `s` float64 scratch memory; all are bare pointers (`simd`). Velocities
are per unit of the edge on which the lanes are.
"""

from __future__ import annotations

import numpy as np

from armcell._inner_njit import inner_njit
from armcell.collision.kernel import gjk
from armcell.collision.kernel.cover import GROUP
from armcell.collision.kernel.pack import BODIES, DOF, FRAMES, GROUPS, SPHERES, Flat
from armcell.collision.kernel.simd import L

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
    """Return where the workspace array `w` stores the travel of joint j along the current edge of a
    motion.
    """
    return (I[DOF] + j) * L


@inner_njit(forceinline=True)
def interval_half_width_at(I):
    """Return where the workspace array `w` stores the half width of the motion interval to certify. It has
    one value per SIMD lane.

    The joints' summed rotation in the interval is stored next.
    """
    return 2 * I[DOF] * L


@inner_njit(forceinline=True)
def required_distance_at(I):
    """Return where the workspace array `w` stores the inputs of an exact test: the required distance [m] and
    the relative velocity of two bodies (8 SIMD vectors).
    """
    return (2 * I[DOF] + 2) * L


@inner_njit(forceinline=True)
def frame_at(I, f):
    """Return where the workspace array `w` stores a link frame: a 3x4 matrix, row by row, with one SIMD
    vector per entry.
    """
    return (2 * I[DOF] + 10 + 12 * f) * L


@inner_njit(forceinline=True)
def twist_at(I, f):
    return (2 * I[DOF] + 10 + 12 * I[FRAMES] + 6 * f) * L


@inner_njit(forceinline=True)
def center_at(I, i):
    """Return where the workspace array `w` stores the center of a body, sphere group or sphere.

    Index i counts bodies first, then groups (bodies + i), then spheres (bodies + groups + i).
    """
    return (2 * I[DOF] + 10 + 18 * I[FRAMES] + 3 * i) * L


@inner_njit(forceinline=True)
def velocity_at(I, i):
    """Return where the workspace array `w` stores the velocity vector of a sphere center. The norm of the
    vector (speed) follows it.

    Both are per unit of the edge.
    """
    return center_at(I, I[BODIES] + I[GROUPS] + I[SPHERES]) + 4 * i * L


@inner_njit(forceinline=True)
def body_margin_at(I, body):
    """Return where the workspace array `w` stores the margin that the kernel adds to a body's size to certify
    a motion.

    The margin covers deviations and changes of velocity, but not the motion at constant speed
    (see `motion_margin`).
    """
    return velocity_at(I, I[BODIES] + I[GROUPS] + I[SPHERES]) + body * L


@inner_njit(forceinline=True)
def local_at(I):
    """Return where the workspace array `w` stores a sphere group's centers and velocities, transformed to a
    cloud's frame.

    Each sphere has 6 vectors.
    """
    return body_margin_at(I, I[BODIES])


@inner_njit(forceinline=True)
def ball_at(I):
    """Return where the workspace array `w` stores a sphere group's bounding ball, in the frame of the cloud
    under test.
    """
    return local_at(I) + 6 * GROUP * L


@inner_njit
def record_collision(state, lanes, mode):
    """Record in the kernel's workspace that the configurations in some SIMD lanes are not collision-free.
    Return True if the collision check can stop early.
    """
    state[ALIVE] &= ~lanes
    return mode & PROVE == 0 or state[ALIVE] == 0


@inner_njit
def record_contact(state, lanes, mode):
    """Record in the kernel's workspace that the configurations in some SIMD lanes are in contact. Return True
    if the collision check can stop early.
    """
    state[TOUCHING] |= lanes
    return record_collision(state, lanes, mode) or mode & FIRST != 0
