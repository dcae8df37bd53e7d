"""Closed meshes: whether a triangle mesh encloses a volume, and filling of small holes.

A mesh is closed if each of its directed edges has a counterpart in the opposite direction. This also holds
for bodies that touch along an edge, where four triangles meet.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from armcell.core.geometry import Mesh

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

SAME = 1e-8  # [m] grid on which vertices count as one
LARGEST_HOLES = 0.05  # of the mesh's area: larger holes are openings of a surface, not defects


@lru_cache(maxsize=256)
def open_edges(mesh: Mesh) -> Ints:
    """Return the directed edges (e, 2) at which a mesh is open, as vertex indices. At these edges, no
    adjacent triangle has the opposite edge.

    Vertices at the same point count as one. A mesh in which every edge has two triangles is closed, even if
    the triangles are not oriented consistently.
    """
    first, same = np.unique((mesh.vertices / SAME).round(), axis=0, return_index=True, return_inverse=True)[
        1:
    ]
    a, b, c = first[same.ravel()[mesh.faces]].T.astype(np.int64)
    starts, ends = np.concatenate([a, b, c]), np.concatenate([b, c, a])
    real, count = starts != ends, len(mesh.vertices)
    starts, ends = starts[real], ends[real]
    edges, net = np.unique(np.minimum(starts, ends) * count + np.maximum(starts, ends), return_inverse=True)
    excess = np.bincount(net, weights=np.where(starts < ends, 1, -1)).astype(int)
    if np.all(np.bincount(net) == 2):
        excess[:] = 0
    low, high = np.divmod(edges, count)
    pairs = np.where((excess > 0)[:, None], np.column_stack([low, high]), np.column_stack([high, low]))
    return np.repeat(pairs, np.abs(excess), axis=0)


def is_closed(mesh: Mesh) -> bool:
    """Return whether a mesh encloses a volume."""
    return not len(open_edges(mesh))


def with_small_holes_filled(mesh: Mesh) -> Mesh:
    """Return a mesh whose holes are filled with triangles, if they are small defects.

    The mesh itself is returned if it is closed, or if the holes together have more than `LARGEST_HOLES` of
    its area. Each hole is filled by a fan from one of its vertices.
    """
    edges = open_edges(mesh)
    if not len(edges):
        return mesh
    fans = [(loop[0], loop[i + 1], loop[i]) for loop in _loops(edges) for i in range(1, len(loop) - 1)]
    caps = np.array(fans, dtype=mesh.faces.dtype).reshape(-1, 3)
    if _area(mesh.vertices, caps) > LARGEST_HOLES * _area(mesh.vertices, mesh.faces):
        return mesh
    return Mesh(mesh.vertices, np.vstack([mesh.faces, caps]), mesh.file)


def _loops(edges: Ints) -> list[list[int]]:
    """Divide the open edges of a mesh into simple loops of vertices. Each vertex has as many incoming as
    outgoing edges.
    """
    after: dict[int, list[int]] = {}
    for a, b in edges.tolist():
        after.setdefault(a, []).append(b)
    found: list[list[int]] = []
    for start in list(after):
        while after[start]:
            path = [start]
            while after[path[-1]]:
                following = after[path[-1]].pop()
                if following in path:  # cut the loop off, and go on with what led to it
                    at = path.index(following)
                    found.append(path[at:])
                    del path[at + 1 :]
                else:
                    path.append(following)
    return found


def _area(vertices: Array, faces: NDArray[np.int32]) -> float:
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()) / 2
