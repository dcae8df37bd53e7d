"""Decimation of meshes for drawing and for comparison with images."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

_FLAT = 0.03  # ratio of the smallest curvature of a decimated mesh that places a vertex, to the largest


def decimated(
    vertices: NDArray[np.float64], faces: NDArray[Any], max_faces: int
) -> tuple[NDArray[np.float64], NDArray[Any]]:
    """Decimate a mesh, to about `max_faces` triangles, by vertex clustering.

    The clustering grid coarsens until the mesh has at most `max_faces` triangles. The vertex of a grid cell
    is where the planes of the cell's triangles meet, so that edges remain sharp and the mesh does not shrink
    (Lindstrom, SIGGRAPH 2000). No vertex moves by more than the diagonal of a grid cell. Never use the result
    for collision checking.
    """
    if len(faces) <= max_faces:
        return vertices, faces
    cell = float(np.ptp(vertices, axis=0).max()) / 400
    while True:
        grid, member = np.unique(np.floor(vertices / cell).astype(np.int64), axis=0, return_inverse=True)
        member = member.ravel()
        a, b, c = member[faces].T
        kept = (a != b) & (b != c) & (c != a)
        if kept.sum() <= max_faces:
            break
        cell *= 1.25
    means = np.stack([np.bincount(member, x) for x in vertices.T], axis=1) / np.bincount(member)[:, None]
    placed = means + _to_planes(vertices[faces], member[faces], means)
    return np.clip(placed, grid * cell, (grid + 1) * cell), member[faces[kept]]


def _to_planes(
    triangles: NDArray[np.float64], cells: NDArray[Any], means: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the shortest steps (n, 3) from points to where their distances from the planes of triangles
    (m, 3, 3) are the smallest, for the decimation of a mesh. `cells` (m, 3) are the points of each triangle.
    """
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    A, g = np.zeros((len(means), 3, 3)), np.zeros((len(means), 3))
    for k in range(3):
        away = np.einsum("ij,ij->i", normals, triangles[:, 0] - means[cells[:, k]])
        np.add.at(A, cells[:, k], normals[:, :, None] * normals[:, None])
        np.add.at(g, cells[:, k], normals * away[:, None])
    return np.einsum("kij,kj->ki", np.linalg.pinv(A, rcond=_FLAT, hermitian=True), g)
