"""Obstacle shapes with many parts, from cameras and maps: point clouds and occupied cells.

They belong to the world and cannot be attached. They may be empty.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.core.checks import checked, float_array
from armcell.core.errors import InputError

Array = NDArray[np.float64]


def finite_points(points: ArrayLike) -> tuple[Array, int]:
    """Return the finite points of a point cloud (n, 3), and the number of points that were dropped because
    they are not finite.

    Depth cameras mark pixels without depth by NaN.
    """
    every = float_array(points, (-1, 3), "points", finite=False).reshape(-1, 3)
    kept = np.all(np.isfinite(every), axis=1)
    return every[kept], int(len(every) - kept.sum())


@dataclass(frozen=True, eq=False)
@checked()
class PointCloud:
    """Shape of a point cloud: balls of equal radius [m] around points (n, 3) [m], given in the shape's frame.

    Raises:
        InputError: a point is not finite (see `finite_points`), or the radius is not positive.
    """

    points: Array
    radius: float

    def __post_init__(self) -> None:
        if not np.isfinite(self.radius) or self.radius <= 0:
            raise InputError(
                f"point cloud has radius {self.radius:g}, it must be a positive number of meters"
            )
        object.__setattr__(self, "points", _rows("point cloud", "points", self.points))

    @property
    def half_extents(self) -> Array:
        return np.abs(self.points).max(axis=0, initial=0.0) + (self.radius if len(self.points) else 0.0)

    @cached_property
    def bounds(self) -> tuple[Array, Array]:
        """Return the lowest and the highest corner, each (3,) [m], of the box that encloses a point cloud.

        Both corners are zero if the cloud is empty.
        """
        return _bounds(self.points, self.radius)


@dataclass(frozen=True, eq=False)
class Octree:
    """Octree shape, for example from a 3D map: a set of occupied cubes that are aligned with the axes of the
    octree's frame.

    centers (n, 3) [m], sizes (n,) full edge lengths [m]. Cubes may overlap and need no common grid.
    """

    centers: Array
    sizes: Array

    def __post_init__(self) -> None:
        centers = _rows("octree", "centers", self.centers)
        sizes = np.ascontiguousarray(float_array(self.sizes, None, "sizes", finite=False))
        if sizes.shape != (len(centers),):
            raise InputError(f"octree has {len(centers)} centers but sizes of shape {sizes.shape}")
        bad = int(np.sum(~np.isfinite(sizes) | (sizes <= 0)))
        if bad:
            raise InputError(f"octree has {bad} cells whose size is not a positive number of meters")
        sizes.setflags(write=False)
        object.__setattr__(self, "centers", centers)
        object.__setattr__(self, "sizes", sizes)

    @staticmethod
    def from_grid(occupied: ArrayLike, size: float, origin: ArrayLike = (0.0, 0.0, 0.0)) -> Octree:
        """Create an octree shape from a boolean occupancy grid (i, j, k). Eight occupied neighbors are merged
        into a larger cube.

        Args:
            origin: the lowest corner of cell (0, 0, 0) [m].
        """
        left = float_array(occupied, None, "occupied", finite=False).astype(bool)
        if left.ndim != 3:
            raise InputError(f"an occupancy grid has three dimensions, this one {left.ndim}")
        centers, sizes, edge = [], [], float(size)
        while left.any():
            left = np.pad(left, [(0, n % 2) for n in left.shape])
            i, j, k = (n // 2 for n in left.shape)
            full = left.reshape(i, 2, j, 2, k, 2).all(axis=(1, 3, 5))
            single = left & ~full.repeat(2, 0).repeat(2, 1).repeat(2, 2)
            cells = np.argwhere(single)
            centers.append((cells + 0.5) * edge + float_array(origin, (3,), "origin"))
            sizes.append(np.full(len(cells), edge))
            left, edge = full, edge * 2
        return Octree(np.vstack([np.zeros((0, 3)), *centers]), np.concatenate([np.zeros(0), *sizes]))

    @property
    def half_extents(self) -> Array:
        low, high = self.bounds
        return np.maximum(np.abs(low), np.abs(high))

    @cached_property
    def bounds(self) -> tuple[Array, Array]:
        """Return the lowest and the highest corner, each (3,) [m], of the box that encloses an octree.

        Both corners are zero if the octree is empty.
        """
        return _bounds(self.centers, self.sizes[:, None] / 2)


def _rows(what: str, name: str, values: ArrayLike) -> Array:
    rows = np.ascontiguousarray(float_array(values, None, name, finite=False))
    if rows.size == 0:
        rows = rows.reshape(0, 3)
    if rows.ndim != 2 or rows.shape[1] != 3:
        raise InputError(f"{what} needs {name} of shape (n, 3), not {rows.shape}")
    bad = int(len(rows) - np.isfinite(rows).all(axis=1).sum())
    if bad:
        raise InputError(
            f"{what}: {bad} of {len(rows)} {name} have a NaN or infinity in them",
            hint="leave them out with finite_points()",
        )
    rows.setflags(write=False)
    return rows


def _bounds(rows: Array, half: Array | float) -> tuple[Array, Array]:
    if len(rows) == 0:
        return np.zeros(3), np.zeros(3)
    columns = np.ascontiguousarray(rows.T)  # NumPy reduces long rows several times faster
    if isinstance(half, np.ndarray):
        half = half.T
    return (columns - half).min(axis=1), (columns + half).max(axis=1)
