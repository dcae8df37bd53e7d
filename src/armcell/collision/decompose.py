"""Convex decomposition of movable objects for physics, with CoACD if installed.

CoACD (extra `decompose`) follows cavities that axis-aligned cuts miss. Without CoACD, `convex_pieces`
decomposes the objects. Robot links always use `convex_pieces`: its pieces contain the mesh, whereas CoACD's
pieces only approximate the mesh.
"""

from __future__ import annotations

import importlib.util
import logging
import subprocess
import sys
import tempfile
from functools import lru_cache
from pathlib import Path

import numpy as np

from armcell._array_store import keep, key_of, recall
from armcell.collision.convex import convex_pieces
from armcell.core import Mesh

log = logging.getLogger(__name__)

CONCAVITY = 0.06  # CoACD's concavity threshold; smaller values fit the mesh better, with more pieces
MAX_HULLS = 24
MAX_SECONDS = 120
CONVEX = 0.98  # a mesh that fills more than this fraction of its hull's volume counts as convex
VERSION = 1  # increase when the same mesh yields different pieces, to invalidate the disk cache


@lru_cache(maxsize=1)
def can_decompose() -> bool:
    """Return True if CoACD is installed."""
    return importlib.util.find_spec("coacd") is not None


@lru_cache(maxsize=256)
def object_pieces(mesh: Mesh) -> tuple[Mesh, ...]:
    """Return convex meshes whose union approximates `mesh`, cached on disk.

    The same mesh always yields the same pieces.
    """
    import trimesh

    solid = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    closed = solid.is_watertight
    if not can_decompose() or (closed and abs(solid.volume) > CONVEX * solid.convex_hull.volume):
        return convex_pieces(mesh)
    key = key_of(f"coacd{VERSION}", mesh.vertices.astype(float), mesh.faces.astype(np.int32))
    stored = recall("pieces", key)
    if stored is None:
        found = _coacd(mesh, closed)
        if not found:  # cache the fallback, too, so that CoACD does not run again on this mesh
            found = [(piece.vertices, piece.faces) for piece in convex_pieces(mesh)]
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
    """Return CoACD's pieces as (vertices, faces), or an empty list if CoACD failed.

    CoACD runs in a separate process, because it crashes on some meshes.
    """
    with tempfile.TemporaryDirectory() as folder:
        given, found = Path(folder) / "mesh.npz", Path(folder) / "pieces.npz"
        preprocess = "off" if closed else "on"
        np.savez(given, vertices=mesh.vertices, faces=mesh.faces)
        # -P: do not import modules from the current folder, which may belong to another user
        command = [sys.executable, "-P", "-c", _PROGRAM, str(given), str(found), preprocess]
        try:
            done = subprocess.run(command, capture_output=True, timeout=MAX_SECONDS, check=False)
        except subprocess.TimeoutExpired:
            log.warning(
                "%s: CoACD took more than %d s; split by our own cuts", mesh.file or "mesh", MAX_SECONDS
            )
            return []
        if done.returncode != 0 or not found.exists():
            log.warning("%s: CoACD failed on this mesh; split by our own cuts", mesh.file or "mesh")
            return []
        with np.load(found) as stored:
            hulls = [(stored[f"v{i}"], stored[f"f{i}"]) for i in range(len(stored.files) // 2)]
    pieces = []
    for vertices, faces in hulls:
        try:
            pieces.append(_outward(vertices, faces))
        except Exception as error:  # a hull without volume; qhull defines its own error types
            log.info(
                "%s: a piece of CoACD's is left out: %s", mesh.file or "mesh", str(error).splitlines()[0]
            )
    return pieces


_PROGRAM = f"""
import ctypes, signal, sys

ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG: it ends with its parent
import coacd
import numpy as np

given, found, preprocess = sys.argv[1:]
coacd.set_log_level("off")
with np.load(given) as mesh:
    mesh = coacd.Mesh(mesh["vertices"], mesh["faces"])
hulls = coacd.run_coacd(
    mesh, threshold={CONCAVITY}, max_convex_hull={MAX_HULLS}, mcts_iterations=40, mcts_nodes=10,
    mcts_max_depth=2, preprocess_mode=preprocess, preprocess_resolution=40, seed=0,
)
arrays = {{}}
for i, (vertices, faces) in enumerate(hulls):
    arrays[f"v{{i}}"], arrays[f"f{{i}}"] = np.asarray(vertices, float), np.asarray(faces)
np.savez(found, **arrays)
"""


def _outward(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    import trimesh

    hull = trimesh.Trimesh(vertices, faces, process=False).convex_hull
    if hull.volume <= 0:
        raise ValueError("no volume")
    return np.asarray(hull.vertices), np.asarray(hull.faces)
