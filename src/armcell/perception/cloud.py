"""Depth images as organized point clouds: conversion, clusters and the support plane.

An organized cloud has one point per pixel. The support plane, on which objects rest, is found by
Fischler and Bolles, "Random sample consensus", Communications of the ACM 24(6), 1981; then least
squares.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from armcell.core import SE3, SO3, InputError, Pinhole
from armcell.core.checks import float_array, is_number, require

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
MAX_TRIALS = 100_000
_SPECK = 4  # [px] smaller parts of clusters are noise
_SUBSET = 1500  # number of points with which trials are evaluated


def meters(depth: ArrayLike) -> F32:
    """Convert a depth image (h, w) to meters for a point cloud. Missing depth becomes 0.

    Integers are millimeters (ROS's 16UC1).
    """
    image = np.asarray(depth)
    if image.ndim != 2 or image.dtype.kind not in "fiu":
        raise InputError(f"a depth image has rows and columns of numbers, not shape {image.shape}")
    z = image.astype(np.float32) * np.float32(1.0 if image.dtype.kind == "f" else 1e-3)
    return np.where(np.isfinite(z) & (z > 0), z, np.float32(0.0))


def organized_cloud(depth: ArrayLike, pinhole: Pinhole) -> F64:
    """Convert a depth image to an organized point cloud (h, w, 3) [m, camera frame].

    Pixels without depth yield NaN.
    """
    z = meters(depth)
    if z.shape != (pinhole.height, pinhole.width):
        raise InputError(
            f"depth of {z.shape[1]} x {z.shape[0]} pixels for a camera of {pinhole.width} x {pinhole.height}",
            hint="use the camera info of this picture's size",
        )
    z = np.where(z > 0, z, np.nan)
    out = np.empty((*z.shape, 3))
    out[..., 0] = (np.arange(pinhole.width) - pinhole.cx) / pinhole.fx * z
    out[..., 1] = ((np.arange(pinhole.height) - pinhole.cy) / pinhole.fy)[:, None] * z
    out[..., 2] = z
    return out


def clusters(points: F64, wanted: NDArray[np.bool_], gap: float, smallest: int) -> list[NDArray[np.int64]]:
    """Group the neighboring points of an organized point cloud into clusters. Return the pixel indices (n,)
    of each cluster, largest first.

    Args:
        points: (h, w, 3) [m].
        wanted: (h, w) mask of the pixels to be clustered; their points are finite.
        gap: largest distance [m] between neighboring points of a cluster, up to two pixels apart.
        smallest: clusters with fewer pixels are noise, unless they are parts of one thin object: together
            large enough, and no farther apart than the gap.
    """
    labels = _labels(points, wanted, gap).ravel()
    inside = np.flatnonzero(labels >= 0)
    order = inside[np.argsort(labels[inside], kind="stable")]
    _, starts = np.unique(labels[order], return_index=True)
    parts = np.split(order, starts[1:])
    found = [part for part in parts if len(part) >= smallest]
    found += _thin(points, [part for part in parts if _SPECK <= len(part) < smallest], gap, smallest)
    return sorted(found, key=lambda part: -len(part))


def _thin(points: F64, parts: list[NDArray[np.int64]], gap: float, smallest: int) -> list[NDArray[np.int64]]:
    """Return the clusters of an organized cloud that consist of small parts: a wall one pixel wide that is
    seen from above falls apart, because its pixels show its top or its foot.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import KDTree

    if sum(map(len, parts)) < smallest:
        return []
    pixels = np.concatenate(parts)
    owner = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
    near = owner[KDTree(points.reshape(-1, 3)[pixels]).query_pairs(gap, output_type="ndarray")]
    links = coo_array((np.ones(len(near)), (near[:, 0], near[:, 1])), shape=(len(parts), len(parts)))
    count, label = connected_components(links, directed=False)
    joined = [pixels[label[owner] == n] for n in range(count)]
    return [part for part in joined if len(part) >= smallest]


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
        """Return the heights (...) [m] of points (..., 3) above the support plane of a point cloud; negative
        below it.
        """
        return float_array(points, (-1, 3), "points", finite=False) @ self.normal - self.offset

    def frame(self, point: F64) -> SE3:
        """Return a frame on the support plane of a point cloud, whose origin is the projection of a given
        point.

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
