"""Proof that a straight joint motion satisfies constraints everywhere (Numba).

The proof examines an interval of the motion q(t) = a + t d at its middle m with half width h. Poses and
velocities are exact at m; the rest is bounded:

- A joint's axis turns by at most the turning T of the joints before it (T: the sum of all revolute joints'
  |d|), so a link's angular velocity changes at a rate of at most T^2 / 2.
- A point's acceleration is at most T S, where S sums |d| times the largest distance from each joint's axis
  (twice T S with prismatic joints): the point is within h^2 T S / 2 of the straight line p + (t - m) p'. A
  region's signed distance is convex, so along this line it is largest at one end.
- A rotation vector e = log R changes by e' = G(e) u, with the angular velocity u and the inverse left
  Jacobian G of SO(3): |G| <= g = (y/2) / sin(y/2) and |G'| <= c |e'| with y = |e|. So
  |e''| <= g (T^2 / 2 + c |u|^2), and e is within h^2 / 2 times that of e + (t - m) e'. Past half a turn the
  rotation vector jumps to the other side; its components are smaller there than those of its continuation.
- Euler angles: the same with |a'|, |c'| <= |u| / cos b, |b'| <= |u|.

If these bounds do not prove an interval, it is halved.
"""

# pyright: reportCallIssue=false
# Numba calls intrinsics without their typing context, and splices tuples into compiled calls.
from __future__ import annotations

import numpy as np
from numba import njit

from armcell.collision.kernel.simd import pointer
from armcell.kinematics.ik.chain import COLUMN, MULTIPLIER, SLIDE, WIDTH
from armcell.planning.constraints.error_kernels import (
    AT_LINKS,
    AT_POINTS,
    AT_TURNS,
    DOF,
    EULER,
    FIRST_SHAPE,
    FREE,
    FULL,
    JOINTS,
    LINK_WIDTH,
    MAX_ROWS,
    NUMBERS,
    PLACE,
    POINT_NUMBERS,
    POINT_WIDTH,
    POINTS,
    SHAPES,
    SIZE,
    TABLE,
    TURN_WIDTH,
    TURNS,
    WORK,
    manifold_pointers,
    orientation_error,
    place_links,
    point_at,
    signed_distance,
)

FINEST = 2e-5  # [rad] smallest half width of an interval
DEEPEST = 48  # maximal number of pending intervals
WIDEST_TURN = 0.3  # [rad] by which an interval may turn a link to each side
KEEPS, UNKNOWN, LEAVES = 1, 0, -1


@njit(cache=True)
def _bends(angle):
    """Return two bounds (g, c) on how fast an orientation error e can change, where e is a rotation vector of
    at most `angle` [rad]. The proof of orientation constraints uses the bounds.

    With the angular velocity u: |e'| <= g |u| and |e''| <= g (|u'| + c |u|^2). Both bounds increase with the
    angle.
    """
    half = 0.5 * max(angle, 1e-2)
    g = half / np.sin(half)
    k = (1.0 - half / np.tan(half)) / (4.0 * half * half)
    slope = -0.5 * (1.0 / np.tan(half) - half / np.sin(half) ** 2) / (4.0 * half * half) - k / half
    return g, 0.5 + 4.0 * half * k + 4.0 * half * half * max(slope, 0.0)


@njit(cache=True)
def _turns(n, c, x, d, h, room, allowance):
    """Try to prove that a joint motion satisfies all orientation constraints during one interval. The result
    is KEEPS, UNKNOWN or LEAVES.
    """
    answer = KEEPS
    for turn in range(n[TURNS]):
        t = n[AT_TURNS] + turn * TURN_WIDTH
        orientation_error(n, c, x, turn)
        l, e, full = n[AT_LINKS] + n[t] * LINK_WIDTH, n[WORK], n[t + NUMBERS] + FULL
        at, o = n[l + TABLE], n[l + PLACE] + 12
        wx, wy, wz, turning, slack = 0.0, 0.0, 0.0, 0.0, 0.0
        for _ in range(n[l + JOINTS]):
            if c[at + SLIDE] == 0.0:
                j = int(c[at + COLUMN])
                rate = c[at + MULTIPLIER] * x[d + j]
                wx, wy, wz = wx + rate * x[o], wy + rate * x[o + 1], wz + rate * x[o + 2]
                turning += abs(rate)
                slack += abs(c[at + MULTIPLIER]) * room[j]
            at += WIDTH
            o += 6
        for i in range(3):
            if abs(x[e + i]) > c[full + i] + allowance:
                return LEAVES
        fastest = min(np.sqrt(wx * wx + wy * wy + wz * wz) + 0.5 * h * turning * turning, turning)
        if fastest * h + slack > WIDEST_TURN:
            answer = UNKNOWN
            continue
        if n[t + EULER] == 0:
            angle = np.sqrt(x[e] ** 2 + x[e + 1] ** 2 + x[e + 2] ** 2) + 1.75 * (fastest * h + slack)
            g, bend = _bends(min(angle, np.pi + WIDEST_TURN))
            second = g * (0.5 * turning * turning + bend * fastest * fastest)
        else:
            b = abs(x[e + 1]) + fastest * h + slack
            if b > 1.5:
                answer = UNKNOWN
                continue
            g = 1.0 / np.cos(b)
            second = 0.5 * turning * turning * (1 + g) + fastest * fastest * (1 + 2 * g * g)
        for i in range(3):
            if c[full + i] >= FREE:
                continue
            a = e + 3 + 3 * i
            largest = abs(x[e + i]) + h * abs(x[a] * wx + x[a + 1] * wy + x[a + 2] * wz)
            if largest + 0.5 * h * h * second + g * slack > c[full + i] + allowance:
                answer = UNKNOWN
    return answer


@njit(cache=True)
def _points(n, c, x, d, h, room, allowance):
    """Try to prove that a joint motion satisfies all position constraints during one interval. The result is
    KEEPS, UNKNOWN or LEAVES.
    """
    dof, answer = n[DOF], KEEPS
    for point in range(n[POINTS]):
        t = n[AT_POINTS] + point * POINT_WIDTH
        l, reach = n[AT_LINKS] + n[t] * LINK_WIDTH, n[t + POINT_NUMBERS] + 3
        px, py, pz = point_at(n, c, x, point)
        at, o = n[l + TABLE], n[l + PLACE] + 12
        vx, vy, vz, turning, total, slack, slides = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, False
        for _ in range(n[l + JOINTS]):
            rate = c[at + MULTIPLIER] * x[d + int(c[at + COLUMN])]
            ax, ay, az = x[o], x[o + 1], x[o + 2]
            if c[at + SLIDE] != 0.0:
                vx, vy, vz, slides = vx + rate * ax, vy + rate * ay, vz + rate * az, True
            else:
                dx, dy, dz = px - x[o + 3], py - x[o + 4], pz - x[o + 5]
                vx, vy, vz = (
                    vx + rate * (ay * dz - az * dy),
                    vy + rate * (az * dx - ax * dz),
                    vz + rate * (ax * dy - ay * dx),
                )
                turning += abs(rate)
            at += WIDTH
            o += 6
        for j in range(dof):
            total += abs(x[d + j]) * c[reach + j]
            slack += room[j] * c[reach + j]
        more = h * h * turning * total * (1.0 if slides else 0.5) + slack - allowance
        kept, possible = False, False
        for shape in range(n[t + FIRST_SHAPE], n[t + FIRST_SHAPE] + n[t + SHAPES]):
            if signed_distance(n, c, shape, SIZE, px, py, pz) <= allowance:
                possible = True
            a = signed_distance(n, c, shape, SIZE, px - h * vx, py - h * vy, pz - h * vz)
            b = signed_distance(n, c, shape, SIZE, px + h * vx, py + h * vy, pz + h * vz)
            if max(a, b) + more <= 0.0:
                kept = True
                break
        if not possible:
            return LEAVES
        if not kept:
            answer = UNKNOWN
    return answer


@njit(cache=True)
def edge_keeps_tolerances(n, c, x, p, a, b, room, allowance):
    """Return whether the straight joint motion from p[a:] to p[b:] is proven to stay within all constraint
    tolerances.

    Args:
        room: (dof,) deviation of each joint from the line. allowance: [rad and m] added to the tolerances.
    """
    dof = n[DOF]
    d = n[WORK] + 32 + MAX_ROWS * (dof + 2) + MAX_ROWS * MAX_ROWS + dof
    q, waiting, length = d + dof, d + 2 * dof, 0.0
    for j in range(dof):
        x[d + j] = p[b + j] - p[a + j]
        length = max(length, abs(x[d + j]))
    x[waiting], x[waiting + 1], count = 0.5, 0.5, 1
    while count > 0:
        count -= 1
        m, h = x[waiting + 2 * count], x[waiting + 2 * count + 1]
        for j in range(dof):
            x[q + j] = p[a + j] + m * x[d + j]
        place_links(n, c, x, x, q)
        first = _turns(n, c, x, d, h, room, allowance)
        if first == LEAVES:
            return False
        second = _points(n, c, x, d, h, room, allowance)
        if second == LEAVES:
            return False
        if first == KEEPS and second == KEEPS:
            continue
        h *= 0.5
        if h * length < FINEST or count + 2 > DEEPEST:
            return False
        x[waiting + 2 * count], x[waiting + 2 * count + 1] = m + h, h
        x[waiting + 2 * count + 2], x[waiting + 2 * count + 3] = m - h, h
        count += 2
    return True


@njit(cache=True, nogil=True)
def first_unproven_edge(handle, points, room, allowance):
    """Return the first edge of a motion (k, dof) that is not proven to stay within all constraint tolerances.

    Args:
        room: (dof,), allowance: see `edge_keeps_tolerances`.
    Returns:
        The number of the edge, -1 if all edges are proven.
    """
    n, c, x = manifold_pointers(handle)
    k, dof = points.shape
    p, r = pointer(points), pointer(room)
    for edge in range(k - 1):
        if not edge_keeps_tolerances(n, c, x, p, edge * dof, (edge + 1) * dof, r, allowance):
            return edge
    return -1
