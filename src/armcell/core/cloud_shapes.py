"""Shapes with very many parts: point clouds, which can be updated in part, and octrees.

They belong to the world and cannot be attached; they may be empty.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, reduce
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.core.checks import checked, float_array
from armcell.core.errors import InputError
from armcell.core.transforms import SE3

F64 = NDArray[np.float64]
Mask = NDArray[np.bool_]
LARGEST_UPDATE = 0.5
"""Largest number of removed and added points of a cloud, as a fraction of the points of the base, up to which
the new cloud keeps its base."""
SLACK = 0.1
"""Largest distance of an added point from the base's bounding box, as a fraction of the box, up to which the
new cloud keeps its base."""


def finite_points(points: ArrayLike) -> tuple[F64, int]:
    """Return the finite points among points (n, 3), from which the geometry of a point cloud can be created,
    and the number of dropped points.

    Depth cameras mark pixels without depth by NaN.
    """
    every = float_array(points, (-1, 3), "points", finite=False).reshape(-1, 3)
    kept = np.all(np.isfinite(every), axis=1)
    return every[kept], int(len(every) - kept.sum())


class CloudUpdate(NamedTuple):
    """Difference between a point cloud and an earlier one, from which the point cloud was made by updates.

    The point cloud consists of those points of `base` that `kept` (n,) selects, followed by new points.
    """

    base: PointCloud
    kept: Mask


@dataclass(frozen=True, eq=False)
@checked()
class PointCloud:
    """Geometric shape of a point cloud: balls of equal radius [m] around points (n, 3) [m], given in the
    shape's frame.

    Raises:
        InputError: a point is not finite (see `finite_points`), or the radius is not positive.
    """

    points: F64
    radius: float

    def __post_init__(self) -> None:
        if not np.isfinite(self.radius) or self.radius <= 0:
            raise InputError(
                f"point cloud has radius {self.radius:g}, it must be a positive number of meters"
            )
        points = _rows("point cloud", "points", self.points)
        points.setflags(write=False)
        object.__setattr__(self, "points", points)

    def __getstate__(self) -> dict[str, Any]:
        """Return the attributes for copies and pickles, which do not contain the earlier point cloud."""
        return {name: value for name, value in self.__dict__.items() if name != "_update"}

    @property
    def update(self) -> CloudUpdate | None:
        """Return the difference to the earlier point cloud from which `updated` made this one, if any."""
        return self.__dict__.get("_update")

    def inside(self, low: ArrayLike, high: ArrayLike, T_box_shape: SE3 = SE3.identity()) -> Mask:
        """Return a mask (n,) of the points of a cloud in the box low <= p < high, as of adjacent tiles.

        Args:
            low, high: (3,) corners of the box [m] in its own frame; infinite ones are allowed.
            T_box_shape: pose of the point cloud in the frame of the box.
        Raises:
            InputError: `low` is above `high`, or a corner is not three numbers.
        """
        corners = [float_array(corner, (3,), "a corner of a box", finite=False) for corner in (low, high)]
        if not np.all(corners[0] <= corners[1]):
            raise InputError(f"a box from {corners[0]} to {corners[1]} has no size", hint="low, then high")
        least, end = (corner - T_box_shape.translation for corner in corners)
        mask = np.ones(len(self.points), bool)
        for k, row in enumerate(T_box_shape.rotation.matrix):  # one axis at a time needs little memory
            along = reduce(np.add, (self.points[:, j] * row[j] for j in np.flatnonzero(row)))
            mask &= along >= least[k]
            mask &= along < end[k]
        return mask

    def updated(self, points: ArrayLike = (), clear: Mask | None = None) -> PointCloud:
        """Return the point cloud after a change: without the points that the mask `clear` (n,) selects, and
        with the additional `points` (m, 3) [m] at its end.

        The collision checker converts only the changed part of the new cloud, if less than `LARGEST_UPDATE`
        of the points have changed since the cloud was last converted completely.

        Raises:
            InputError: `clear` is not a mask of the cloud's points, or an additional point is not finite.
        """
        more = _rows("point cloud", "additional points", points)
        count = len(self.points)
        mask = np.zeros(count, bool) if clear is None else clear
        if not isinstance(mask, np.ndarray) or mask.dtype != bool or mask.shape != (count,):
            raise InputError(
                f"clear must be a boolean array of shape ({count},), not {clear!r:.60}",
                hint="use inside() or robot_mask()",
            )
        kept = ~mask
        left = np.flatnonzero(kept)
        every = np.empty((len(left) + len(more), 3))
        self.points.take(left, axis=0, out=every[: len(left)], mode="clip")  # the default would need a copy
        every[len(left) :] = more
        cloud = PointCloud(every, self.radius)
        base, before = self.update or (self, None)
        if before is not None:
            index = np.flatnonzero(before)
            before = before.copy()
            before[index[~kept[: len(index)]]] = False
            kept = before
        stays, (low, high) = np.count_nonzero(kept), base.bounds
        changed, added = len(kept) + len(cloud.points) - 2 * stays, cloud.points[stays:]
        far = (added < low - SLACK * (high - low)) | (added > high + SLACK * (high - low))
        if changed <= LARGEST_UPDATE * len(kept) and not far.any():
            object.__setattr__(cloud, "_update", CloudUpdate(base, kept))
        return cloud

    @property
    def half_extents(self) -> F64:
        return np.abs(self.points).max(axis=0, initial=0.0) + (self.radius if len(self.points) else 0.0)

    @cached_property
    def bounds(self) -> tuple[F64, F64]:
        """Return the lowest and the highest corner, each (3,) [m], of the box that encloses a point cloud as
        a geometric shape.

        Both corners are zero if the cloud is empty.
        """
        return _bounds(self.points, self.radius)


@dataclass(frozen=True, eq=False)
class Octree:
    """Geometric shape of an octree, for example from a 3D map: a set of occupied cubes that are aligned with
    the axes of the octree's frame.

    centers (n, 3) [m], sizes (n,) full edge lengths [m]. Cubes may overlap and need no common grid.
    """

    centers: F64
    sizes: F64

    def __post_init__(self) -> None:
        centers = _rows("octree", "centers", self.centers)
        sizes = np.ascontiguousarray(float_array(self.sizes, None, "sizes", finite=False))
        if sizes.shape != (len(centers),):
            raise InputError(f"octree has {len(centers)} centers but sizes of shape {sizes.shape}")
        bad = int(np.sum(~np.isfinite(sizes) | (sizes <= 0)))
        if bad:
            raise InputError(f"octree has {bad} cells whose size is not a positive number of meters")
        centers.setflags(write=False)
        sizes.setflags(write=False)
        object.__setattr__(self, "centers", centers)
        object.__setattr__(self, "sizes", sizes)

    @staticmethod
    def from_grid(occupied: ArrayLike, size: float, origin: ArrayLike = (0.0, 0.0, 0.0)) -> Octree:
        """Create the geometric shape of an octree from a boolean occupancy grid (i, j, k). Eight occupied
        neighbors are merged into a larger cube.

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
    def half_extents(self) -> F64:
        low, high = self.bounds
        return np.maximum(np.abs(low), np.abs(high))

    @cached_property
    def bounds(self) -> tuple[F64, F64]:
        """Return the lowest and the highest corner, each (3,) [m], of the box that encloses an octree as a
        geometric shape.

        Both corners are zero if the octree is empty.
        """
        return _bounds(self.centers, self.sizes[:, None] / 2)


def _rows(what: str, name: str, values: ArrayLike) -> F64:
    rows = np.ascontiguousarray(float_array(values, None, name, finite=False))
    if rows.size == 0:
        rows = rows.reshape(0, 3)
    if rows.ndim != 2 or rows.shape[1] != 3:
        raise InputError(f"{what} needs {name} of shape (n, 3), not {rows.shape}")
    if not np.isfinite(rows).all():
        bad = int(len(rows) - np.isfinite(rows).all(axis=1).sum())
        raise InputError(
            f"{what}: {bad} of {len(rows)} {name} have a NaN or infinity in them",
            hint="leave them out with finite_points()",
        )
    return rows


def _bounds(rows: F64, half: F64 | float) -> tuple[F64, F64]:
    if len(rows) == 0:
        return np.zeros(3), np.zeros(3)
    columns = np.ascontiguousarray(rows.T)  # NumPy reduces long rows several times faster
    if isinstance(half, np.ndarray):
        return (columns - half.T).min(axis=1), (columns + half.T).max(axis=1)
    return columns.min(axis=1) - half, columns.max(axis=1) + half
