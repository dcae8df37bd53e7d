"""Convex pieces of objects for physics: by CoACD where it is installed, else by our own cuts.

CoACD (extra `decompose`) follows hollows that cuts along the axes miss. A robot's links always take
`convex_pieces`: their pieces have to hold the mesh, CoACD's only come near it.
"""

from __future__ import annotations

import importlib.util
import logging
from functools import lru_cache

import numpy as np

from armcell.collision.convex import convex_pieces
from armcell.collision.kernel.store import keep, key_of, recall
from armcell.core import Mesh

log = logging.getLogger(__name__)

CONCAVITY = 0.06  # CoACD's threshold: smaller follows the mesh closer, with more pieces
MAX_HULLS = 24
CONVEX = 0.98  # share of its hull that a mesh fills to be taken as convex
VERSION = 1  # to be raised when the same mesh gives other pieces


@lru_cache(maxsize=1)
def can_decompose() -> bool:
    """Whether CoACD is installed."""
    return importlib.util.find_spec("coacd") is not None


@lru_cache(maxsize=256)
def object_pieces(mesh: Mesh) -> tuple[Mesh, ...]:
    """Convex meshes whose union is (nearly) `mesh`, kept on disk. The same mesh gives the same pieces."""
    import trimesh

    solid = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    closed = solid.is_watertight
    if not can_decompose() or (closed and abs(solid.volume) > CONVEX * solid.convex_hull.volume):
        return convex_pieces(mesh)
    key = key_of(f"coacd{VERSION}", mesh.vertices.astype(float), mesh.faces.astype(np.int32))
    stored = recall("pieces", key)
    if stored is None:
        found = _coacd(mesh, closed)
        if not found:
            return convex_pieces(mesh)
        counts = np.array([(len(v), len(f)) for v, f in found])
        stored = {
            "counts": counts,
            "vertices": np.vstack([v for v, _ in found]),
            "faces": np.vstack([f for _, f in found]),
        }
        keep("pieces", key, **stored)
    v, f = np.cumsum(stored["counts"], axis=0)[:-1].T
    parts = zip(np.split(stored["vertices"], v), np.split(stored["faces"], f), strict=True)
    return tuple(Mesh(vertices, faces.astype(np.int32)) for vertices, faces in parts)


def _coacd(mesh: Mesh, closed: bool) -> list[tuple[np.ndarray, np.ndarray]]:
    import coacd

    coacd.set_log_level("off")
    hulls = coacd.run_coacd(
        coacd.Mesh(mesh.vertices, mesh.faces),
        threshold=CONCAVITY, max_convex_hull=MAX_HULLS, mcts_iterations=40, mcts_nodes=10, mcts_max_depth=2,
        preprocess_mode="off" if closed else "on", preprocess_resolution=40, seed=0,
    )  # fmt: skip
    found = []
    for vertices, faces in hulls:
        try:
            piece = _outward(np.asarray(vertices, dtype=float), np.asarray(faces))
        except Exception as error:  # a hull without a volume: qhull has errors of its own
            log.info(
                "%s: a piece of CoACD's is left out: %s", mesh.file or "mesh", str(error).splitlines()[0]
            )
            continue
        found.append(piece)
    return found


def _outward(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    import trimesh

    hull = trimesh.Trimesh(vertices, faces, process=False).convex_hull
    if hull.volume <= 0:
        raise ValueError("no volume")
    return np.asarray(hull.vertices), np.asarray(hull.faces)
