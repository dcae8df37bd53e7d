"""Exact distance of convex solids by the GJK algorithm, the second tier of the kernel.

The computation is scalar and in float64. A solid has a kind and numbers. Kinds: 0 points (convex hull of
vertices), 1 sphere, 2 box, 3 capsule, 4 cylinder, 5 cone, 6 half space. The parts of clouds have their
numbers in the scratch memory: 7 ball, 8 cell (cube), 9 triangle. The algorithm is that of Gilbert, Johnson
and Keerthi with Ericson's closest points of simplices ("Real-Time Collision Detection", 5.1 and 9.5); the
tests compare it with coal.
"""

# pyright: reportCallIssue=false
# Numba calls intrinsics without their typing context, and splices tuples into compiled calls.
from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from armcell._inner_njit import inner_njit
from armcell.collision.kernel.simd import (
    L,
    fma,
    hmax,
    load,
    mask_lt,
    pick,
    select_lt,
    splat,
    trailing_zeros,
    vmax,
)

POINTS, SPHERE, BOX, CAPSULE, CYLINDER, CONE, HALFSPACE, BALL, CELL, TRIANGLE = range(10)
MAX_ITERATIONS = 64
SCRATCH = 69  # float64 numbers that `distance` needs
NORMAL = 54
PART = 58  # of a cloud: radius, half the edge, or three corners
CLOSE = 68  # [m] distance that counts as touching; 0 except while clearance is measured
TOLERANCE = 1e-6  # [m] tolerance of the distance, plus this share of `enough`:
SHARE = 0.05
TOUCHING = 2e-6
"""[m] Solids closer than this touch: frames and points are float32, and coal calls 1 um a contact as well."""


class ConvexSolid(NamedTuple):
    """Convex solid for GJK: its kind, and the indices of its dimensions and points in the arrays D and F that
    the collision kernels share.

    Attributes:
        kind: POINTS to TRIANGLE.
        size: index in D of the solid's three numbers [m].
        points, points32: indices in D and in F of the points [m], which only the kind POINTS has.
        count: number of points.
    """

    kind: Any
    size: Any
    points: Any
    points32: Any
    count: Any


@inner_njit
def _farthest(F, first, count, dx, dy, dz):
    """Return the index of the convex hull's vertex that is farthest along a direction.
    GJK uses it as support point.

    The points are in F, in blocks of L points (x, y, z).
    """
    x, y, z = splat(np.float32(dx)), splat(np.float32(dy)), splat(np.float32(dz))
    best, where = splat(np.float32(-1e30)), splat(np.float32(0.0))
    for block in range((count + L - 1) // L):
        at = first + 3 * L * block
        d = fma(load(F, at), x, fma(load(F, at + L), y, load(F, at + 2 * L) * z))
        where = select_lt(best, d, splat(np.float32(block)), where)
        best = vmax(best, d)
    top = hmax(best)
    lane = trailing_zeros(mask_lt(splat(top - abs(top) * np.float32(1e-6) - np.float32(1e-30)), best))
    return int(pick(where, lane)) * L + lane


@inner_njit
def _part_support(kind, dx, dy, dz, s, out):
    """Compute the support point of a sphere, cube or triangle along a direction, for GJK.

    The numbers of the part are at s[PART:].
    """
    a = s[PART]
    if kind == BALL:
        n = a / (np.sqrt(dx * dx + dy * dy + dz * dz) + 1e-300)
        s[out], s[out + 1], s[out + 2] = n * dx, n * dy, n * dz
    elif kind == CELL:
        s[out] = a if dx >= 0 else -a
        s[out + 1] = a if dy >= 0 else -a
        s[out + 2] = a if dz >= 0 else -a
    else:
        best, most = PART, -1e300
        for k in range(PART, PART + 9, 3):
            along = s[k] * dx + s[k + 1] * dy + s[k + 2] * dz
            if along > most:
                best, most = k, along
        s[out], s[out + 1], s[out + 2] = s[best], s[best + 1], s[best + 2]


@inner_njit
def support(F, D, solid, dx, dy, dz, s, out):
    """Compute the support point of a convex solid along (dx, dy, dz) in the solid's own frame, for GJK.

    The result is written to s[out : out + 3].
    """
    kind, size = solid.kind, solid.size
    if kind >= BALL:
        _part_support(kind, dx, dy, dz, s, out)
        return
    a, b = D[size], D[size + 1]
    if kind == POINTS:
        best = solid.points + 3 * _farthest(F, solid.points32, solid.count, dx, dy, dz)
        s[out], s[out + 1], s[out + 2] = D[best], D[best + 1], D[best + 2]
    elif kind == BOX:
        c = D[size + 2]
        s[out] = a if dx >= 0 else -a
        s[out + 1] = b if dy >= 0 else -b
        s[out + 2] = c if dz >= 0 else -c
    elif kind in (SPHERE, CAPSULE):
        n = a / (np.sqrt(dx * dx + dy * dy + dz * dz) + 1e-300)
        s[out], s[out + 1], s[out + 2] = n * dx, n * dy, n * dz
        if kind == CAPSULE:
            s[out + 2] += b if dz >= 0 else -b
    else:
        n = np.sqrt(dx * dx + dy * dy)
        if kind == CONE and n * a < 2 * b * dz:  # the apex beats the base's rim
            s[out], s[out + 1], s[out + 2] = 0.0, 0.0, b
            return
        s[out], s[out + 1] = (a * dx / n, a * dy / n) if n > 1e-12 else (a, 0.0)
        s[out + 2] = b if kind == CYLINDER and dz >= 0 else -b


@inner_njit
def _minkowski(F, D, T, a, b, dx, dy, dz, s, at):
    """Compute the support point of the Minkowski difference a - b along d, in b's frame, for GJK.

    The result is written to s[at:]. s[T : T + 12] is the transform from a's frame to b's.
    """
    ax = s[T] * dx + s[T + 4] * dy + s[T + 8] * dz
    ay = s[T + 1] * dx + s[T + 5] * dy + s[T + 9] * dz
    az = s[T + 2] * dx + s[T + 6] * dy + s[T + 10] * dz
    support(F, D, a, ax, ay, az, s, np.int64(48))
    x, y, z = s[48], s[49], s[50]
    support(F, D, b, -dx, -dy, -dz, s, np.int64(51))
    s[at] = s[T] * x + s[T + 1] * y + s[T + 2] * z + s[T + 3] - s[51]
    s[at + 1] = s[T + 4] * x + s[T + 5] * y + s[T + 6] * z + s[T + 7] - s[52]
    s[at + 2] = s[T + 8] * x + s[T + 9] * y + s[T + 10] * z + s[T + 11] - s[53]


@inner_njit
def _copy(s, src, dst):
    s[dst], s[dst + 1], s[dst + 2] = s[src], s[src + 1], s[src + 2]


@inner_njit
def _segment(s, v):
    """Compute the point of a line segment that is nearest to the origin, and reduce GJK's simplex.

    The segment is s[0:3], s[3:6]; the point is written to s[v:]. The reduced simplex replaces the segment.

    Returns:
        The number of points in the reduced simplex, 1 or 2.
    """
    bx, by, bz = s[3] - s[0], s[4] - s[1], s[5] - s[2]
    t = -(s[0] * bx + s[1] * by + s[2] * bz)
    n = bx * bx + by * by + bz * bz
    if t <= 0.0 or n <= 0.0:
        s[v], s[v + 1], s[v + 2] = s[0], s[1], s[2]
        return 1
    if t >= n:
        _copy(s, 3, 0)
        s[v], s[v + 1], s[v + 2] = s[0], s[1], s[2]
        return 1
    t /= n
    s[v], s[v + 1], s[v + 2] = s[0] + t * bx, s[1] + t * by, s[2] + t * bz
    return 2


@inner_njit
def _triangle(s, o, v):
    """Compute the point of a triangle that is nearest to the origin, and reduce GJK's simplex.

    The triangle starts at s[o]; otherwise the function is like `_segment`.
    """
    ax, ay, az = s[o], s[o + 1], s[o + 2]
    bx, by, bz = s[o + 3], s[o + 4], s[o + 5]
    cx, cy, cz = s[o + 6], s[o + 7], s[o + 8]
    abx, aby, abz = bx - ax, by - ay, bz - az
    acx, acy, acz = cx - ax, cy - ay, cz - az
    d1 = -(abx * ax + aby * ay + abz * az)
    d2 = -(acx * ax + acy * ay + acz * az)
    if d1 <= 0 and d2 <= 0:
        s[v], s[v + 1], s[v + 2] = ax, ay, az
        return 1
    d3 = -(abx * bx + aby * by + abz * bz)
    d4 = -(acx * bx + acy * by + acz * bz)
    if d3 >= 0 and d4 <= d3:
        _copy(s, o + 3, o)
        s[v], s[v + 1], s[v + 2] = bx, by, bz
        return 1
    vc = d1 * d4 - d3 * d2
    if vc <= 0 and d1 >= 0 and d3 <= 0:
        t = d1 / (d1 - d3) if d1 - d3 > 0 else 0.0
        s[v], s[v + 1], s[v + 2] = ax + t * abx, ay + t * aby, az + t * abz
        return 2
    d5 = -(abx * cx + aby * cy + abz * cz)
    d6 = -(acx * cx + acy * cy + acz * cz)
    if d6 >= 0 and d5 <= d6:
        _copy(s, o + 6, o)
        s[v], s[v + 1], s[v + 2] = cx, cy, cz
        return 1
    vb = d5 * d2 - d1 * d6
    if vb <= 0 and d2 >= 0 and d6 <= 0:
        t = d2 / (d2 - d6) if d2 - d6 > 0 else 0.0
        s[v], s[v + 1], s[v + 2] = ax + t * acx, ay + t * acy, az + t * acz
        _copy(s, o + 6, o + 3)
        return 2
    va = d3 * d6 - d5 * d4
    if va <= 0 and d4 - d3 >= 0 and d5 - d6 >= 0:
        w = (d4 - d3) + (d5 - d6)
        t = (d4 - d3) / w if w > 0 else 0.0
        s[v], s[v + 1], s[v + 2] = bx + t * (cx - bx), by + t * (cy - by), bz + t * (cz - bz)
        _copy(s, o + 3, o)
        _copy(s, o + 6, o + 3)
        return 2
    w = va + vb + vc
    if w <= 0.0:  # a flat triangle: use its longest side
        s[v], s[v + 1], s[v + 2] = ax, ay, az
        return 1
    p, q = vb / w, vc / w
    s[v], s[v + 1], s[v + 2] = ax + abx * p + acx * q, ay + aby * p + acy * q, az + abz * p + acz * q
    return 3


@inner_njit
def _outside(s, i, j, k, o):
    """Return whether the origin is outside the face (i, j, k) of GJK's tetrahedron.

    The origin is outside if the plane of the face separates the origin from the fourth vertex o. The result
    is also True for a flat tetrahedron.
    """
    abx, aby, abz = s[j] - s[i], s[j + 1] - s[i + 1], s[j + 2] - s[i + 2]
    acx, acy, acz = s[k] - s[i], s[k + 1] - s[i + 1], s[k + 2] - s[i + 2]
    nx, ny, nz = aby * acz - abz * acy, abz * acx - abx * acz, abx * acy - aby * acx
    here = -(s[i] * nx + s[i + 1] * ny + s[i + 2] * nz)
    there = (s[o] - s[i]) * nx + (s[o + 1] - s[i + 1]) * ny + (s[o + 2] - s[i + 2]) * nz
    scale = 1e-13 * (abs(nx) + abs(ny) + abs(nz))
    if abs(there) <= scale:
        return True  # flat: use the face
    return here * there < 0.0


@inner_njit
def _tetrahedron(s, v):
    """Compute the point of a tetrahedron that is nearest to the origin, and reduce GJK's simplex.

    The tetrahedron is s[0:12]; the point is written to s[v:], like in `_segment`.

    Returns:
        The number of points in the reduced simplex. If the origin is inside the tetrahedron, the function
        returns 4 and writes no point.
    """
    best, size = 1e300, 4
    for face in range(4):
        if face == 0:
            i, j, k, o = 0, 3, 6, 9
        elif face == 1:
            i, j, k, o = 0, 6, 9, 3
        elif face == 2:
            i, j, k, o = 0, 9, 3, 6
        else:
            i, j, k, o = 3, 9, 6, 0
        if not _outside(s, i, j, k, o):
            continue
        for m in range(3):
            s[12 + m], s[15 + m], s[18 + m] = s[i + m], s[j + m], s[k + m]
        n = _triangle(s, np.int64(12), np.int64(45))
        d = s[45] * s[45] + s[46] * s[46] + s[47] * s[47]
        if d < best:
            best, size = d, n
            s[v], s[v + 1], s[v + 2] = s[45], s[46], s[47]
            for m in range(9):
                s[21 + m] = s[12 + m]
    if size < 4:
        for m in range(9):
            s[m] = s[21 + m]
    return size


@inner_njit
def distance(F, D, T, a, b, enough, warm, s):
    """Return the distance [m] of two solids a and b (`ConvexSolid`) by GJK, or 0 if they touch.

    The result is never above the true distance.

    Args:
        F, D: numbers and points of the solids.
        T: index in `s` of the 12 numbers (3x4 rows) of the transform from a's frame to b's.
        enough: a lower bound above this value (and `TOUCHING`) ends the search early and is returned.
        warm: start with the normal in s[NORMAL:].
        s: scratch memory; the first `SCRATCH` numbers are overwritten. s[NORMAL : NORMAL + 3] receives the
            unit vector in b's frame along which the returned distance separates a from b.
    """
    v = 30
    if warm:
        _copy(s, NORMAL, v)
    else:
        s[v], s[v + 1], s[v + 2] = s[T + 3], s[T + 7], s[T + 11]
    if s[v] * s[v] + s[v + 1] * s[v + 1] + s[v + 2] * s[v + 2] < 1e-20:
        s[v] = 1.0
    n, bound, tolerance = 0, 0.0, TOLERANCE + SHARE * enough
    enough = max(enough, TOUCHING)
    for _ in range(MAX_ITERATIONS):
        length2 = s[v] * s[v] + s[v + 1] * s[v + 1] + s[v + 2] * s[v + 2]
        if n > 0 and length2 < 1e-18:
            return 0.0
        _minkowski(F, D, T, a, b, -s[v], -s[v + 1], -s[v + 2], s, 36)
        dot = s[v] * s[36] + s[v + 1] * s[37] + s[v + 2] * s[38]
        length = np.sqrt(length2)
        if dot > bound * length:
            bound = dot / length
            s[NORMAL], s[NORMAL + 1], s[NORMAL + 2] = s[v] / length, s[v + 1] / length, s[v + 2] / length
            if bound > enough:
                return bound
        # A rough bound may prove a separation, but never a contact.
        if n > 0 and length - bound <= (tolerance if bound > max(TOUCHING, s[CLOSE]) else TOLERANCE):
            return bound if bound > TOUCHING else 0.0
        for k in range(0, 3 * n, 3):  # a point that the simplex already contains: no progress is possible
            if (s[k] - s[36]) ** 2 + (s[k + 1] - s[37]) ** 2 + (s[k + 2] - s[38]) ** 2 < 1e-22:
                return bound if bound > TOUCHING else 0.0
        _copy(s, 36, 3 * n)
        n += 1
        if n == 1:
            s[v], s[v + 1], s[v + 2] = s[0], s[1], s[2]
        elif n == 2:
            n = _segment(s, v)
        elif n == 3:
            n = _triangle(s, np.int64(0), np.int64(v))
        else:
            n = _tetrahedron(s, v)
            if n == 4:  # around the origin; a separation that is already proven is the better witness
                return bound if bound > TOUCHING else 0.0
        now = s[v] * s[v] + s[v + 1] * s[v + 1] + s[v + 2] * s[v + 2]
        if now > length2 * (1 - 1e-14) and n > 1 and bound > 0:
            break
    return bound if bound > TOUCHING else 0.0
