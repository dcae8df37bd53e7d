"""Tree of boxes over triangles: distances between points and a surface, and the triangles inside a ball."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from armcell.collision.kernel.box_tree import z_order

F64 = NDArray[np.float64]

FLAT = 1e-14  # squared sine of the angle between two edges, below which a triangle has no area
LEAF = 8  # triangles of a leaf; half or twice as many cost a tenth more time


class TriangleTree(NamedTuple):
    """Complete binary tree of boxes over triangles. The children of node n are 2 n + 1 and 2 n + 2.

    `triangles` (m, 9) holds the corners [m] in the order of the leaves, `LEAF` triangles each, and `order`
    (m,) holds their index in the given array. `box` (k, 6) holds the lowest and the highest corner of each
    node [m]; nodes without triangles have the lowest corner inf. `leaves` is the number of the first leaf.
    """

    triangles: F64
    order: NDArray[np.int64]
    box: F64
    leaves: int

    @staticmethod
    def of(triangles: F64) -> TriangleTree:
        """Build the tree of triangles (m, 3, 3), m > 0, which are sorted along a Z-order curve."""
        low, high = triangles.min(axis=1), triangles.max(axis=1)
        order = z_order(low, high)
        leaves = 1 << max(-(-len(order) // LEAF) - 1, 0).bit_length()
        levels = [
            np.hstack([_by_leaf(low[order], np.inf, leaves).min(axis=1),
                       _by_leaf(high[order], -np.inf, leaves).max(axis=1)])
        ]  # fmt: skip
        while len(levels[-1]) > 1:
            a, b = levels[-1][::2], levels[-1][1::2]
            levels.append(np.hstack([np.minimum(a[:, :3], b[:, :3]), np.maximum(a[:, 3:], b[:, 3:])]))
        return TriangleTree(triangles.reshape(-1, 9)[order], order, np.concatenate(levels[::-1]), leaves - 1)


def _by_leaf(points: F64, missing: float, leaves: int) -> F64:
    padded = np.full((leaves * LEAF, 3), missing)
    padded[: len(points)] = points
    return padded.reshape(leaves, LEAF, 3)


@njit(cache=True)
def near_and_far(box, x, y, z):
    """Return the squared distances [m^2] from a point to the nearest and to the farthest point of a box (6,).

    The rounding is the same as for the distance to a point in the box, which is therefore in between.
    """
    near = far = 0.0
    for i, v in enumerate((x, y, z)):
        a, b = box[i] - v, box[i + 3] - v
        d = max(a, -b, 0.0)
        near += d * d
        d = max(-a, b)
        far += d * d
    return near, far


@njit(cache=True)
def distances(points, tree):
    """Return the distances (n,) [m] between points (n, 3) and the nearest triangle of a tree.

    Neighboring points in sequence are fastest: a point's nearest triangle bounds the next point's distance.
    """
    out, stack, nearest = np.empty(len(points)), np.empty(64, np.int64), 0
    for k in range(len(points)):
        x, y, z = points[k]
        best = _distance2(points[k], tree.triangles[nearest])
        stack[0], depth = 0, 1
        while depth > 0:
            depth -= 1
            n = stack[depth]
            if near_and_far(tree.box[n], x, y, z)[0] >= best:
                continue
            if n >= tree.leaves:
                first = (n - tree.leaves) * LEAF
                for t in range(first, min(first + LEAF, len(tree.triangles))):
                    distance2 = _distance2(points[k], tree.triangles[t])
                    if distance2 < best:
                        best, nearest = distance2, t
                continue
            a, b = 2 * n + 1, 2 * n + 2
            if near_and_far(tree.box[a], x, y, z)[0] < near_and_far(tree.box[b], x, y, z)[0]:
                a, b = b, a
            stack[depth], stack[depth + 1] = a, b  # the nearer child first
            depth += 2
        out[k] = np.sqrt(best)
    return out


@njit(cache=True, error_model="numpy")
def _distance2(p, t):
    """Return the squared distance [m^2] between a point (3,) and a triangle (9,).

    The algorithm finds the feature of the triangle that is nearest to the point: Ericson, Real-Time Collision
    Detection (2005), section 5.1.5. It divides by the area, so a triangle without area counts as its edges.
    """
    ab = (t[3] - t[0], t[4] - t[1], t[5] - t[2])
    ac = (t[6] - t[0], t[7] - t[1], t[8] - t[2])
    ab2, ac2, across = _dot(ab, ab), _dot(ac, ac), _dot(ab, ac)
    if ab2 * ac2 - across * across <= FLAT * ab2 * ac2:
        return min(
            _segment_distance2(p, t[0:3], t[3:6]),
            _segment_distance2(p, t[3:6], t[6:9]),
            _segment_distance2(p, t[0:3], t[6:9]),
        )
    ap = (p[0] - t[0], p[1] - t[1], p[2] - t[2])
    d1, d2 = _dot(ab, ap), _dot(ac, ap)
    v = w = 0.0  # the nearest point is a + v ab + w ac
    if d1 > 0.0 or d2 > 0.0:
        bp = (p[0] - t[3], p[1] - t[4], p[2] - t[5])
        cp = (p[0] - t[6], p[1] - t[7], p[2] - t[8])
        d3, d4, d5, d6 = _dot(ab, bp), _dot(ac, bp), _dot(ab, cp), _dot(ac, cp)
        va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
        if d3 >= 0.0 and d4 <= d3:
            v = 1.0
        elif vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
            v = d1 / (d1 - d3)
        elif d6 >= 0.0 and d5 <= d6:
            w = 1.0
        elif vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
            w = d2 / (d2 - d6)
        elif va <= 0.0 and d4 >= d3 and d5 >= d6:
            w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
            v = 1.0 - w
        else:
            v, w = vb / (va + vb + vc), vc / (va + vb + vc)
    total = 0.0
    for i in range(3):
        d = ap[i] - v * ab[i] - w * ac[i]
        total += d * d
    return total


@njit(cache=True)
def _segment_distance2(p, a, b):
    """Return the squared distance [m^2] between a point (3,) and a segment from a (3,) to b (3,), which may
    have the length 0.
    """
    length2 = along = total = 0.0
    for i in range(3):
        length2 += (b[i] - a[i]) ** 2
        along += (b[i] - a[i]) * (p[i] - a[i])
    share = min(max(along / length2, 0.0), 1.0) if length2 > 0.0 else 0.0
    for i in range(3):
        total += (p[i] - a[i] - share * (b[i] - a[i])) ** 2
    return total


@njit(cache=True)
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
