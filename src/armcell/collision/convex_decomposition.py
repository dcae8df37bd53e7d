"""Convex decomposition of meshes by axis-aligned cuts, for physics and collision checking.

The algorithm cuts a mesh repeatedly by the axis-aligned plane that reduces the total hull volume most, until
another cut would save little. It compares only hull volumes, so a mesh need not be watertight. The union of
the pieces contains the mesh: both sides of a cut include its outline, and therefore everything inside the
outline.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
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

    used = np.unique(mesh.faces)
    whole = MeshPart(mesh.vertices[used].astype(float), np.searchsorted(used, mesh.faces))
    total = whole.hull_volume
    if total == 0.0:
        raise InputError("mesh is flat: it has no volume", file=mesh.file)
    solid = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    volume = abs(signed_volume(mesh.vertices[mesh.faces]))
    if total - volume < MIN_SAVING * total and solid.is_watertight:
        return (convex_hull_mesh(whole.points),)  # no cut can save more than the hull's excess volume
    pieces, least = [whole], MIN_SAVING * total
    cuts = [_best_cut(whole, total, least)]
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
    return tuple(convex_hull_mesh(piece.points) for piece in pieces)


@dataclass(frozen=True, eq=False)
class MeshPart:
    """Part of a mesh: points (n, 3) [m], all of which are corners of the triangles (k, 3)."""

    points: Array
    triangles: NDArray[np.intp]

    @property
    def hull_volume(self) -> float:
        """Return the hull volume [m^3] of one part of a mesh during the mesh's convex decomposition."""
        return _hull(self.points)[0]

    def clipped(self, axis: int, at: float, side: float) -> MeshPart:
        """Cut a part of a mesh at a plane normal to an axis. Return the half with side * (x[axis] - at) <= 0,
        for the convex decomposition.
        """
        height = side * (self.points[:, axis] - at)
        above = (height > 0)[self.triangles]
        count = above.sum(1)
        points, triangles = [self.points], [self.triangles[count == 0]]
        for one_above in (True, False):  # triangles with one corner to cut off, or with one corner to keep
            rows = np.flatnonzero(count == (1 if one_above else 2))
            odd = np.argmax(above[rows] if one_above else ~above[rows], axis=1)
            corners = self.triangles[rows]
            p, q, r = np.take_along_axis(corners, (odd[:, None] + np.arange(3)) % 3, axis=1).T
            pq = sum(map(len, points)) + np.arange(len(rows))
            pr = pq + len(rows)
            points += cut_corners(self.points[corners], height[corners], odd)[3:]
            if one_above:
                triangles += [np.stack([pq, q, r], 1), np.stack([pq, r, pr], 1)]
            else:
                triangles.append(np.stack([p, pq, pr], 1))
        found, corners = np.concatenate(points), np.concatenate(triangles)
        used = np.zeros(len(found), bool)
        used[corners] = True
        return MeshPart(found[used], (np.cumsum(used) - 1)[corners])


class _CutMesh(NamedTuple):
    """Cut of a convex decomposition through a mesh: the saved volume [m^3], and both halves and their hull
    volumes [m^3].
    """

    saving: float = 0.0
    halves: tuple[MeshPart, ...] = ()
    volumes: tuple[float, ...] = ()


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


def signed_volume(triangles: Array) -> float:
    """Return the signed volume [m^3] between triangles (n, 3, 3) and the origin: the volume of a solid if the
    triangles are its surface.
    """
    return float(np.einsum("ni,ni->", triangles[:, 0], np.cross(triangles[:, 1], triangles[:, 2]))) / 6


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


def _best_cut(part: MeshPart, whole: float, least: float) -> _CutMesh:
    """Find the best axis-aligned cut through a mesh for its convex decomposition: the cut that saves the most
    hull volume. The hull of the whole mesh has the volume `whole` [m^3].

    The saving is less than `least` [m^3] if no cut saves as much.
    """
    if whole < least:
        return _CutMesh()
    low, high = part.points.min(0), part.points.max(0)
    planes = low[:, None] + np.array(_FRACTIONS) * (high - low)[:, None]
    bounds = _largest_savings(part, planes, whole).ravel()
    rounding = 1e-9 * whole
    cuts: dict[int, _CutMesh] = {}
    for i in np.argsort(-bounds, kind="stable").tolist():
        if bounds[i] < max([least, *(cut.saving for cut in cuts.values())]) - rounding:
            break
        axis = i // len(_FRACTIONS)
        halves = tuple(part.clipped(axis, planes.flat[i], side) for side in (1.0, -1.0))
        volumes = tuple(half.hull_volume for half in halves)
        if min(volumes) > 0.0:
            cuts[i] = _CutMesh(whole - sum(volumes), halves, volumes)
    # The first of equal cuts, whatever the bounds.
    return max((cuts[i] for i in sorted(cuts)), key=lambda cut: cut.saving, default=_CutMesh())


def _largest_savings(part: MeshPart, planes: Array, whole: float) -> Array:
    """Return upper bounds (3, k) [m^3] on the hull volume that each possible cut of a convex decomposition
    saves. Most bounds exceed the true values by a few percent of the whole hull.

    The hull of some points of a half is at most as large as the half's hull. The points are the extreme ones
    of each slab between two planes, and of each plane's section.

    Args:
        planes: (3, k) coordinates of the planes along each axis, ascending.
        whole: volume of the whole hull [m^3].
    """
    slabs, sections = _extreme_points(part.points, part.triangles, planes, _DIRECTIONS)
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
    """Return evenly spread unit vectors (count, 3) from a Fibonacci sphere. The convex decomposition searches
    for the extreme points of a mesh in these directions.
    """
    z = (2 * np.arange(count) + 1) / count - 1
    turn = np.pi * (3 - np.sqrt(5)) * np.arange(count)
    return np.stack([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z], axis=1)


_DIRECTIONS = evenly_spread(32)
"""Fewer directions leave more cuts to measure exactly; from 24 to 64, the CPU time differs by 10 %."""


@njit(cache=True)
def _extreme_points(points, triangles, planes, directions):
    """Find extreme points of a mesh in the directions (d, 3), for its convex decomposition: among the points
    (n, 3) in each slab between planes, and among the cuts of the triangles (m, 3) with each plane.

    Return arrays (3, k + 1, d, 3), by axis and slab, and (3, k, d, 3), by axis and plane.

    The points are NaN where there are none.
    """
    k, d = planes.shape[1], len(directions)
    slabs, sections = np.full((3, k + 1, d, 3), np.nan), np.full((3, k, d, 3), np.nan)
    farthest_point, farthest_cut = np.full((3, k + 1, d), -np.inf), np.full((3, k, d), -np.inf)
    slab, along, point = np.empty((len(points), 3), np.int64), np.empty(d), np.empty(3)
    for p in range(len(points)):
        for i in range(d):
            along[i] = (
                points[p, 0] * directions[i, 0]
                + points[p, 1] * directions[i, 1]
                + points[p, 2] * directions[i, 2]
            )
        for axis in range(3):
            s = 0
            while s < k and points[p, axis] > planes[axis, s]:
                s += 1
            slab[p, axis] = s
            for i in range(d):
                if along[i] > farthest_point[axis, s, i]:
                    farthest_point[axis, s, i] = along[i]
                    slabs[axis, s, i] = points[p]
    for t in range(len(triangles)):
        for c in range(3):
            a, b = triangles[t, c], triangles[t, (c + 1) % 3]
            for axis in range(3):
                first, last = a, b
                if slab[a, axis] > slab[b, axis]:
                    first, last = b, a
                for s in range(slab[first, axis], slab[last, axis]):
                    above = points[last, axis] - planes[axis, s]
                    share = above / (points[last, axis] - points[first, axis])
                    for j in range(3):
                        point[j] = points[last, j] + share * (points[first, j] - points[last, j])
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
    """Cut the triangles (n, 3, 3) of a mesh at a plane, as a step of its convex decomposition. The plane
    separates one corner of each triangle from the other two.

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
