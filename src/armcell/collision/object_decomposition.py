"""Convex decomposition of objects along reflex edges, for physics; keeps cavities and openings.

The algorithm cuts the piece whose convex hull exceeds its solid most, until the total excess is below
`EXCESS` of the mesh's volume. Then it cuts the piece whose hull covers a point of the surface deepest,
until no point is deeper than `DEPTH`. A candidate plane contains a reflex edge and halves its dihedral
angle, or contains the face beside it (the floor of a bin, the inner side of a wall), or divides the
piece's extent along an axis in halves or thirds. The union of the pieces contains the mesh, and pieces do
not overlap.

The budget counts work, not seconds, so a busy machine gives the same pieces. Robot links always use
`convex_pieces`, which divides a link into at most 12 pieces.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from armcell._array_store import key_of
from armcell.collision.convex_decomposition import (
    convex_hull_mesh,
    convex_pieces,
    cut_corners,
    signed_volume,
    stored_pieces,
)
from armcell.collision.winding import WindingNumbers
from armcell.core import Mesh, is_closed

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.float64]

EXCESS = 0.08
"""Excess of the pieces' total volume over the mesh's volume, as a fraction, at which the cuts end."""
DEPTH = 0.002
"""Largest depth [m] of a point of the mesh's surface below the surface of its piece's convex hull."""
MAX_PIECES = 1024  # per solid
EDGES = 0.05  # weight of resolved reflex edges in the choice of a cut; a cut that removes the excess has 1
WORK = 9_000_000
"""Budget of a decomposition: each step counts as the microseconds that it took when we measured it."""
_PLANES = 3  # candidate planes through reflex edges, per piece
_FRACTIONS = (1 / 3, 1 / 2, 2 / 3)  # of the extent along each axis: the other candidate planes
_MANY = 2000  # triangles of a piece that is cut only in the middle, because each candidate takes long
_ON_PLANE = 1e-8  # [m]
_INWARD = 1e-6  # [m]
_FLAT = np.deg2rad(1.0)  # a smaller reflex angle counts as flat
log = logging.getLogger(__name__)
CONVEX = 0.998  # a mesh that fills more than this fraction of its hull's volume counts as convex
SMALLEST = 1e-11  # [m^3] smaller pieces are left out; MuJoCo rejects meshes without volume
VERSION = 4  # increase when the same mesh yields different pieces, to invalidate the disk cache


@dataclass(frozen=True, eq=False)
class _Reflex:
    """Reflex edges of a concave object, along which it can be cut: end points (e, 2, 3), three candidate
    planes per edge (e, 3, 4), and weights (e,). A weight is the edge length times the reflex angle.

    A plane is a normal and an offset.
    """

    ends: Array
    planes: Array
    weights: Array

    def shares(self, plane: Array) -> tuple[float, float]:
        """Return the shares of the weights of a concave object's reflex edges below and above a cutting
        plane. Edges in the plane are resolved: they count on neither side.
        """
        height = self.ends @ plane[:3] + plane[3]  # (e, 2)
        low, high = height.min(1), height.max(1)
        level = high - low < 1e-12
        above = np.where(level, high > 0, high.clip(0.0) - low.clip(0.0)) / np.where(level, 1.0, high - low)
        weights = self.weights / self.weights.sum()
        return (
            float(weights @ np.where(low < -1e-7, 1 - above, 0.0)),
            float(weights @ np.where(high > 1e-7, above, 0.0)),
        )

    def below(self, plane: Array) -> _Reflex:
        """Clip the reflex edges of a concave object to the side of a cutting plane where n · x + d < 0, and
        return the clipped edges.
        """
        height = self.ends @ plane[:3] + plane[3]  # (e, 2)
        rows = height.min(1) < -1e-7
        ends, height = self.ends[rows], height[rows]
        share = np.clip(
            height[:, 0] / np.where(height[:, 0] == height[:, 1], 1.0, height[:, 0] - height[:, 1]), 0, 1
        )
        cut = ends[:, 0] + share[:, None] * (ends[:, 1] - ends[:, 0])
        first, second = height[:, 0] > 0, height[:, 1] > 0
        weights = self.weights[rows] * np.where(first, 1 - share, np.where(second, share, 1.0))
        ends = np.stack(
            [np.where(first[:, None], cut, ends[:, 0]), np.where(second[:, None], cut, ends[:, 1])], 1
        )
        return _Reflex(ends, self.planes[rows], weights)


@dataclass(eq=False)
class _Piece:
    """Part of a concave object inside one convex cell of space. The decomposition of the object cuts space
    into these cells along reflex edges.

    `caps` closes the surface for volumes only: its triangles may reach beyond the solid, where they cancel.
    """

    triangles: Array  # (n, 3, 3)
    caps: Array  # (k, 3, 3)
    edges: _Reflex
    cell: Array  # (c, 4) planes of the cell, n x + d <= 0 inside
    corners: Array  # (m, 3) corners of the cell inside the solid: there, no triangle has a corner
    hull: float  # [m^3]
    depth: float = np.inf  # [m] of the deepest point of the surface below the hull, once measured

    def __post_init__(self) -> None:
        corners = self.triangles.reshape(-1, 3)
        order = np.lexsort(corners.T)  # several times faster than np.unique of rows
        ordered = corners[order]
        first = np.ones(len(order), bool)
        first[1:] = (ordered[1:] != ordered[:-1]).any(1)
        index = np.empty(len(order), np.int64)
        index[order] = np.cumsum(first) - 1
        self.vertices, self.index = ordered[first], index.reshape(-1, 3)

    @property
    def points(self) -> Array:
        return np.vstack([self.vertices, self.corners])

    @property
    def excess(self) -> float:
        """Return the volume [m^3] by which the convex hull of a piece exceeds the concave solid."""
        return self.hull - signed_volume(self.triangles) - signed_volume(self.caps)

    def points_beside(self, plane: Array) -> tuple[Array, Array]:
        """Return the points of the surface (n, 3) and (m, 3) below and above a cutting plane, with the points
        where the plane cuts edges of the concave piece.
        """
        height = self.vertices @ plane[:3] + plane[3]
        height[np.abs(height) < _ON_PLANE] = 0.0
        sides = []
        for sign in (1, -1):
            beside = np.zeros(len(height), bool)
            beside[self.index[(sign * height < 0)[self.index].any(1)]] = True
            sides.append(self.vertices[beside & (sign * height <= 0)])
        ends = np.concatenate([self.index[:, [k, (k + 1) % 3]] for k in range(3)])
        ends = ends[height[ends[:, 0]] * height[ends[:, 1]] < 0]
        h, (a, b) = height[ends], self.vertices[ends].transpose(1, 0, 2)
        cuts = a + (h[:, 0] / (h[:, 0] - h[:, 1]))[:, None] * (b - a)
        return np.vstack([sides[0], cuts]), np.vstack([sides[1], cuts])


class _Work:
    """Working state while a concave object is decomposed: the object's mesh and the remaining budget of
    work.
    """

    def __init__(self, budget: int, vertices: Array, faces: NDArray[np.int32]):
        self.left, self._face_count, self._winding = budget, len(faces), WindingNumbers(vertices, faces)

    def inside(self, points: Array) -> NDArray[np.bool_]:
        """Return a mask of the points (n, 3) that are inside the concave object to decompose."""
        if not len(points):
            return np.zeros(0, bool)
        self.left -= 16 + len(points) * self._face_count // 500
        return np.abs(self._winding(points)) > 0.5

    def hull(self, points: Array) -> float:
        """Return the volume [m^3] of the convex hull of points (n, 3) on a piece of a concave object. The
        volume is 0 if the points are coplanar.
        """
        from scipy.spatial import ConvexHull, QhullError

        self.left -= 80 + len(points) // 5
        if len(points) < 4:
            return 0.0
        try:
            return float(ConvexHull(points).volume)
        except (QhullError, ValueError):
            return 0.0

    def measure_depth(self, piece: _Piece) -> None:
        """Measure how deep [m] a piece of a concave object is dented: the depth of its deepest vertex inside
        its convex hull.
        """
        from scipy.spatial import ConvexHull, QhullError

        points = piece.vertices
        piece.depth = 0.0
        if not len(points):  # the piece is inside the solid
            return
        try:
            planes = np.unique(ConvexHull(piece.points).equations.round(9), axis=0)
        except (QhullError, ValueError):
            return
        self.left -= 90 + len(points) * len(planes) // 50
        for some in np.array_split(points, len(points) // 500 + 1):
            above = (some @ planes[:, :3].T + planes[:, 3]).max(axis=1)
            piece.depth = max(piece.depth, -float(above.min()))


def cut(vertices: Array, faces: NDArray[np.int32], budget: int = WORK) -> tuple[list[Array], int]:
    """Decompose the closed mesh of a concave object into pieces, until the convex hulls of all pieces
    together have hardly more volume than the mesh.

    Args:
        vertices: (v, 3) [m].
        faces: (f, 3) with outward normals.
        budget: see `WORK`.
    Returns:
        The points (n, 3) of each piece, whose convex hulls are the pieces, and the rest of the budget.
    """
    work = _Work(budget, vertices, faces)
    triangles = vertices[faces]
    whole = _Piece(
        triangles,
        np.empty((0, 3, 3)),
        _reflex_edges(vertices, faces),
        np.empty((0, 4)),
        np.empty((0, 3)),
        work.hull(triangles.reshape(-1, 3)),
    )
    volume = signed_volume(triangles)
    done, pieces = [], [whole]
    excess = [whole.excess]
    while pieces and len(done) + len(pieces) < MAX_PIECES and work.left > 0:
        if sum(excess) + sum(p.excess for p in done) > EXCESS * volume:
            worst = int(np.argmax(excess))
        else:
            for piece in pieces:
                if piece.depth == np.inf:
                    work.measure_depth(piece)
            worst = int(np.argmax([piece.depth for piece in pieces]))
            if pieces[worst].depth <= DEPTH:
                break
        halves = _best_cut(pieces[worst], work)
        if halves is None:
            done.append(pieces.pop(worst))
            excess.pop(worst)
        else:
            pieces[worst : worst + 1] = halves
            excess[worst : worst + 1] = [half.excess for half in halves]
    return [piece.points for piece in (*done, *pieces)], max(work.left, 0)


def _best_cut(piece: _Piece, work: _Work) -> tuple[_Piece, _Piece] | None:
    """Find the best cut through a reflex edge of a concave piece of an object. Return the pieces on both
    sides, or None if no cut helps.

    The first cuts of a cup or a bin save no volume, because a ring has the same hull as its disk. The score
    therefore also counts how far the reflex edges are resolved and distributed.
    """
    best, found = 0.0, None
    excess = piece.excess
    work.left -= 150 + 2 * len(piece.edges.weights)
    for plane in _candidates(piece):
        if work.left <= 0:
            break
        work.left -= 200 + len(piece.triangles) // 14
        corners = _corners(piece, plane, work)
        beside = piece.points_beside(plane)
        hulls = [work.hull(np.vstack(points)) for points in zip(beside, corners, strict=True)]
        if min(hulls) <= 0.0:
            continue
        score = (piece.hull - sum(hulls)) / excess
        if len(piece.edges.weights):
            score += EDGES * (1.0 - sum(share**2 for share in piece.edges.shares(plane)))
        if score > best + 1e-9:
            best, found = score, (plane, corners, hulls)
    if found is None:
        return None
    plane, corners, hulls = found
    return (
        _half(piece, plane, corners[0], hulls[0], work),
        _half(piece, -plane, corners[1], hulls[1], work),
    )


def _half(piece: _Piece, plane: Array, corners: Array, hull: float, work: _Work) -> _Piece:
    work.left -= 250 + len(piece.triangles) // 2 + len(piece.caps) // 6
    origin = -plane[3] * plane[:3]
    triangles, rim = clip(piece.triangles, plane)
    caps, cap_rim = clip(piece.caps, plane)
    rims = np.concatenate([rim, cap_rim])
    fans = np.concatenate([np.broadcast_to(origin, (len(rims), 1, 3)), rims[:, ::-1]], axis=1)
    caps = np.concatenate([caps, fans])
    return _Piece(triangles, caps, piece.edges.below(plane), np.vstack([piece.cell, plane]), corners, hull)


def _corners(piece: _Piece, plane: Array, work: _Work) -> tuple[Array, Array]:
    """Return the corners (n, 3) and (m, 3) of the two convex cells of space into which a plane cuts a cell,
    below and above the plane. Only corners inside the object to decompose are returned.
    """
    cell = piece.cell
    height = piece.corners @ plane[:3] + plane[3]
    first, second = np.triu_indices(len(cell), 1)
    planes = np.stack([cell[first], cell[second], np.broadcast_to(plane, (len(first), 4))], axis=1)
    planes = planes[np.abs(np.linalg.det(planes[:, :, :3])) > 1e-3]
    moves = -_INWARD * np.array([[1.0, 1, 1], [1, 1, -1]])  # into the cells below and above the plane
    known = np.concatenate([-planes[:, None, :, 3], np.broadcast_to(moves, (len(planes), 2, 3))], axis=1)
    corners, below, above = np.linalg.solve(planes[:, :, :3], known.transpose(0, 2, 1)).transpose(2, 0, 1)
    found = []
    for old, inward in ((height < 0, below), (height > 0, above)):
        tested = corners + inward  # decides where a corner is on the surface
        rows = (tested @ cell[:, :3].T + cell[:, 3] < 0).all(1)
        found.append(np.vstack([piece.corners[old], corners[rows][work.inside(tested[rows])]]))
    return found[0], found[1]


def _candidates(piece: _Piece) -> Array:
    """Return candidate planes (k, 4) for cutting a piece of a concave object, each as a normal n and an
    offset d with n · x + d = 0.
    """
    points = piece.vertices
    low, high = points.min(0), points.max(0)
    planes = [
        np.r_[-np.eye(3)[axis], low[axis] + fraction * (high[axis] - low[axis])]
        for axis in range(3)
        for fraction in (_FRACTIONS if len(piece.triangles) < _MANY else (0.5,))
    ]
    edges = piece.edges
    if len(edges.weights):
        found = edges.planes.reshape(-1, 4)
        weights = np.repeat(edges.weights, 3)
        scale = float(np.linalg.norm(high - low))
        # equal planes count together: the floor of a bin has many reflex edges
        keys = np.round(np.c_[found[:, :3], found[:, 3:] / scale] / 0.02).astype(np.int64)
        _, first, group = np.unique(keys, axis=0, return_index=True, return_inverse=True)
        total = np.bincount(group.ravel(), weights)
        order = np.argsort(-total, kind="stable")
        planes += list(found[first[order[:_PLANES]]])
    return np.array(planes)


def _reflex_edges(vertices: Array, faces: NDArray[np.int32]) -> _Reflex:
    """Return the reflex edges of a concave object's mesh, at which the interior angle exceeds 180 degrees.
    The decomposition cuts the object there.
    """
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0)
    directed = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    face = np.tile(np.arange(len(faces)), 3)
    key = np.sort(directed, axis=1).astype(np.int64) @ np.array([len(vertices), 1])
    order = np.argsort(key, kind="stable")
    same = np.flatnonzero(key[order][1:] == key[order][:-1])
    one, two = order[same], order[same + 1]
    a, b = vertices[directed[one, 0]], vertices[directed[one, 1]]
    n, m = normals[face[one]], normals[face[two]]
    along = b - a
    length = np.linalg.norm(along, axis=1)
    # the cross product of the normals points along face one's direction of the edge where the edge is convex
    sine = np.einsum("ij,ij->i", np.cross(n, m), along) / np.maximum(length, 1e-12)
    angle = np.arctan2(-sine, np.einsum("ij,ij->i", n, m))
    rows = (angle > _FLAT) & (length > 0)
    a, n, m, along = a[rows], n[rows], m[rows], along[rows]
    bisector = np.cross(along, n + m)
    size = np.linalg.norm(bisector, axis=1, keepdims=True)
    bisector = np.divide(bisector, size, out=n.copy(), where=size > 1e-12)
    kinds = np.stack([bisector, n, m], axis=1)
    kinds *= np.where(np.take_along_axis(kinds, np.abs(kinds).argmax(2)[..., None], 2) < 0, -1.0, 1.0)
    planes = np.concatenate([kinds, -np.einsum("ekj,ej->ek", kinds, a)[..., None]], axis=2)
    return _Reflex(np.stack([a, b[rows]], 1), planes, length[rows] * angle[rows])


def clip(triangles: Array, plane: Array) -> tuple[Array, Array]:
    """Clip the triangles (n, 3, 3) of a concave object at a cutting plane (4,), given as normal and offset,
    to decompose the object.

    Returns:
        The part (k, 3, 3) with n x + d <= 0 without triangles in the plane, and the edges (e, 2, 3) of this
        part in the plane, in the direction of their triangles.
    """
    height = triangles @ plane[:3] + plane[3]  # (n, 3)
    height[np.abs(height) < _ON_PLANE] = 0.0
    above, on = height > 0, height == 0
    count = above.sum(1)
    kept = triangles[(count == 0) & ~on.all(1)]
    parts, rims = [kept], []
    on_kept = on[(count == 0) & ~on.all(1)]
    for k in range(3):
        rows = on_kept[:, k] & on_kept[:, (k + 1) % 3]
        rims.append(kept[rows][:, [k, (k + 1) % 3]])
    for one_above in (True, False):  # triangles with one corner to cut off, or with one corner to keep
        rows = np.flatnonzero((count == (1 if one_above else 2)) & (height < 0).any(1))
        if len(rows) == 0:
            continue
        odd = np.argmax(above[rows] if one_above else ~above[rows], axis=1)
        p, q, r, pq, pr = cut_corners(triangles[rows], height[rows], odd)
        if one_above:
            parts += [np.stack([pq, q, r], 1), np.stack([pq, r, pr], 1)]
            rims.append(np.stack([pr, pq], 1))
        else:
            parts.append(np.stack([p, pq, pr], 1))
            rims.append(np.stack([pq, pr], 1))
    return np.concatenate(parts), np.concatenate(rims)


@lru_cache(maxsize=256)
def object_pieces(mesh: Mesh) -> tuple[Mesh, ...]:
    """Decompose an object's mesh into convex meshes whose union contains it; the result is cached on disk.

    Each closed solid of a mesh is decomposed on its own, into pieces that do not overlap. Their total
    volume exceeds the solid's volume by at most `EXCESS`, and they cover no point of its surface deeper than
    `DEPTH`, unless the budget ends first; the solids of a mesh share one budget. An open mesh has no volume:
    `convex_pieces` divides it. The same mesh always yields the same pieces.

    Raises:
        InputError: the mesh is flat.
    """
    import trimesh  # slow to import

    merged = trimesh.Trimesh(mesh.vertices, mesh.faces, process=True)  # STL files repeat their vertices
    solids = list(merged.split(only_watertight=False))
    with np.errstate(invalid="ignore"):  # a part may be a sheet, which encloses nothing
        are_solids = all(part.is_watertight and part.volume > 0 for part in solids)
    if len(solids) == 1 or not are_solids:
        solids = [merged]
        if not is_closed(mesh) or _is_convex(merged):
            return convex_pieces(mesh)
    key = key_of(f"concave{VERSION}", mesh.vertices.astype(float), mesh.faces.astype(np.int32))
    return stored_pieces(key, lambda: _cut_solids(solids, str(mesh.file or "mesh")))


def _is_convex(solid: trimesh.Trimesh) -> bool:
    return abs(solid.volume) > CONVEX * solid.convex_hull.volume


def _cut_solids(solids: list[trimesh.Trimesh], name: str) -> tuple[Mesh, ...]:
    """Decompose each solid of a mesh into convex pieces. The solids share one budget.

    Solids may overlap: the volume of the mesh as a whole would count the overlap twice.
    """
    pieces: list[Mesh] = []
    left, faces_left = WORK, sum(len(solid.faces) for solid in solids)
    for solid in sorted(solids, key=lambda solid: len(solid.faces)):
        count = len(solid.faces)
        budget, faces_left = left * count // faces_left, faces_left - count
        if _is_convex(solid):
            pieces += convex_pieces(Mesh(solid.vertices, solid.faces.astype(np.int32)))
            continue
        solid.fix_normals(multibody=True)
        cells, rest = cut(np.array(solid.vertices, float), np.array(solid.faces, np.int32), budget)
        left += rest - budget
        pieces += [piece for piece in map(convex_hull_mesh, cells) if _mesh_volume(piece) > SMALLEST]
    total, volume = sum(map(_mesh_volume, pieces)), sum(solid.volume for solid in solids)
    if total > (1 + 2 * EXCESS) * volume:
        log.warning(
            "%s: %d convex pieces fill %.1f cm3, the mesh %.1f cm3: its openings are smaller in physics",
            name, len(pieces), total * 1e6, volume * 1e6,
        )  # fmt: skip
    return tuple(pieces)


def _mesh_volume(piece: Mesh) -> float:
    """Return the volume [m^3] of a closed mesh with outward normals, for the convex decomposition of an
    object.
    """
    a, b, c = (piece.vertices[piece.faces[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", a - piece.vertices[0], np.cross(b - a, c - a))) / 6
