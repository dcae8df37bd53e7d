"""Proof of which sphere groups of two bodies never come near, at any joint positions.

Neighboring bodies of an arm are always close, so bounding spheres never separate them, although most of their
sphere groups cannot meet. For bodies with few joints between them, this is proven once by branch and bound
over the joint ranges, and the kernel checks only the remaining groups.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from armcell._array_store import key_of, recall_or_compute

F64 = NDArray[np.float64]

MAX_JOINTS = 2
VERSION = 1  # increase when the results of `meeting_groups` change, to invalidate the disk cache
SMALLEST = 4e-3  # [m] boxes of joint values with less motion are not divided
APART = 1e-4  # [m] distance to be proven
BEYOND = 0.02  # [rad, m] extension of the joint ranges beyond the limits


class Frames(NamedTuple):
    """Moving frames of a robot, bundled as one argument of the compiled search for sphere groups that can
    come near each other.

    Attributes:
        fixed: (f, 12) pose of each frame in its parent frame at joint value 0, rows of a 3x4 matrix.
        kind: (f,) 1 for a joint that turns about z, otherwise the joint slides along z.
        multiplier, offset: (f,) joint value = multiplier * variable + offset [rad or m].
        column: (f,) index of the variable that moves each frame.
    """

    fixed: Any
    kind: Any
    multiplier: Any
    offset: Any
    column: Any


class SphereGroups(NamedTuple):
    """Sphere groups (g) of one robot body, as one argument of the compiled search for groups that can come
    near each other.

    Attributes:
        branch: indices of the frames from below the common frame of both bodies down to the body's frame.
        reach: (g, k) upper bounds [m] of the motion of a group's points per unit of each variable.
        groups: (g, 4) center and radius [m] of each group's bounding sphere, in the body's frame.
        starts: (g + 1,) index of each group's first sphere, and the number of spheres.
        spheres: (s, 4) center and radius [m] of each sphere, in the body's frame.
    """

    branch: Any
    reach: Any
    groups: Any
    starts: Any
    spheres: Any


@njit(cache=True)
def _place(branch, frames, q, out):
    """Compute the pose (3, 4) of the last frame of a kinematic branch relative to its first frame, to find
    sphere groups that can come near each other.
    """
    for i in range(3):
        for j in range(4):
            out[i, j] = 1.0 if i == j else 0.0
    fixed, T = frames.fixed, np.empty((3, 4))
    for f in branch:
        for i in range(3):
            for j in range(4):
                T[i, j] = out[i, 0] * fixed[f, j] + out[i, 1] * fixed[f, 4 + j] + out[i, 2] * fixed[f, 8 + j]
            T[i, 3] += out[i, 3]
        turns = frames.kind[f] == 1
        value = frames.multiplier[f] * q[frames.column[f]] + frames.offset[f]
        c, s = (np.cos(value), np.sin(value)) if turns else (1.0, 0.0)
        for i in range(3):
            out[i, 0] = T[i, 0] * c + T[i, 1] * s
            out[i, 1] = T[i, 1] * c - T[i, 0] * s
            out[i, 2] = T[i, 2]
            out[i, 3] = T[i, 3] + (0.0 if turns else value * T[i, 2])


@njit(cache=True)
def _apply(T, balls, out):
    for k in range(len(balls)):
        for i in range(3):
            out[k, i] = T[i, 0] * balls[k, 0] + T[i, 1] * balls[k, 1] + T[i, 2] * balls[k, 2] + T[i, 3]


@njit(cache=True)
def _gap(a, ra, b, rb):
    return np.sqrt((a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 + (a[2] - b[2]) ** 2) - ra - rb


@njit(cache=True)
def _spheres_gap(first, first_end, a, ra, second, second_end, b, rb):
    best = 1e9
    for m in range(first, first_end):
        for n in range(second, second_end):
            best = min(best, _gap(a[m], ra[m, 3], b[n], rb[n, 3]))
    return best


_known: dict[str, NDArray[np.bool_]] = {}


def cached_near_groups(
    i: SphereGroups, j: SphereGroups, frames: Frames, lower: F64, upper: F64
) -> NDArray[np.bool_]:
    """Return which sphere groups of two bodies can come near each other. The result is cached on disk.

    The arguments and the result are those of `meeting_groups`.
    """
    key = key_of(str(VERSION), *i, *j, *frames, lower, upper)
    if key not in _known:
        stored = recall_or_compute(
            "near", key, lambda: {"meeting": meeting_groups(i, j, frames, lower, upper)}
        )
        _known[key] = stored["meeting"]
    return _known[key]


@njit(cache=True)
def meeting_groups(i, j, frames, lower, upper):
    """Return a mask of the sphere groups of two bodies i and j that can come near each other: one row per
    group of i, one column per group of j.

    It is False for two groups only if they are proven more than `APART` apart at all joint positions.

    Args:
        i, j: `SphereGroups` of each body.
        frames: `Frames` of the robot.
        lower, upper: (k,) ranges of the joint variables [rad or m].
    """
    n_i, n_j, k = len(i.groups), len(j.groups), len(lower)
    meeting = np.zeros((n_i, n_j), np.bool_)
    depth_max = 64
    box = np.empty((depth_max, 2, k))
    alive = np.ones((depth_max, n_i, n_j), np.bool_)
    gi, gj = np.empty((n_i, 3)), np.empty((n_j, 3))
    si, sj = np.empty((len(i.spheres), 3)), np.empty((len(j.spheres), 3))
    Ti, Tj, q = np.empty((3, 4)), np.empty((3, 4)), np.empty(k)
    box[0, 0], box[0, 1] = lower, upper
    depth = 0
    while depth >= 0:
        lo, hi = box[depth, 0].copy(), box[depth, 1].copy()
        mine = alive[depth].copy()
        depth -= 1
        weight = np.zeros(k)  # motion that halving the range would remove
        for c in range(k):
            q[c] = 0.5 * (lo[c] + hi[c])
        _place(i.branch, frames, q, Ti)
        _place(j.branch, frames, q, Tj)
        _apply(Ti, i.groups, gi)
        _apply(Tj, j.groups, gj)
        _apply(Ti, i.spheres, si)
        _apply(Tj, j.spheres, sj)
        left = False
        for a in range(n_i):
            for b in range(n_j):
                if not mine[a, b] or meeting[a, b]:
                    mine[a, b] = False
                    continue
                motion = 0.0
                for c in range(k):
                    motion += 0.5 * (hi[c] - lo[c]) * (i.reach[a, c] + j.reach[b, c])
                gap = _gap(gi[a], i.groups[a, 3], gj[b], j.groups[b, 3])
                if gap < motion + APART:
                    gap = _spheres_gap(i.starts[a], i.starts[a + 1], si, i.spheres,
                                       j.starts[b], j.starts[b + 1], sj, j.spheres)  # fmt: skip
                if gap >= motion + APART:
                    mine[a, b] = False
                elif gap < APART or motion < SMALLEST or depth + 3 > depth_max:
                    meeting[a, b] = True
                    mine[a, b] = False
                else:
                    left = True
                    for c in range(k):
                        weight[c] += (hi[c] - lo[c]) * (i.reach[a, c] + j.reach[b, c])
        if not left:
            continue
        widest = int(np.argmax(weight))
        middle = 0.5 * (lo[widest] + hi[widest])
        for side in range(2):
            depth += 1
            box[depth, 0], box[depth, 1] = lo, hi
            box[depth, 1 - side, widest] = middle
            alive[depth] = mine
    return meeting
