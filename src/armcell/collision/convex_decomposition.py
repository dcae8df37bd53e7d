"""Convex decomposition of meshes by axis-aligned cuts, for physics and collision checking.

The algorithm cuts a mesh repeatedly by the axis-aligned plane that reduces the total hull volume most, until
another cut would save little. It compares only hull volumes, so a mesh need not be watertight. The union of
the pieces contains the mesh: both sides of a cut include its outline, and therefore everything inside the
outline.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from armcell._array_store import key_of, recall_or_compute
from armcell.core import InputError, Mesh

Array = NDArray[np.float64]

MIN_SAVING = 0.02
"""Smallest saving of a cut, as a fraction of the whole hull's volume, that justifies another piece."""
MAX_PIECES = 12
VERSION = 1  # increase when `convex_pieces` returns different pieces, to invalidate the disk cache
_FRACTIONS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9)


@lru_cache(maxsize=256)
def convex_pieces(mesh: Mesh) -> tuple[Mesh, ...]:
    """Decompose a mesh by axis-aligned cuts into convex meshes. A nearly convex mesh yields a single piece.

    The result is deterministic and cached on disk.

    Raises:
        InputError: the mesh is flat.
    """
    key = key_of(str(VERSION), mesh.vertices.astype(float), mesh.faces.astype(np.int32))
    return stored_pieces(key, lambda: _cut(mesh))


def stored_pieces(key: str, make: Callable[[], tuple[Mesh, ...]]) -> tuple[Mesh, ...]:
    """Return the convex pieces of a mesh from the cache on disk.
    If the cache has no entry for the key, compute the pieces.
    """

    def computed() -> dict[str, NDArray]:
        pieces = make()
        counts = np.array([(len(p.vertices), len(p.faces)) for p in pieces])
        vertices, faces = np.vstack([p.vertices for p in pieces]), np.vstack([p.faces for p in pieces])
        return {"counts": counts, "vertices": vertices, "faces": faces}

    stored = recall_or_compute("pieces", key, computed)
    v, f = np.cumsum(stored["counts"], axis=0)[:-1].T
    parts = zip(np.split(stored["vertices"], v), np.split(stored["faces"], f), strict=True)
    return tuple(Mesh(vertices, faces.astype(np.int32)) for vertices, faces in parts)


def _cut(mesh: Mesh) -> tuple[Mesh, ...]:
    import trimesh  # slow to import, and not needed if the pieces are in the disk cache

    triangles = mesh.vertices[mesh.faces]
    total = _hull_volume(triangles)
    if total == 0.0:
        raise InputError("mesh is flat: it has no volume", file=mesh.file)
    solid = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    if solid.is_watertight and total - abs(solid.volume) < MIN_SAVING * total:
        return (convex_hull_mesh(triangles),)  # no cut can save more than the hull's excess volume
    pieces, least = [triangles], MIN_SAVING * total
    cuts = [_best_cut(triangles, least)]
    while len(pieces) < MAX_PIECES:
        best = max(range(len(pieces)), key=lambda i: cuts[i][0])
        saving, halves = cuts[best]
        if saving < least or halves is None:
            break
        pieces[best : best + 1] = halves
        cuts[best : best + 1] = [_best_cut(half, least) for half in halves]
    return tuple(convex_hull_mesh(piece) for piece in pieces)


def _hull_volume(triangles: Array) -> float:
    return _hull(triangles.reshape(-1, 3))[0]


def _hull(points: Array) -> tuple[float, Array]:
    """Return the volume [m^3] of the hull of points (n, 3), and its corners.
    Flat or empty sets have no volume, and all their points are returned.
    """
    from scipy.spatial import ConvexHull, QhullError

    try:
        hull = ConvexHull(points)
        return float(hull.volume), points[hull.vertices]
    except (QhullError, ValueError):
        return 0.0, points


def convex_hull_mesh(triangles: Array) -> Mesh:
    """Return a convex piece: the convex hull of points (..., 3), as a mesh with outward-facing faces."""
    from scipy.spatial import ConvexHull

    points = np.unique(triangles.reshape(-1, 3), axis=0)
    hull = ConvexHull(points)
    index = np.full(len(points), -1)
    index[hull.vertices] = np.arange(len(hull.vertices))
    faces = index[hull.simplices]
    vertices = points[hull.vertices]
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), hull.equations[:, :3]) < 0
    faces[inward] = faces[inward][:, ::-1]
    return Mesh(vertices, faces.astype(np.int32))


def _best_cut(triangles: Array, least: float) -> tuple[float, list[Array] | None]:
    """Find the axis-aligned plane that best cuts a mesh into two convex pieces.
    Return the volume saved [m^3] and both halves.

    The halves are None if no cut saves the volume `least` [m^3].
    """
    points = triangles.reshape(-1, 3)
    low, high = points.min(0), points.max(0)
    whole = _hull_volume(triangles)
    estimates = whole - _hull_volumes_of_cuts(triangles, low, high).ravel()
    rounding = 1e-9 * whole
    cuts: dict[int, tuple[float, list[Array]]] = {}
    for i in np.argsort(-estimates, kind="stable").tolist():
        if estimates[i] < max([least, *(saving for saving, _ in cuts.values())]) - rounding:
            break
        axis, step = divmod(i, len(_FRACTIONS))
        at = low[axis] + _FRACTIONS[step] * (high[axis] - low[axis])
        halves = [_clip(triangles, axis, at, side) for side in (1.0, -1.0)]
        volumes = [_hull_volume(half) for half in halves]
        if min(volumes) > 0.0:
            cuts[i] = whole - sum(volumes), halves
    best: tuple[float, list[Array] | None] = (0.0, None)
    for i in sorted(cuts):  # the first of equal cuts, whatever the rounding of the estimates
        if cuts[i][0] > best[0]:
            best = cuts[i]
    return best


def _hull_volumes_of_cuts(triangles: Array, low: Array, high: Array) -> Array:
    """Return the total volume (3, k) [m^3] of both hulls after each cut of a mesh, up to rounding.

    The hull of all points below a plane is the hull of the points since the last plane and of the last hull's
    corners. Therefore each point enters a hull about twice per axis, instead of once per cut.
    """
    points, index = np.unique(triangles.reshape(-1, 3), axis=0, return_inverse=True)
    corners = index.reshape(-1, 3)
    ends = np.sort(np.concatenate([corners[:, [k, (k + 1) % 3]] for k in range(3)]), axis=1)
    a, b = np.divmod(np.unique(ends[:, 0] * len(points) + ends[:, 1]), len(points))
    volumes = np.zeros((3, len(_FRACTIONS)))
    for axis in range(3):
        x = points[:, axis]
        planes = low[axis] + np.array(_FRACTIONS) * (high[axis] - low[axis])
        for side in (1.0, -1.0):
            hull, last = np.empty((0, 3)), -np.inf
            for k in range(len(planes))[:: int(side)]:
                height = side * (x - planes[k])
                crossing = (height[a] > 0) != (height[b] > 0)
                p, q = a[crossing], b[crossing]
                share = height[p] / (height[p] - height[q])
                cut = points[p] + share[:, None] * (points[q] - points[p])
                new = points[(height <= 0) & (side * x > last)]
                volume, hull = _hull(np.concatenate([hull, new, cut]))
                volumes[axis, k] += volume
                last = side * planes[k]
    return volumes


def cut_corners(triangles: Array, height: Array, odd: NDArray[np.intp]) -> tuple[Array, ...]:
    """Cut triangles (n, 3, 3) at a plane that separates one corner of each from the other two.

    Args:
        height: signed distances (n, 3) of the corners from the plane.
        odd: index (n,) of the separated corner.
    Returns:
        The separated corner, the other two in the triangle's direction, and the points where the plane
        cuts the edges from the separated corner to them, each (n, 3).
    """
    order = (odd[:, None] + np.arange(3)) % 3
    tri = np.take_along_axis(triangles, order[:, :, None], axis=1)
    h = np.take_along_axis(height, order, axis=1)
    p, q, r = tri[:, 0], tri[:, 1], tri[:, 2]
    pq = p + (h[:, 0] / (h[:, 0] - h[:, 1]))[:, None] * (q - p)
    pr = p + (h[:, 0] / (h[:, 0] - h[:, 2]))[:, None] * (r - p)
    return p, q, r, pq, pr


def _clip(triangles: Array, axis: int, at: float, side: float) -> Array:
    """Clip triangles (n, 3, 3) at an axis-aligned plane and return those on one side (k, 3, 3),
    to decompose a mesh into convex pieces.

    The part has side * (x[axis] - at) <= 0.
    """
    height = side * (triangles[:, :, axis] - at)  # (n, 3)
    above = height > 0
    count = above.sum(1)
    parts = [triangles[count == 0]]
    for one_above in (True, False):  # triangles with one corner to cut off, or with one corner to keep
        rows = np.flatnonzero(count == (1 if one_above else 2))
        if len(rows) == 0:
            continue
        odd = np.argmax(above[rows] if one_above else ~above[rows], axis=1)
        p, q, r, pq, pr = cut_corners(triangles[rows], height[rows], odd)
        if one_above:
            parts += [np.stack([pq, q, r], 1), np.stack([pq, r, pr], 1)]
        else:
            parts.append(np.stack([p, pq, pr], 1))
    return np.concatenate(parts)
