"""Winding numbers, which decide whether points are inside or outside a mesh."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

LEAF = 32  # triangles in a leaf of the tree; half or twice as many cost a tenth more time
TREE = 1_000_000  # solid angles (points x triangles) above which a tree saves more time than it costs


class _Tree(NamedTuple):
    """Tree of the triangles of a mesh, for winding numbers of many points.

    Node n is the box `low[n]` to `high[n]` of the triangles `first[n]` to `last[n] - 1`. `children[n]` (2,)
    are -1 at leaves. `edges[n]` (2,) is a range of rows of `border`, the edges at which the node's triangles
    end: start vertex, end vertex, and how often the triangles use this direction more than the other one. The
    range is -1, -1 if the border has at least as many edges as the node has triangles.
    """

    triangles: NDArray[np.int64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    first: NDArray[np.int64]
    last: NDArray[np.int64]
    children: NDArray[np.int64]
    edges: NDArray[np.int64]
    border: NDArray[np.int64]


class WindingNumbers:
    """Winding numbers of points with respect to one mesh.

    Args:
        vertices: (n, 3) [m].
        faces: (k, 3) vertex indices.
    """

    def __init__(self, vertices: ArrayLike, faces: ArrayLike):
        self._vertices = np.ascontiguousarray(vertices, float)
        self._faces = np.ascontiguousarray(faces, np.int64)
        self._without_tree = 0  # solid angles computed so far
        self._tree: _Tree | None = None

    def __call__(self, points: ArrayLike) -> NDArray[np.float64]:
        """Return the generalized winding numbers (m,) of points (m, 3) [m]: 1 inside a closed mesh, 0
        outside.

        The number is robust to holes. It sums Van Oosterom and Strackee's solid angle (1983) over the
        triangles. For a group of triangles whose box does not contain the point, the sum only depends on the
        group's border (Jacobson et al. 2013).
        """
        points = np.ascontiguousarray(points, float)
        self._without_tree += len(points) * len(self._faces)
        if self._without_tree <= TREE:
            return _sums(points, self._vertices, self._faces)
        if self._tree is None:
            self._tree = _tree(self._vertices, self._faces)
        return _tree_sums(points, self._vertices, self._tree)


def _tree(vertices, faces) -> _Tree:
    """Build a tree over the triangles of a mesh for winding numbers. The triangles are split at the median of
    their box's longest edge until each leaf has at most LEAF.
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
            ends = triangles[slice(*ranges[node])]
            starts = ends.ravel()
            edges = np.stack([starts, np.roll(ends, -1, axis=1).ravel(), np.ones_like(starts)], axis=1)
        else:
            edges = np.concatenate([borders[a], borders[b]])
            for child in (a, b):  # long borders of all levels fill the memory if triangles share no vertices
                borders[child] = borders[child] if short[child] else none
        borders[node] = _without_inner(edges, len(vertices))
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
