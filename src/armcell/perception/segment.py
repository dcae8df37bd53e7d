"""Segmentation of an organized point cloud into clusters of neighboring, close points."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

F64 = NDArray[np.float64]


def clusters(points: F64, wanted: NDArray[np.bool_], gap: float, smallest: int) -> list[NDArray[np.int64]]:
    """Segment an organized point cloud into clusters. Return the pixel indices (n,) of each cluster, largest
    first.

    Args:
        points: (h, w, 3) [m].
        wanted: (h, w) mask of the pixels to be clustered; their points are finite.
        gap: largest distance [m] between neighboring points of a cluster, up to two pixels apart.
        smallest: clusters with fewer pixels are noise.
    """
    labels = _labels(points, wanted, gap).ravel()
    inside = np.flatnonzero(labels >= 0)
    order = inside[np.argsort(labels[inside], kind="stable")]
    _, starts = np.unique(labels[order], return_index=True)
    found = [part for part in np.split(order, starts[1:]) if len(part) >= smallest]
    return sorted(found, key=lambda part: -len(part))


@njit(cache=True)
def _root(parent, i):
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@njit(cache=True)
def _labels(points, wanted, gap):
    h, w = wanted.shape
    parent = np.arange(h * w)
    for v in range(h):
        for u in range(w):
            if not wanted[v, u]:
                continue
            for dv in range(-2, 1):
                for du in range(-2, 3):
                    if (dv == 0 and du >= 0) or v + dv < 0 or u + du < 0 or u + du >= w:
                        continue
                    if not wanted[v + dv, u + du]:
                        continue
                    d = 0.0
                    for k in range(3):
                        d += (points[v, u, k] - points[v + dv, u + du, k]) ** 2
                    if d <= gap * gap:
                        a, b = _root(parent, v * w + u), _root(parent, (v + dv) * w + u + du)
                        parent[max(a, b)] = min(a, b)
    out = np.full((h, w), -1)
    for v in range(h):
        for u in range(w):
            if wanted[v, u]:
                out[v, u] = _root(parent, v * w + u)
    return out
