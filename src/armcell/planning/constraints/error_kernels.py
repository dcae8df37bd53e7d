"""Compiled kernels for constraint errors and their derivatives by the joints (Numba).

Arguments: `n` and `c` are the constraints as flat arrays (see `manifold.py`), `x` is float64 scratch memory,
`q[at:]` are the joint positions; all of them are bare pointers.
"""

# pyright: reportCallIssue=false
# Numba calls intrinsics without their typing context, and splices tuples into compiled calls.
from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from armcell.collision.kernel.simd import at_address, pointer
from armcell.kinematics.ik.chain import COLUMN, MULTIPLIER, OFFSET, SLIDE, WIDTH

# Header of `n`: counts, and the offsets of the tables.
DOF, LINKS, TURNS, POINTS, AT_LINKS, AT_TURNS, AT_POINTS, AT_SHAPES, WORK = range(9)
HEADER = 9
# A link: number of moving joints above it, offsets of its table and base in `c`, of its pose and axes in `x`.
JOINTS, TABLE, BASE, PLACE, LINK_WIDTH = range(5)
# An orientation: its link, whether by Euler angles, its numbers in `c`: transposed desired rotation (9),
# full tolerances (3), planning tolerances (3).
EULER, NUMBERS, TURN_WIDTH = 1, 2, 3
FULL, INNER = 9, 12
# A point in a region: its link, first shape, shapes, its numbers in `c`: point (3), reach per joint (dof).
FIRST_SHAPE, SHAPES, POINT_NUMBERS, POINT_WIDTH = 1, 2, 3, 4
# A shape: kind, its numbers in `c`: T_shape_world (12), full sizes (3), planning sizes (3).
SHAPE_WIDTH = 2
SIZE, INNER_SIZE = 12, 15
BOX, BALL, CYLINDER, CAPSULE, HALF_SPACE = range(5)

MAX_ROWS = 24
FREE = 1e9  # tolerance of an unconstrained axis
NEAR_HALF_TURN = 1e-9


def scratch_size(dof: int, places: int) -> int:
    """Compute the size, in doubles, of the scratch memory in which
    compiled kernels evaluate constraint errors.

    Layout: [link poses and axes], [errors], [Jacobian rows], [residuals], [system].
    """
    return places + 32 + MAX_ROWS * (dof + 2) + MAX_ROWS * MAX_ROWS + 4 * dof + 200


@njit(cache=True, forceinline=True)
def manifold_pointers(handle) -> Any:
    """Convert the addresses (3,) of the constraint arrays to pointers: n (integers), c (constants) and x
    (scratch memory). Kernels for constraint errors take these pointers.
    """
    return (
        at_address(np.int64, handle[0]),
        at_address(np.float64, handle[1]),
        at_address(np.float64, handle[2]),
    )


@njit(cache=True)
def place_links(n, c, x, q, at):
    """Compute the pose and the joint axes of every constrained link from joint positions, and write them to
    x, the scratch memory that all kernels for constraint errors share.

    A pose has 12 numbers, an axis 6: its direction and origin.
    """
    for link in range(n[LINKS]):
        l = n[AT_LINKS] + link * LINK_WIDTH
        b, t, o = n[l + BASE], n[l + TABLE], n[l + PLACE]
        r00, r01, r02, px = c[b], c[b + 1], c[b + 2], c[b + 3]
        r10, r11, r12, py = c[b + 4], c[b + 5], c[b + 6], c[b + 7]
        r20, r21, r22, pz = c[b + 8], c[b + 9], c[b + 10], c[b + 11]
        for k in range(n[l + JOINTS]):
            w = o + 12 + 6 * k
            x[w], x[w + 1], x[w + 2], x[w + 3], x[w + 4], x[w + 5] = r02, r12, r22, px, py, pz
            value = c[t + MULTIPLIER] * q[at + int(c[t + COLUMN])] + c[t + OFFSET]
            if c[t + SLIDE] != 0.0:
                px, py, pz = px + value * r02, py + value * r12, pz + value * r22
            else:
                cos, sin = np.cos(value), np.sin(value)
                r00, r01 = cos * r00 + sin * r01, cos * r01 - sin * r00
                r10, r11 = cos * r10 + sin * r11, cos * r11 - sin * r10
                r20, r21 = cos * r20 + sin * r21, cos * r21 - sin * r20
            px += r00 * c[t + 3] + r01 * c[t + 7] + r02 * c[t + 11]
            py += r10 * c[t + 3] + r11 * c[t + 7] + r12 * c[t + 11]
            pz += r20 * c[t + 3] + r21 * c[t + 7] + r22 * c[t + 11]
            r00, r01, r02 = (
                r00 * c[t] + r01 * c[t + 4] + r02 * c[t + 8],
                r00 * c[t + 1] + r01 * c[t + 5] + r02 * c[t + 9],
                r00 * c[t + 2] + r01 * c[t + 6] + r02 * c[t + 10],
            )
            r10, r11, r12 = (
                r10 * c[t] + r11 * c[t + 4] + r12 * c[t + 8],
                r10 * c[t + 1] + r11 * c[t + 5] + r12 * c[t + 9],
                r10 * c[t + 2] + r11 * c[t + 6] + r12 * c[t + 10],
            )
            r20, r21, r22 = (
                r20 * c[t] + r21 * c[t + 4] + r22 * c[t + 8],
                r20 * c[t + 1] + r21 * c[t + 5] + r22 * c[t + 9],
                r20 * c[t + 2] + r21 * c[t + 6] + r22 * c[t + 10],
            )
            t += WIDTH
        x[o], x[o + 1], x[o + 2], x[o + 3] = r00, r01, r02, px
        x[o + 4], x[o + 5], x[o + 6], x[o + 7] = r10, r11, r12, py
        x[o + 8], x[o + 9], x[o + 10], x[o + 11] = r20, r21, r22, pz


@njit(cache=True)
def orientation_error(n, c, x, turn):
    """Compute, in a compiled kernel, the error (3,) of an orientation constraint and its derivative (3x3
    matrix). Write the error to x[work:] and the derivative to x[work + 3:] in the scratch memory x.

    The matrix maps the link's angular velocity in the world to the rate of the error. Call `place_links`
    first. A rotation vector e changes by the inverse left Jacobian of SO(3), 1 - [e]/2 + k [e]^2. Euler
    angles use R = Rx(a) Ry(b) Rz(c).
    """
    t = n[AT_TURNS] + turn * TURN_WIDTH
    at, o, e = n[t + NUMBERS], n[n[AT_LINKS] + n[t] * LINK_WIDTH + PLACE], n[WORK]
    g, r = e + 3, e + 12
    for i in range(3):  # R = wanted^T present, in x[r:]
        for j in range(3):
            x[r + 3 * i + j] = (
                c[at + 3 * i] * x[o + j] + c[at + 3 * i + 1] * x[o + 4 + j] + c[at + 3 * i + 2] * x[o + 8 + j]
            )
    if n[t + EULER] != 0:
        cb = np.sqrt(x[r] * x[r] + x[r + 1] * x[r + 1])
        a, b = np.arctan2(-x[r + 5], x[r + 8]), np.arctan2(x[r + 2], cb)
        if cb < 1e-9:
            a, cb = 0.0, 1e-9
        x[e], x[e + 1], x[e + 2] = a, b, np.arctan2(-x[r + 1], x[r])
        sa, ca, tb = np.sin(a), np.cos(a), np.sin(b) / cb
        x[r], x[r + 1], x[r + 2] = 1.0, tb * sa, -tb * ca
        x[r + 3], x[r + 4], x[r + 5] = 0.0, ca, sa
        x[r + 6], x[r + 7], x[r + 8] = 0.0, -sa / cb, ca / cb
    else:
        ax, ay, az = x[r + 7] - x[r + 5], x[r + 2] - x[r + 6], x[r + 3] - x[r + 1]
        sine = 0.5 * np.sqrt(ax * ax + ay * ay + az * az)
        cosine = 0.5 * (x[r] + x[r + 4] + x[r + 8] - 1.0)
        angle = np.arctan2(sine, cosine)
        if sine > NEAR_HALF_TURN or cosine > 0.0:
            f = 0.5 * angle / sine if sine > NEAR_HALF_TURN else 0.5
            ax, ay, az = f * ax, f * ay, f * az
        else:  # half a turn: the axis is the longest column of R + 1
            best = 0
            for j in range(1, 3):
                if x[r + 4 * j] > x[r + 4 * best]:
                    best = j
            f = np.pi / np.sqrt(2.0 * (1.0 + x[r + 4 * best]))
            ax = f * (x[r + best] + (1.0 if best == 0 else 0.0))
            ay = f * (x[r + 3 + best] + (1.0 if best == 1 else 0.0))
            az = f * (x[r + 6 + best] + (1.0 if best == 2 else 0.0))
        x[e], x[e + 1], x[e + 2] = ax, ay, az
        half = 0.5 * angle
        k = 1.0 / 12 + angle * angle / 720 if angle < 1e-2 else (1 - half / np.tan(half)) / (angle * angle)
        xx, yy, zz = ax * ax, ay * ay, az * az
        x[r], x[r + 1], x[r + 2] = 1 - k * (yy + zz), 0.5 * az + k * ax * ay, -0.5 * ay + k * ax * az
        x[r + 3], x[r + 4], x[r + 5] = -0.5 * az + k * ax * ay, 1 - k * (xx + zz), 0.5 * ax + k * ay * az
        x[r + 6], x[r + 7], x[r + 8] = 0.5 * ay + k * ax * az, -0.5 * ax + k * ay * az, 1 - k * (xx + yy)
    for i in range(3):
        for j in range(3):
            x[g + 3 * i + j] = (
                x[r + 3 * i] * c[at + j] + x[r + 3 * i + 1] * c[at + 3 + j] + x[r + 3 * i + 2] * c[at + 6 + j]
            )


@njit(cache=True)
def point_at(n, c, x, point):
    """Compute the world position [m] of the point that a position constraint restricts. Kernels for
    constraint errors call it.

    This compiled kernel takes the pose of the point's link from the scratch memory x. Call `place_links`
    first.
    """
    t = n[AT_POINTS] + point * POINT_WIDTH
    at, o = n[t + POINT_NUMBERS], n[n[AT_LINKS] + n[t] * LINK_WIDTH + PLACE]
    a, b, d = c[at], c[at + 1], c[at + 2]
    return (
        x[o] * a + x[o + 1] * b + x[o + 2] * d + x[o + 3],
        x[o + 4] * a + x[o + 5] * b + x[o + 6] * d + x[o + 7],
        x[o + 8] * a + x[o + 9] * b + x[o + 10] * d + x[o + 11],
    )


@njit(cache=True)
def signed_distance(n, c, shape, sizes, px, py, pz):
    """Compute the signed distance [m] from a world point to a convex shape of a constraint region. Kernels
    for constraint errors call it.

    `sizes` is the offset of the shape's sizes: SIZE or INNER_SIZE.
    """
    s = n[AT_SHAPES] + shape * SHAPE_WIDTH
    kind, at = n[s], n[s + 1]
    a = c[at] * px + c[at + 1] * py + c[at + 2] * pz + c[at + 3]
    b = c[at + 4] * px + c[at + 5] * py + c[at + 6] * pz + c[at + 7]
    d = c[at + 8] * px + c[at + 9] * py + c[at + 10] * pz + c[at + 11]
    u, v, w = c[at + sizes], c[at + sizes + 1], c[at + sizes + 2]
    if kind == BOX:
        a, b, d = abs(a) - u, abs(b) - v, abs(d) - w
        inside = min(max(a, b, d), 0.0)
        a, b, d = max(a, 0.0), max(b, 0.0), max(d, 0.0)
        return inside + np.sqrt(a * a + b * b + d * d)
    if kind == BALL:
        return np.sqrt(a * a + b * b + d * d) - u
    if kind == CYLINDER:
        a, d = np.sqrt(a * a + b * b) - u, abs(d) - v
        inside = min(max(a, d), 0.0)
        a, d = max(a, 0.0), max(d, 0.0)
        return inside + np.sqrt(a * a + d * d)
    if kind == CAPSULE:
        d = max(abs(d) - v, 0.0)
        return np.sqrt(a * a + b * b + d * d) - u
    return d + u  # HALF_SPACE


@njit(cache=True)
def nearest_region_shape(n, c, point, sizes, px, py, pz):
    """Find which shape of a constraint region is nearest to a world point. Compiled kernels compute the
    constraint's error from the distance to this shape.

    Returns:
        The number of the shape, and the signed distance [m] from the point to this shape.
    """
    t = n[AT_POINTS] + point * POINT_WIDTH
    best, least = n[t + FIRST_SHAPE], 1e300
    for shape in range(n[t + FIRST_SHAPE], n[t + FIRST_SHAPE] + n[t + SHAPES]):
        far = signed_distance(n, c, shape, sizes, px, py, pz)
        if far < least:
            best, least = shape, far
    return best, least


@njit(cache=True)
def within_tolerances(n, c, x, q, at, inner):
    """Return whether joint positions satisfy all constraints within their tolerances, evaluated by a compiled
    error kernel.

    `inner` selects the planning tolerances instead of the full tolerances.
    """
    place_links(n, c, x, q, at)
    for turn in range(n[TURNS]):
        orientation_error(n, c, x, turn)
        numbers = n[n[AT_TURNS] + turn * TURN_WIDTH + NUMBERS] + (INNER if inner else FULL)
        for i in range(3):
            if abs(x[n[WORK] + i]) > c[numbers + i]:
                return False
    for point in range(n[POINTS]):
        px, py, pz = point_at(n, c, x, point)
        if nearest_region_shape(n, c, point, INNER_SIZE if inner else SIZE, px, py, pz)[1] > 0.0:
            return False
    return True


@njit(cache=True, nogil=True)
def evaluate_errors(handle, q, out):
    """Evaluate the compiled error kernel of all constraints at joint positions (dof,), and write the errors
    to `out`.

    Orientation errors come first, per axis [rad]; then each point's signed distance [m] to its region,
    negative inside. Takes arrays instead of pointers.
    """
    n, c, x = manifold_pointers(handle)
    place_links(n, c, x, pointer(q), 0)
    for turn in range(n[TURNS]):
        orientation_error(n, c, x, turn)
        for i in range(3):
            out[3 * turn + i] = x[n[WORK] + i]
    for point in range(n[POINTS]):
        px, py, pz = point_at(n, c, x, point)
        out[3 * n[TURNS] + point] = nearest_region_shape(n, c, point, SIZE, px, py, pz)[1]
