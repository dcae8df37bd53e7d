"""Winding numbers, which decide whether points are inside or outside a mesh."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

FEW = 16  # points from which on the time to sort the triangles into columns is saved
SHORT = 256  # edges of a border that columns treat one by one; more edges cost more time than a tree
LEAF = 32  # triangles in a leaf of the tree; half or twice as many cost a tenth more time
TREE = 1_000_000  # solid angles (points x triangles) above which a tree saves more time than it costs


class _Tree(NamedTuple):
    """Tree of the triangles of a mesh, for winding numbers of many points.

    Node n is the box `low[n]` to `high[n]` of the triangles `first[n]` to `last[n] - 1`. `children[n]` (2,)
    are -1 at leaves. `edges[n]` (2,) is a range of rows of `border`, the edges at which the node's triangles
    end (function `_border`). The range is -1, -1 if the border has at least as many edges as the node has
    triangles.
    """

    triangles: NDArray[np.int64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    first: NDArray[np.int64]
    last: NDArray[np.int64]
    children: NDArray[np.int64]
    edges: NDArray[np.int64]
    border: NDArray[np.int64]


class _Columns(NamedTuple):
    """Triangles of a mesh, sorted into the columns of a regular x-y grid to compute winding numbers of
    points. The mesh must be closed or nearly closed.

    The coordinates are exchanged such that the mesh's shortest side is along z. Column c = i * shape[1] + j
    meets the triangles `inside[ends[c]:ends[c + 1]]`.
    """

    turn: int  # shift of the coordinates x, y and z
    vertices: NDArray[np.float64]  # (n, 3) [m]
    faces: NDArray[np.int64]
    low: NDArray[np.float64]  # (2,) lowest corner of the grid [m]
    size: NDArray[np.float64]  # (2,) of a column [m]
    shape: NDArray[np.int64]  # (2,)
    ends: NDArray[np.int64]
    inside: NDArray[np.int64]
    border: NDArray[np.int64]  # of the mesh, as in `_Tree`


class WindingNumbers:
    """Winding numbers of points with respect to one mesh.

    Args:
        vertices: (n, 3) [m].
        faces: (k, 3) vertex indices.
    """

    def __init__(self, vertices: ArrayLike, faces: ArrayLike):
        self._vertices = np.ascontiguousarray(vertices, float)
        self._faces = np.ascontiguousarray(faces, np.int64)
        self._points = 0  # points so far
        self._columns: _Columns | None = None
        self._tree: _Tree | None = None

    def __call__(self, points: ArrayLike) -> NDArray[np.float64]:
        """Return the generalized winding numbers (m,) of points (m, 3) [m]: 1 inside a closed mesh, 0
        outside.

        The number is robust to holes. It sums Van Oosterom and Strackee's solid angle (1983) over the
        triangles. For a group of triangles whose box does not contain the point, the sum only depends on the
        group's border (Jacobson et al. 2013). For the whole mesh, it is the number of triangles that a ray
        from the point crosses, counted by their direction, minus the solid angle of a surface that continues
        the border along the opposite direction to infinity.
        """
        points = np.ascontiguousarray(points, float)
        self._points += len(points)
        if self._points <= FEW or len(self._faces) == 0:
            return _sums(points, self._vertices, self._faces)
        if self._columns is None:
            self._columns = _columns(self._vertices, self._faces)
        if len(self._columns.border) <= SHORT:
            return _column_sums(np.roll(points, self._columns.turn, axis=1), self._columns)
        if self._points * len(self._faces) <= TREE:
            return _sums(points, self._vertices, self._faces)
        if self._tree is None:
            self._tree = _tree(self._vertices, self._faces)
        return _tree_sums(points, self._vertices, self._tree)


def _columns(vertices, faces) -> _Columns:
    """Sort the triangles of a mesh into the columns of a grid in x and y, to compute winding numbers."""
    turn = 2 - int(np.ptp(vertices[faces.ravel()], axis=0).argmin())
    vertices = np.roll(vertices, turn, axis=1)
    corners = vertices[faces][:, :, :2]
    least, most = corners.min(axis=1), corners.max(axis=1)
    low = least.min(axis=0)
    shape = np.full(2, int(np.clip(np.sqrt(len(faces)) / 2, 1, 256)))
    size = np.maximum(most.max(axis=0) - low, 1e-12) * (1 + 1e-9) / shape
    ends, inside = _triangles_by_column((least - low) // size, (most - low) // size, shape)
    return _Columns(turn, vertices, faces, low, size, shape, ends, inside, _border(faces, len(vertices)))


@njit(cache=True)
def _triangles_by_column(first, last, shape):
    """Sort triangles into the columns of a grid to compute winding numbers. Return the ranges `ends` and the
    list `inside` for `_Columns`.

    Args:
        first, last: (n, 2) indices of the columns at the corners of each triangle's box.
    """
    ends = np.zeros(shape[0] * shape[1] + 1, np.int64)
    inside = ends[:0]
    for fill in (False, True):
        for f in range(len(first)):
            for i in range(int(first[f, 0]), int(last[f, 0]) + 1):
                for j in range(int(first[f, 1]), int(last[f, 1]) + 1):
                    c = i * shape[1] + j
                    if fill:
                        ends[c] -= 1
                        inside[ends[c]] = f
                    else:
                        ends[c] += 1
        if not fill:
            ends = np.cumsum(ends)
            inside = np.empty(ends[-1], np.int64)
    return ends, inside


@njit(cache=True)
def _column_sums(points, columns):
    """Compute the winding numbers (m,) of points (m, 3) in a mesh whose triangles are sorted into columns.
    If the mesh was sorted with its axes permuted, the points need the same permutation.
    """
    v, out = columns.vertices, np.zeros(len(points))
    for p in range(len(points)):
        x, y, z = points[p]
        i = int(np.floor((x - columns.low[0]) / columns.size[0]))
        j = int(np.floor((y - columns.low[1]) / columns.size[1]))
        if 0 <= i < columns.shape[0] and 0 <= j < columns.shape[1]:
            c = i * columns.shape[1] + j
            for k in range(columns.ends[c], columns.ends[c + 1]):
                face = columns.faces[columns.inside[k]]
                turns = 0  # of the triangle's outline around the point, seen from above
                for e in range(3):
                    turns += _passes(x, y, v, face[e], face[(e + 1) % 3])
                if turns != 0 and _height(x, y, v[face[0]], v[face[1]], v[face[2]]) < z:
                    out[p] -= turns
        total = 0.0
        for e in range(len(columns.border)):
            a, b, uses = columns.border[e]
            total += uses * _half_angle_up(points[p], v[a], v[b])
        out[p] += total / (2.0 * np.pi)
    return out


@njit(cache=True)
def _passes(x, y, vertices, a, b):
    """Count an edge for a winding number: return 1 if it crosses the ray from the point (x, y) in +x
    direction toward larger y, -1 if it crosses the ray toward smaller y, and 0 otherwise.

    The rounding is the same for both directions of an edge, so neighboring triangles neither overlap nor
    leave a gap.
    """
    sign = 1
    if a > b:
        a, b, sign = b, a, -1
    ax, ay, bx, by = vertices[a, 0], vertices[a, 1], vertices[b, 0], vertices[b, 1]
    if (ay > y) == (by > y):
        return 0
    left = (x - ax) * (by - ay) < (y - ay) * (bx - ax)
    if by > ay:
        return sign if left else 0
    return 0 if left else -sign


@njit(cache=True)
def _height(x, y, a, b, c):
    """Return the z coordinate at which the vertical line through (x, y) meets a triangle. A winding number
    counts the triangles below a point.
    """
    area = (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1])
    low, high = min(a[2], b[2], c[2]), max(a[2], b[2], c[2])
    if area == 0.0:
        return low
    v = ((x - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (y - a[1])) / area
    w = ((b[0] - a[0]) * (y - a[1]) - (x - a[0]) * (b[1] - a[1])) / area
    return min(max(a[2] + v * (b[2] - a[2]) + w * (c[2] - a[2]), low), high)


def _tree(vertices, faces) -> _Tree:
    """Build a tree over the triangles of a mesh for winding numbers. Each node is split at the median along
    its longest axis until it has at most `LEAF` triangles.
    """
    corners = vertices[faces]
    centers, order = corners.mean(axis=1), np.arange(len(faces))
    ranges, children = [(0, len(faces))], []
    for first, last in ranges:  # grows meanwhile
        if last - first <= LEAF:
            children.append((-1, -1))
            continue
        part = order[first:last]
        axis = np.ptp(centers[part], axis=0).argmax()
        middle = (last - first) // 2
        order[first:last] = part[np.argpartition(centers[part, axis], middle)]
        children.append((len(ranges), len(ranges) + 1))
        ranges += [(first, first + middle), (first + middle, last)]
    none = np.empty((0, 3), np.int64)
    triangles, borders, short = faces[order], [none] * len(ranges), np.zeros(len(ranges), bool)
    for node in reversed(range(len(ranges))):  # children first
        a, b = children[node]
        if a < 0:
            borders[node] = _border(triangles[slice(*ranges[node])], len(vertices))
        else:
            borders[node] = _without_inner(np.concatenate([borders[a], borders[b]]), len(vertices))
            for child in (a, b):  # long borders of all levels fill the memory if triangles share no vertices
                borders[child] = borders[child] if short[child] else none
        short[node] = len(borders[node]) < ranges[node][1] - ranges[node][0]
    borders[0] = borders[0] if short[0] else none
    first, last = np.array(ranges).T
    size = np.cumsum([0, *(len(border) for border in borders)])
    boxes = corners[order]
    return _Tree(
        triangles=triangles,
        low=np.array([boxes[a:b].min(axis=(0, 1)) for a, b in ranges]),
        high=np.array([boxes[a:b].max(axis=(0, 1)) for a, b in ranges]),
        first=first,
        last=last,
        children=np.array(children),
        edges=np.where(short[:, None], np.stack([size[:-1], size[1:]], axis=1), -1),
        border=np.concatenate(borders),
    )


def _border(faces, count: int):
    """Return the border edges (e, 3) of a group of triangles (k, 3): start vertex, end vertex, and how many
    more triangles use this direction than the opposite one. A closed group has no border.

    Args:
        count: number of vertices of the mesh.
    """
    starts = faces.ravel()
    edges = np.stack([starts, np.roll(faces, -1, axis=1).ravel(), np.ones_like(starts)], axis=1)
    return _without_inner(edges, count)


def _without_inner(edges, count: int):
    """Remove the inner edges (n, 3) of a group of triangles: those used equally often in both directions. The
    border edges that remain suffice for the winding number.
    """
    forward = edges[:, 0] < edges[:, 1]
    key = np.where(forward, edges[:, 0] * count + edges[:, 1], edges[:, 1] * count + edges[:, 0])
    keys, index = np.unique(key, return_inverse=True)
    uses = np.bincount(index, np.where(forward, edges[:, 2], -edges[:, 2]), len(keys)).astype(np.int64)
    kept = uses != 0
    return np.stack([keys[kept] // count, keys[kept] % count, uses[kept]], axis=1)


@njit(cache=True, inline="always")
def _half_angle(point, a, b, c):
    """Return half the solid angle [sr] of a triangle as seen from a point. Winding numbers are sums of solid
    angles.
    """
    ax, ay, az = a[0] - point[0], a[1] - point[1], a[2] - point[2]
    bx, by, bz = b[0] - point[0], b[1] - point[1], b[2] - point[2]
    cx, cy, cz = c[0] - point[0], c[1] - point[1], c[2] - point[2]
    la = np.sqrt(ax * ax + ay * ay + az * az)
    lb = np.sqrt(bx * bx + by * by + bz * bz)
    lc = np.sqrt(cx * cx + cy * cy + cz * cz)
    det = ax * (by * cz - bz * cy) - ay * (bx * cz - bz * cx) + az * (bx * cy - by * cx)
    dot_ab = ax * bx + ay * by + az * bz
    dot_bc = bx * cx + by * cy + bz * cz
    dot_ca = cx * ax + cy * ay + cz * az
    return np.arctan2(det, la * lb * lc + dot_ab * lc + dot_bc * la + dot_ca * lb)


@njit(cache=True, inline="always")
def _half_angle_up(point, a, b):
    """Return half the solid angle [sr] of a triangle, seen from a point, to compute winding numbers. The
    triangle has the corners a and b, and its third corner is at infinity along z.
    """
    ax, ay, az = a[0] - point[0], a[1] - point[1], a[2] - point[2]
    bx, by, bz = b[0] - point[0], b[1] - point[1], b[2] - point[2]
    la = np.sqrt(ax * ax + ay * ay + az * az)
    lb = np.sqrt(bx * bx + by * by + bz * bz)
    return np.arctan2(ax * by - ay * bx, la * lb + ax * bx + ay * by + az * bz + bz * la + az * lb)


@njit(cache=True)
def _sums(points, vertices, faces):
    out = np.empty(len(points))
    for p in range(len(points)):
        total = 0.0
        for f in range(len(faces)):
            a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
            total += _half_angle(points[p], vertices[a], vertices[b], vertices[c])
        out[p] = total / (2.0 * np.pi)
    return out


@njit(cache=True)
def _tree_sums(points, vertices, tree):
    out = np.empty(len(points))
    stack = np.empty(128, np.int64)  # a tree halves the triangles, so it is at most 64 levels deep
    for p in range(len(points)):
        point, total = points[p], 0.0
        stack[0], depth = 0, 1
        while depth > 0:
            depth -= 1
            n = stack[depth]
            outside = False
            for i in range(3):
                outside |= point[i] < tree.low[n, i] or point[i] > tree.high[n, i]
            start, end = tree.edges[n]
            if outside and start >= 0:
                apex = vertices[tree.triangles[tree.first[n], 0]]
                for e in range(start, end):
                    a, b, uses = tree.border[e]
                    total += uses * _half_angle(point, apex, vertices[a], vertices[b])
            elif tree.children[n, 0] < 0:
                for f in range(tree.first[n], tree.last[n]):
                    a, b, c = tree.triangles[f]
                    total += _half_angle(point, vertices[a], vertices[b], vertices[c])
            else:
                stack[depth], stack[depth + 1] = tree.children[n, 0], tree.children[n, 1]
                depth += 2
        out[p] = total / (2.0 * np.pi)
    return out
