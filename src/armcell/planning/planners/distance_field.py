"""Signed distance field of the world on a grid, for CHOMP and STOMP; built once per scene.

Boxes, spheres, cylinders, capsules and planes are evaluated exactly at the grid points. All other shapes
are rasterized (closed surfaces are filled); a Euclidean distance transform then gives distances that are
exact to about one grid step.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from armcell.collision.kernel.cover import small_triangles, triangulated
from armcell.collision.kernel.lru_cache import LruCache
from armcell.core import Box, Capsule, Cylinder, Octree, Plane, PointCloud, Shape, Sphere
from armcell.core.geometry import local_bounds
from armcell.scene import CollisionObject

Array = NDArray[np.float64]
F32 = NDArray[np.float32]

STEP = 0.025  # [m] between grid points
FAR = 0.2  # [m] upper bound of stored distances
MOST_POINTS = 4_000_000


class DistanceField:
    """Signed distance field: a grid of distances [m] to objects, which are negative inside the objects.

    Attributes:
        low: the first grid point (3,) in the world [m]. step: distance between grid points [m].
        values: (nx, ny, nz) distances [m], at most FAR.
    """

    def __init__(self, objects: tuple[CollisionObject, ...], low: Array, high: Array):
        """Build a distance field that covers the box between the corners `low` and `high` (3,) [m].

        Args:
            objects: objects to measure distances from.
            low, high: (3,) corners of the box of queried points [m]; the grid is smaller if the objects cover
                only a part of the box.
        """
        boxes = [_bounds(o.T_world_object @ T, s) for o in objects for s, T in o.shapes]
        if boxes:
            low = np.maximum(low, np.min([b[0] for b in boxes], axis=0) - FAR)
            high = np.minimum(high, np.max([b[1] for b in boxes], axis=0) + FAR)
        if not boxes or np.any(low >= high):
            low, high = np.zeros(3), np.full(3, STEP)
        self.step = max(STEP, float((np.prod(high - low) / MOST_POINTS) ** (1 / 3)))
        count = np.ceil((high - low) / self.step).astype(int) + 1
        self.low, self.values = low, np.full(np.maximum(count, 2), FAR, np.float32)
        for item in objects:
            for shape, T in item.shapes:
                self._add(shape, (item.T_world_object @ T).matrix, *_bounds(item.T_world_object @ T, shape))

    def _add(self, shape: Shape, T: Array, low: Array, high: Array) -> None:
        first = np.maximum(np.floor((low - FAR - self.low) / self.step).astype(int), 0)
        end = np.minimum(np.ceil((high + FAR - self.low) / self.step).astype(int) + 1, self.values.shape)
        if np.any(first >= end):
            return
        part = self.values[first[0] : end[0], first[1] : end[1], first[2] : end[2]]
        if type(shape) in _EXACT:
            axes = [self.low[k] + self.step * np.arange(first[k], end[k]) for k in range(3)]
            points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1) - T[:3, 3]
            distance = _EXACT[type(shape)](shape, points @ T[:3, :3])
        else:
            distance = _drawn(shape, T, self.low + self.step * first, self.step, part.shape)
        np.minimum(part, distance.astype(np.float32), out=part)

    def distances(self, points: F32) -> F32:
        """Interpolate a distance field linearly at points (m, 3) [m]. Points outside the grid get the value
        at its border.
        """
        return self._look(points, False)[0]

    def gradients(self, points: F32) -> tuple[F32, F32]:
        """Interpolate a distance field at points; return the distances (m,) and their gradients (m, 3)."""
        return self._look(points, True)

    def _look(self, points: F32, gradient: bool) -> tuple[F32, F32]:
        shape = np.array(self.values.shape)
        at = (points - self.low.astype(np.float32)) / np.float32(self.step)
        outside = (at < 0) | (at > shape - 1)
        cell = np.clip(at.astype(np.int32), 0, shape - 2)
        u, v, w = np.clip(at - cell, 0.0, 1.0).T
        flat = self.values.ravel()
        ny, nz = shape[1] * shape[2], shape[2]
        i = cell[:, 0] * ny + cell[:, 1] * nz + cell[:, 2]
        c = [flat[i + a * ny + b * nz + d] for a in (0, 1) for b in (0, 1) for d in (0, 1)]
        z00, z01, z10, z11 = (c[2 * k] + w * (c[2 * k + 1] - c[2 * k]) for k in range(4))
        y0, y1 = z00 + v * (z01 - z00), z10 + v * (z11 - z10)
        value = y0 + u * (y1 - y0)
        if not gradient:
            return value, np.empty((0, 3), np.float32)
        s0, s1 = (c[1] - c[0], c[3] - c[2]), (c[5] - c[4], c[7] - c[6])
        slope = [s[0] + v * (s[1] - s[0]) for s in (s0, s1)]
        g = np.stack(
            [y1 - y0, (z01 - z00) + u * ((z11 - z10) - (z01 - z00)), slope[0] + u * (slope[1] - slope[0])],
            axis=1,
        )
        g[outside] = 0.0
        return value, np.asarray(g / self.step, np.float32)


_fields: LruCache[DistanceField] = LruCache(8)


def distance_field(objects: tuple[CollisionObject, ...], low: Array, high: Array) -> DistanceField:
    """Return the signed distance field of objects. The fields of the last few worlds are cached."""
    key = (objects, low.tobytes(), high.tobytes())
    return _fields.get(key, lambda: DistanceField(objects, low, high))


def _bounds(T_world_shape, shape: Shape) -> tuple[Array, Array]:
    center, half = local_bounds(shape)
    T = T_world_shape.matrix
    middle, reach = T[:3, :3] @ center + T[:3, 3], np.abs(T[:3, :3]) @ half
    return middle - reach, middle + reach


def _outside(over: Array) -> Array:
    """Compute the signed distance [m] of points to a box or cylinder in a distance field, from the points'
    signed distances (..., k) to the solid's faces.
    """
    return np.linalg.norm(np.maximum(over, 0.0), axis=-1) + np.minimum(over.max(axis=-1), 0.0)


def _cylinder(shape: Cylinder, p: Array) -> Array:
    across = np.hypot(p[..., 0], p[..., 1]) - shape.radius
    return _outside(np.stack([across, np.abs(p[..., 2]) - shape.length / 2], axis=-1))


def _capsule(shape: Capsule, p: Array) -> Array:
    beyond = np.maximum(np.abs(p[..., 2]) - shape.length / 2, 0.0)
    return np.sqrt(p[..., 0] ** 2 + p[..., 1] ** 2 + beyond**2) - shape.radius


_EXACT: dict[type, Callable[..., Array]] = {
    Box: lambda s, p: _outside(np.abs(p) - s.half_extents),
    Sphere: lambda s, p: np.linalg.norm(p, axis=-1) - s.radius,
    Cylinder: _cylinder,
    Capsule: _capsule,
    Plane: lambda s, p: p[..., 2],
}


def _drawn(shape: Shape, T: Array, low: Array, step: float, counts: tuple[int, ...]) -> Array:
    """Rasterize the surface of a shape into part of a distance field's grid,
    and compute the distances to this surface.
    """
    from scipy.ndimage import binary_fill_holes, distance_transform_edt

    points, room = _surface(shape, step)
    at = np.round((points @ T[:3, :3].T + T[:3, 3] - low) / step).astype(int)
    at = at[np.all((at >= 0) & (at < counts), axis=1)]
    solid = np.zeros(counts, bool)
    solid[tuple(at.T)] = True
    if not solid.any():
        return np.full(counts, FAR)
    solid = np.asarray(binary_fill_holes(solid))
    outside = np.asarray(distance_transform_edt(~solid))
    inside = np.asarray(distance_transform_edt(solid))
    # A cell on the surface is half a step deep.
    return step * (outside - inside + 0.5 * solid) - room


def _surface(shape: Shape, step: float) -> tuple[Array, float]:
    """Sample the surface of a shape so densely that every cell of the distance field on the surface contains
    a sample.

    Return points (k, 3) and a radius [m].
    """
    match shape:
        case PointCloud():
            return np.asarray(shape.points, float), float(shape.radius)
        case Octree():
            parts = []
            for size in np.unique(shape.sizes):
                n = int(np.ceil(size / step)) + 1
                offsets = (np.arange(n) / (n - 1) - 0.5) * size
                cube = np.stack(np.meshgrid(offsets, offsets, offsets), axis=-1).reshape(-1, 3)
                parts.append((shape.centers[shape.sizes == size][:, None] + cube).reshape(-1, 3))
            return (np.vstack(parts) if parts else np.zeros((0, 3))), 0.0
    vertices, faces, gap = triangulated(shape)
    return small_triangles(vertices, faces, 0.5 * step).reshape(-1, 3), gap
