"""Mesh export for Unity: binary STL files, and convex hulls within Unity's limits."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from armcell.core import Mesh

Array = NDArray[np.float64]
MAX_HULL_POINTS = 128
"""Maximum corners of a hull: n corners give up to 2 n - 4 triangles, and Unity allows 255."""


def write_stl(mesh: Mesh, file: Path) -> None:
    """Write a mesh [m] for Unity as a binary STL file.

    Corners keep the mesh's order; normals follow the right-hand rule.
    """
    corners = mesh.vertices[mesh.faces]  # (f, 3, 3)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    rows = np.zeros(
        len(corners), np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("tag", "<u2")])
    )
    rows["normal"] = np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0)
    rows["corners"] = corners
    file.write_bytes(b"armcell".ljust(80, b" ") + np.uint32(len(rows)).tobytes() + rows.tobytes())


def small_hull(mesh: Mesh, points: int = MAX_HULL_POINTS) -> tuple[Mesh, float]:
    """Approximate a mesh by a convex hull with at most `points` corners, and return the hull and its error
    [m]. Unity limits the number of corners of a collider.

    The error is the largest distance [m] of an unused corner outside the planes of the hull's faces. The hull
    grows by the corner that is farthest outside, so it is inside the convex hull of the mesh.

    Args:
        mesh: the mesh.
        points: maximum number of corners.
    Raises:
        QhullError: the mesh is flat.
    """
    corners = np.unique(mesh.vertices, axis=0)
    corners = corners[ConvexHull(corners).vertices]
    chosen = _spread(corners)
    while True:
        hull = ConvexHull(corners[chosen])
        outside = (corners @ hull.equations[:, :3].T + hull.equations[:, 3]).max(1)
        farthest = int(np.argmax(outside))
        if outside[farthest] < 1e-9 or len(chosen) >= min(points, len(corners)):
            return _oriented(corners[chosen], hull), max(float(outside[farthest]), 0.0)
        chosen.append(farthest)


def _spread(corners: Array) -> list[int]:
    """Return the indices of at least four mesh corners that span a volume.
    The hull for Unity starts from these corners.

    The corners are the extremes along ten directions, and further corners if these are coplanar.
    """
    directions = np.vstack([np.eye(3), -np.eye(3), [[1, 1, 1], [-1, 1, 1], [1, -1, 1], [1, 1, -1]]])
    chosen = list(dict.fromkeys(np.argmax(corners @ directions.T, axis=0).tolist()))
    for i in range(len(corners)):
        try:
            ConvexHull(corners[chosen])
            break
        except (QhullError, ValueError):  # fewer than four corners, or coplanar corners
            if i not in chosen:
                chosen.append(i)
    return chosen


def _oriented(points: Array, hull: ConvexHull) -> Mesh:
    """Return the convex hull of a mesh for Unity, with the normals of all faces pointing outward."""
    index = np.full(len(points), -1)
    index[hull.vertices] = np.arange(len(hull.vertices))
    faces, vertices = index[hull.simplices], points[hull.vertices]
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), hull.equations[:, :3]) < 0
    faces[inward] = faces[inward][:, ::-1]
    return Mesh(vertices, faces.astype(np.int32))
