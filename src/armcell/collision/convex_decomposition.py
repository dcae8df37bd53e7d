"""Convex decomposition of meshes by axis-aligned cuts, for physics and collision checking.

The algorithm cuts a mesh repeatedly by the axis-aligned plane that reduces the total hull volume most, until
another cut would save little. It compares only hull volumes, so a mesh need not be watertight. The union of
the pieces contains the mesh: both sides of a cut include its outline, and therefore everything inside the
outline.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numba import njit
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
    """Return a convex decomposition of a mesh from the disk cache. If the cache has no entry for the key,
    compute the decomposition.
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
    cuts = [_best_cut(triangles, total, least)]
    while True:
        best = max(range(len(pieces)), key=lambda i: cuts[i].saving)
        cut = cuts[best]
        if cut.saving < least:
            break
        pieces[best : best + 1] = cut.halves
        if len(pieces) == MAX_PIECES:
            break
        parts = zip(cut.halves, cut.volumes, strict=True)
        cuts[best : best + 1] = [_best_cut(half, volume, least) for half, volume in parts]
    return tuple(convex_hull_mesh(piece) for piece in pieces)


class _CutMesh(NamedTuple):
    """Cut of a convex decomposition through a mesh: the saved volume [m^3], and the triangles and hull
    volumes [m^3] of both halves.
    """

    saving: float = 0.0
    halves: tuple[Array, ...] = ()
    volumes: tuple[float, ...] = ()


def _hull_volume(triangles: Array) -> float:
    return _hull(triangles.reshape(-1, 3))[0]


def _hull(points: Array) -> tuple[float, Array]:
    """Return the hull volume [m^3] of points (n, 3) and the corners of the hull, to rate a cut of a convex
    decomposition. Flat or empty sets have volume 0 and keep all their points.
    """
    from scipy.spatial import ConvexHull, QhullError

    try:
        hull = ConvexHull(points)
        return float(hull.volume), points[hull.vertices]
    except (QhullError, ValueError):
        return 0.0, points


def convex_hull_mesh(triangles: Array) -> Mesh:
    """Return the convex hull of points (..., 3) as a mesh with outward-facing faces, which is one piece of a
    convex decomposition.
    """
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


def _best_cut(triangles: Array, whole: float, least: float) -> _CutMesh:
    """Find the axis-aligned plane that best cuts a mesh in two for its convex decomposition. The mesh's hull
    has the volume `whole` [m^3].

    The saving is less than `least` [m^3] if no cut saves as much.
    """
    points = triangles.reshape(-1, 3)
    low, high = points.min(0), points.max(0)
    planes = low[:, None] + np.array(_FRACTIONS) * (high - low)[:, None]
    bounds = _largest_savings(triangles, planes, whole).ravel()
    rounding = 1e-9 * whole
    cuts: dict[int, _CutMesh] = {}
    for i in np.argsort(-bounds, kind="stable").tolist():
        if bounds[i] < max([least, *(cut.saving for cut in cuts.values())]) - rounding:
            break
        axis = i // len(_FRACTIONS)
        halves = tuple(_clip(triangles, axis, planes.flat[i], side) for side in (1.0, -1.0))
        volumes = tuple(_hull_volume(half) for half in halves)
        if min(volumes) > 0.0:
            cuts[i] = _CutMesh(whole - sum(volumes), halves, volumes)
    # The first of equal cuts, whatever the bounds.
    return max((cuts[i] for i in sorted(cuts)), key=lambda cut: cut.saving, default=_CutMesh())


def _largest_savings(triangles: Array, planes: Array, whole: float) -> Array:
    """Return upper bounds (3, k) [m^3] on the hull volume that each possible cut of a convex decomposition
    saves. Most bounds exceed the true values by a few percent of the whole hull.

    The hull of some points of a half is at most as large as the half's hull. The points are the extreme ones
    of each slab between two planes, and of each plane's section.

    Args:
        planes: (3, k) coordinates of the planes along each axis, ascending.
        whole: volume of the whole hull [m^3].
    """
    slabs, sections = _extreme_points(triangles, planes, _DIRECTIONS)
    savings = np.full(planes.shape, whole)
    count = planes.shape[1]
    for axis in range(3):
        for side in (1, -1):
            hull = np.empty((0, 3))
            for k in range(count)[::side]:
                new = np.concatenate([slabs[axis, k if side > 0 else k + 1], sections[axis, k]])
                volume, hull = _hull(np.concatenate([hull, new[~np.isnan(new[:, 0])]]))
                savings[axis, k] -= volume
    return savings


def evenly_spread(count: int) -> Array:
    """Return unit vectors (count, 3) that are evenly spread (Fibonacci sphere). Along these directions, the
    convex decomposition searches the extreme points of a mesh.
    """
    z = (2 * np.arange(count) + 1) / count - 1
    turn = np.pi * (3 - np.sqrt(5)) * np.arange(count)
    return np.stack([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z], axis=1)


_DIRECTIONS = evenly_spread(64)
"""Fewer directions leave more cuts to measure exactly; from 40 to 100, the CPU time differs by 5 %."""


@njit(cache=True)
def _extreme_points(triangles, planes, directions):
    """Return the extreme points along directions (d, 3) of a mesh to decompose, for each slab between its
    candidate cuts (3, k + 1, d, 3) and for its section with each cut (3, k, d, 3).

    The points are NaN where there are none.
    """
    k, d = planes.shape[1], len(directions)
    slabs, sections = np.full((3, k + 1, d, 3), np.nan), np.full((3, k, d, 3), np.nan)
    farthest_corner, farthest_cut = np.full((3, k + 1, d), -np.inf), np.full((3, k, d), -np.inf)
    slab, along, point = np.empty((3, 3), np.int64), np.empty(d), np.empty(3)
    for t in range(len(triangles)):
        for c in range(3):
            for i in range(d):
                along[i] = (
                    triangles[t, c, 0] * directions[i, 0]
                    + triangles[t, c, 1] * directions[i, 1]
                    + triangles[t, c, 2] * directions[i, 2]
                )
            for axis in range(3):
                s = 0
                while s < k and triangles[t, c, axis] > planes[axis, s]:
                    s += 1
                slab[axis, c] = s
                for i in range(d):
                    if along[i] > farthest_corner[axis, s, i]:
                        farthest_corner[axis, s, i] = along[i]
                        slabs[axis, s, i] = triangles[t, c]
        for axis in range(3):
            for c in range(3):
                a, b = c, (c + 1) % 3
                if slab[axis, a] > slab[axis, b]:
                    a, b = b, a
                for s in range(slab[axis, a], slab[axis, b]):
                    above = triangles[t, b, axis] - planes[axis, s]
                    share = above / (triangles[t, b, axis] - triangles[t, a, axis])
                    for j in range(3):
                        point[j] = triangles[t, b, j] + share * (triangles[t, a, j] - triangles[t, b, j])
                    for i in range(d):
                        value = (
                            point[0] * directions[i, 0]
                            + point[1] * directions[i, 1]
                            + point[2] * directions[i, 2]
                        )
                        if value > farthest_cut[axis, s, i]:
                            farthest_cut[axis, s, i] = value
                            sections[axis, s, i] = point
    return slabs, sections


def cut_corners(triangles: Array, height: Array, odd: NDArray[np.intp]) -> tuple[Array, ...]:
    """Cut triangles (n, 3, 3) of a mesh to decompose at a plane that separates one corner of each triangle
    from the other two.

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
