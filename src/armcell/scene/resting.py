"""Stable resting poses of a convex hull, with support polygons and stability margins."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armcell._array_store import key_of, recall_or_compute

Array = NDArray[np.float64]

FLAT = 3e-4  # [m] tolerance of coplanar points
SAME = 0.01  # [rad] maximum angle between merged planes


@dataclass(frozen=True, eq=False)
class StablePose:
    """Stable resting pose of an object, with its up direction (3,), support polygon and stability margin.

    All are in the object's frame.
    """

    up: Array
    foot: Array  # (n, 3) [m] corners of the support polygon, in the object's frame, in order around `up`
    margin: float  # [m] distance of the projected center of mass to the nearest edge; < 0: unstable

    @property
    def height(self) -> float:
        """Return how far [m] an object's origin is above its support in a stable resting pose."""
        return -float(self.foot[0] @ self.up)


def hull_rests(points: Array, center_of_mass: Array) -> list[StablePose]:
    """Return the stable resting poses of the convex hull of points (n, 3), most stable first. If an earlier
    process computed them, they come from the disk cache.
    """
    corners = np.unique(points.round(7), axis=0)
    key = key_of(f"{FLAT} {SAME}", corners, center_of_mass)

    def computed() -> dict[str, NDArray]:
        found = _computed_rests(corners, center_of_mass)
        return {
            "ups": np.array([rest.up for rest in found]),
            "feet": np.concatenate([np.zeros((0, 3)), *(rest.foot for rest in found)]),
            "ends": np.cumsum([len(rest.foot) for rest in found], dtype=np.int64),
            "margins": np.array([rest.margin for rest in found]),
        }

    stored = recall_or_compute("stable_poses", key, computed)
    feet = np.split(stored["feet"], stored["ends"][:-1])
    return [StablePose(*each) for each in zip(stored["ups"], feet, stored["margins"].tolist())]


def _computed_rests(corners: Array, center_of_mass: Array) -> list[StablePose]:
    from scipy.spatial import ConvexHull, QhullError  # imported late: the import takes 0.2 s

    try:
        hull = ConvexHull(corners)
    except QhullError:  # a flat point cloud: the camera did not see its base
        return []
    points, found, seen = corners[hull.vertices], [], np.zeros((0, 3))
    order = np.argsort(-_simplex_areas(corners, hull.simplices), kind="stable")
    for down, offset in zip(hull.equations[order, :3], hull.equations[order, 3], strict=True):
        if len(seen) and (seen @ down).max() > np.cos(SAME):
            continue
        seen = np.vstack([seen, down])
        foot = points[points @ down + offset > -FLAT]
        ring = polygon(foot, -down)
        margin = margin_of(ring, -down, center_of_mass)
        if margin >= 0:
            found.append(StablePose(-down, ring, margin))
    return sorted(found, key=lambda r: -r.margin)


def _simplex_areas(points: Array, simplices: NDArray[np.int32]) -> Array:
    a, b, c = (points[simplices[:, k]] for k in range(3))
    return np.linalg.norm(np.cross(b - a, c - a), axis=1)


def plane_axes(up: Array) -> tuple[Array, Array]:
    """Return the unit x and y axes (3,) of a frame whose z axis is `up`, the upward direction of an object's
    resting pose.
    """
    x = np.asarray(np.cross(up, np.eye(3)[int(np.argmin(np.abs(up)))]), dtype=np.float64)
    x /= np.linalg.norm(x)
    return x, np.asarray(np.cross(up, x), dtype=np.float64)


def polygon(points: Array, up: Array) -> Array:
    """Return the convex support polygon (n, 3) of a resting pose around coplanar points, counterclockwise
    when seen from `up`.
    """
    from scipy.spatial import ConvexHull, QhullError

    x, y = plane_axes(up)
    flat = np.column_stack([points @ x, points @ y])
    try:
        return points[ConvexHull(flat).vertices]
    except (QhullError, ValueError):  # a line or a point: no area
        ends = [int(np.argmin(flat @ (1.0, 0.1))), int(np.argmax(flat @ (1.0, 0.1)))]
        return points[sorted(set(ends))]


def margin_of(corners: Array, up: Array, point: Array) -> float:
    """Return the stability margin of a resting pose: the distance [m] in the plane from a point to the
    nearest edge of the support polygon, negative outside.
    """
    if len(corners) < 3:
        return -np.inf
    edges = np.roll(corners, -1, axis=0) - corners
    inwards = np.cross(up, edges)
    inwards /= np.maximum(np.linalg.norm(inwards, axis=1, keepdims=True), 1e-12)
    return float(np.einsum("ij,ij->i", inwards, point - corners).min())
