"""Detection of the support plane, on which objects rest, in a point cloud.

Fischler and Bolles, "Random sample consensus", Communications of the ACM 24(6), 1981; then least squares.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from armcell.core import SE3, SO3
from armcell.core.checks import float_array, is_number, require

F64 = NDArray[np.float64]
MAX_TRIALS = 100_000
_SUBSET = 1500  # number of points with which trials are evaluated


@dataclass(frozen=True, eq=False)
class SupportPlane:
    """Support plane n . p = offset found in a point cloud, with the quality of the fit."""

    normal: F64  # (3,) unit vector, toward the supported objects
    offset: float  # [m]
    inliers: int
    rms: float  # [m] rms distance of the inliers

    def __post_init__(self) -> None:
        float_array(self.normal, (3,), "a plane's normal")

    def heights(self, points: F64) -> F64:
        """Return the heights (...) [m] of points (..., 3) above the support plane; negative below it."""
        return float_array(points, (-1, 3), "points", finite=False) @ self.normal - self.offset

    def frame(self, point: F64) -> SE3:
        """Return a frame on the detected support plane whose origin is the projection of a given point.

        The z axis is the plane's normal. The shortest rotation from the world frame determines x and y.
        """
        point = float_array(point, (3,), "a point")
        R = SO3.between([0.0, 0.0, 1.0], self.normal)
        return SE3(R, point - (point @ self.normal - self.offset) * self.normal)


def find_plane(
    points: F64, up: F64, max_tilt: float, thickness: float, seed: int = 0, trials: int = 120
) -> SupportPlane | None:
    """Find the plane that supports the most points of a point cloud (n, 3), by RANSAC and least squares.

    The result is None if no trial finds a valid plane.

    Args:
        up: (3,) direction from which the plane's normal may deviate by `max_tilt` [rad].
        thickness: points within this distance [m] belong to the plane.
        seed: seed of the random trials.
        trials: number of random planes.
    """
    points, up = float_array(points, (None, 3), "points"), float_array(up, (3,), "up")
    for name, value in (("max_tilt", max_tilt), ("thickness", thickness), ("trials", trials)):
        require(is_number(value), f"{name} is {value!r}, it must be a finite number")
    require(0 < trials <= MAX_TRIALS, f"trials is {trials}, it must be 1 to {MAX_TRIALS}")
    if len(points) < 3:
        return None
    rng = np.random.default_rng(seed)
    some = points[rng.integers(0, len(points), min(_SUBSET, len(points)))]
    picks = rng.integers(0, len(some), (trials, 3))
    best = _best_trial(some, picks, up, np.cos(max_tilt), thickness)
    if best < 0:
        return None
    a, b, c = some[picks[best]]
    n = np.cross(b - a, c - a)
    n /= np.linalg.norm(n)
    offset, near = float(n @ a), np.zeros(0, bool)
    for _ in range(3):
        near = np.abs(points @ n - offset) <= thickness
        if near.sum() < 3:
            return None
        middle = points[near].mean(axis=0)
        d = points[near] - middle
        _, vectors = np.linalg.eigh(d.T @ d)
        n = vectors[:, 0]
        offset = float(n @ middle)
    if n @ up < 0:
        n, offset = -n, -offset
    rms = float(np.sqrt(np.mean((points[near] @ n - offset) ** 2)))
    return SupportPlane(n, offset, int(near.sum()), rms)


@njit(cache=True)
def _best_trial(points, picks, up, least_cosine, thickness):
    best, most = -1, 0
    for k in range(len(picks)):
        a, b, c = points[picks[k, 0]], points[picks[k, 1]], points[picks[k, 2]]
        n = np.cross(b - a, c - a)
        length = np.sqrt(n[0] ** 2 + n[1] ** 2 + n[2] ** 2)
        if length < 1e-9:
            continue
        n /= length
        if abs(n[0] * up[0] + n[1] * up[1] + n[2] * up[2]) < least_cosine:
            continue
        offset = n[0] * a[0] + n[1] * a[1] + n[2] * a[2]
        count = 0
        for i in range(len(points)):
            p = points[i]
            count += abs(n[0] * p[0] + n[1] * p[1] + n[2] * p[2] - offset) <= thickness
        if count > most:
            best, most = k, count
    return best
