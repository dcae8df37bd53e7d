"""The metric of smooth paths: squared accelerations, both ends fixed and at rest."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@lru_cache(maxsize=16)
def smooth_metric(count: int) -> tuple[Array, Array]:
    """For `count` waypoints between the ends: the inverse of the metric (count, count), scaled so that its
    largest element is 1, and a root of it (smooth noise is the root times white noise)."""
    K = np.zeros((count + 2, count))
    for i in range(count + 2):  # second differences; beyond the ends the path stands still
        for j, weight in ((i - 2, 1.0), (i - 1, -2.0), (i, 1.0)):
            if 0 <= j < count:
                K[i, j] += weight
    inverse = np.linalg.inv(K.T @ K)
    inverse /= inverse.max()
    return inverse, np.linalg.cholesky(inverse + 1e-12 * np.eye(count))


def resampled(path: Array, count: int) -> Array:
    """A path (k, n) as count + 2 waypoints, equally far apart along it."""
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    at = np.linspace(0.0, way[-1], count + 2)
    return np.column_stack([np.interp(at, way, path[:, j]) for j in range(path.shape[1])])
