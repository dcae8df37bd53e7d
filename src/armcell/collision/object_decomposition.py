"""Convex pieces of objects for physics; closed meshes keep their cavities and openings.

Robot links always use `convex_pieces`, which divides a link into at most 12 pieces.
"""

from __future__ import annotations

import logging
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from armcell._array_store import key_of
from armcell.collision import concave_decomposition
from armcell.collision.convex_decomposition import convex_hull_mesh, convex_pieces, stored_pieces
from armcell.core import Mesh, is_closed

if TYPE_CHECKING:
    import trimesh

log = logging.getLogger(__name__)

CONVEX = 0.998  # a mesh that fills more than this fraction of its hull's volume counts as convex
SMALLEST = 1e-11  # [m^3] smaller pieces are left out; MuJoCo rejects meshes without volume
VERSION = 3  # increase when the same mesh yields different pieces, to invalidate the disk cache


@lru_cache(maxsize=256)
def object_pieces(mesh: Mesh) -> tuple[Mesh, ...]:
    """Decompose an object's mesh into convex meshes whose union contains it; the result is cached on disk.

    Each closed solid of a mesh is decomposed on its own, into pieces that do not overlap. Their total
    volume exceeds the solid's volume by at most `concave_decomposition.EXCESS`, and they cover no point of
    its surface deeper than `concave_decomposition.DEPTH`, unless the budget of `concave_decomposition.cut`
    ends first. An open mesh has no volume: `convex_pieces` divides it. The same mesh always yields the same
    pieces.

    Raises:
        InputError: the mesh is flat.
    """
    import trimesh  # slow to import

    merged = trimesh.Trimesh(mesh.vertices, mesh.faces, process=True)  # STL files repeat their vertices
    parts = merged.split(only_watertight=False)
    if len(parts) > 1 and all(part.is_watertight and part.volume > 0 for part in parts):
        # Solids that may overlap: the mesh's volume would count the overlap twice.
        solids = (Mesh(part.vertices, part.faces.astype(np.int32)) for part in parts)
        return tuple(piece for solid in solids for piece in object_pieces(solid))
    if not is_closed(mesh) or abs(merged.volume) > CONVEX * merged.convex_hull.volume:
        return convex_pieces(mesh)
    key = key_of(f"concave{VERSION}", mesh.vertices.astype(float), mesh.faces.astype(np.int32))
    return stored_pieces(key, lambda: _cut(mesh, merged))


def _cut(mesh: Mesh, merged: trimesh.Trimesh) -> tuple[Mesh, ...]:
    merged.fix_normals(multibody=True)
    found = concave_decomposition.cut(np.array(merged.vertices, float), np.array(merged.faces, np.int32))
    pieces = [piece for piece in map(convex_hull_mesh, found) if _volume(piece) > SMALLEST]
    total = sum(map(_volume, pieces))
    if total > (1 + 2 * concave_decomposition.EXCESS) * merged.volume:
        log.warning(
            "%s: %d convex pieces fill %.1f cm3, the mesh %.1f cm3: its openings are smaller in physics",
            mesh.file or "mesh", len(pieces), total * 1e6, merged.volume * 1e6,
        )  # fmt: skip
    return tuple(pieces)


def _volume(piece: Mesh) -> float:
    """Return the volume [m^3] of a closed mesh with outward normals, for the convex decomposition of an
    object.
    """
    a, b, c = (piece.vertices[piece.faces[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", a - piece.vertices[0], np.cross(b - a, c - a))) / 6
