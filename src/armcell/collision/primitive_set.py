"""Point clouds and octrees in the exact checker, with a broad phase that selects parts.

A part is one sphere of a point cloud or one cube of an octree.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import coal
import numpy as np
from numpy.typing import NDArray

from armcell.core import Octree, PointCloud

if TYPE_CHECKING:
    from armcell.collision.coal_shapes import CoalGeometry

Array = NDArray[np.float64]
Index = NDArray[np.intp]

CHUNK = 512
"""Number of neighboring parts that share a bounding box for the broad phase."""


@dataclass(frozen=True, eq=False)
class PrimitiveSet:
    """Spheres or cubes that represent a point cloud or octree in the exact checker.
    Sizes are radii or half edge lengths.

    They are stored in chunks of `CHUNK` neighbors.
    """

    cubes: bool
    centers: Array  # (n, 3)
    sizes: Array  # (n,)
    low: Array  # (chunks, 3)
    high: Array

    @staticmethod
    def of(shape: PointCloud | Octree, scale: float = 1.0) -> PrimitiveSet:
        cubes = isinstance(shape, Octree)
        if isinstance(shape, Octree):
            centers, sizes = shape.centers, shape.sizes / 2
        else:
            centers, sizes = shape.points, np.full(len(shape.points), shape.radius)
        order = _halved(centers)
        centers, sizes = centers[order] * scale, sizes[order] * scale
        starts = np.arange(0, len(order), CHUNK)
        if len(order) == 0:
            return PrimitiveSet(cubes, centers, sizes, np.zeros((0, 3)), np.zeros((0, 3)))
        low = np.minimum.reduceat(centers - sizes[:, None], starts)
        high = np.maximum.reduceat(centers + sizes[:, None], starts)
        return PrimitiveSet(cubes, centers, sizes, low, high)

    def near(self, center: Array, half: Array, R: Array, t: Array, within: float) -> tuple[Array, Index]:
        """Return the spheres or cubes of a point cloud or octree that
        may touch an oriented box, nearest first.

        Args:
            center: (3,) center of the box, box frame.
            half: (3,) half extents of the box.
            R: (3, 3) rotation of the box frame in the parts' frame.
            t: (3,) translation of the box frame in the parts' frame.
            within: largest distance [m].
        Returns:
            Lower bounds of the distances (k,) [m], and part indices (k,).
        """
        middle, reach = R @ center + t, np.abs(R) @ half
        gap = np.maximum(np.maximum(self.low - middle - reach, middle - reach - self.high), 0.0)
        chunks = np.flatnonzero(np.linalg.norm(gap, axis=1) <= within)
        index = (chunks[:, None] * CHUNK + np.arange(CHUNK)).ravel()
        index = index[index < len(self.centers)]
        inside = np.abs((self.centers[index] - t) @ R - center)  # in the box's frame
        radius = self.sizes[index] * (np.sqrt(3) if self.cubes else 1.0)
        bound = np.linalg.norm(np.maximum(inside - half, 0.0), axis=1) - radius
        order = np.argsort(bound, kind="stable")
        order = order[bound[order] <= within]
        return bound[order], index[order]

    def solids(self, index: Index, T: coal.Transform3s) -> Iterator[tuple]:
        """Yield the primitives (spheres or cubes) of a set as coal geometries with their transforms. `T` is
        the transform of the set's frame.
        """
        R, t, here = T.getRotation(), T.getTranslation(), coal.Transform3s()
        known: dict[float, coal.CollisionGeometry] = {}
        for k in index:
            size = float(self.sizes[k])
            if size not in known:
                known[size] = coal.Box(*[2 * size] * 3) if self.cubes else coal.Sphere(size)
            here.setTransform(R, R @ self.centers[k] + t)
            yield known[size], here


def _near(
    solid: CoalGeometry,
    T: coal.Transform3s,
    primitives: PrimitiveSet,
    T_primitives: coal.Transform3s,
    within: float,
) -> tuple[Array, Index]:
    back = T_primitives.getRotation().T
    R, t = back @ T.getRotation(), back @ (T.getTranslation() - T_primitives.getTranslation())
    return primitives.near(solid.center, solid.half, R, t, within)


def _holds(solid: CoalGeometry, T: coal.Transform3s, part: coal.Transform3s) -> bool:
    """Return whether the nonconvex mesh of a solid contains the center of a primitive (sphere or cube) of a
    set.
    """
    return solid.holds(T.getRotation().T @ (part.getTranslation() - T.getTranslation()))


def touches_primitives(solid: CoalGeometry, T: coal.Transform3s,
                       primitives: PrimitiveSet, T_primitives: coal.Transform3s,
                 request: coal.CollisionRequest, result: coal.CollisionResult) -> bool:  # fmt: skip
    """Return whether any primitive (sphere or cube) of a set is closer to a solid than the security margin of
    the request.
    """
    _, index = _near(solid, T, primitives, T_primitives, request.security_margin)
    return any(
        coal.collide(solid.exact, T, part, there, request, result) or _holds(solid, T, there)
        for part, there in primitives.solids(index, T_primitives)
    )


def distance_to_primitives(solid: CoalGeometry, T: coal.Transform3s,
                           primitives: PrimitiveSet, T_primitives: coal.Transform3s,
                     request: coal.DistanceRequest, result: coal.DistanceResult,
                     outer: bool = False) -> float:  # fmt: skip
    """Return the signed distance [m] from a solid to the nearest primitive (sphere or cube) of a point cloud
    or octree.

    The distance is infinite if the set is empty. `result` holds coal's result for the nearest part.

    Args:
        outer: measure from the solid's convex outer shape instead of its exact shape.
    """
    shape, best, nearest, within = solid.outer if outer else solid.exact, np.inf, np.zeros(0, np.intp), 0.1
    while best > within and within < 1e5:  # [m] search radius, multiplied by 10 until it contains a part
        bounds, index = _near(solid, T, primitives, T_primitives, within)
        for bound, k, (part, there) in zip(
            bounds, index, primitives.solids(index, T_primitives), strict=True
        ):
            if bound >= best:
                break
            result.clear()
            distance = float(coal.distance(shape, T, part, there, request, result))
            if not outer and distance > 0 and _holds(solid, T, there):
                distance = -distance
            if distance < best:
                best, nearest = distance, np.array([k])
        within *= 10
    for part, there in primitives.solids(nearest, T_primitives):
        result.clear()
        coal.distance(shape, T, part, there, request, result)
    return best


def _halved(centers: Array) -> Index:
    """Order the primitives (spheres or cubes) of a point cloud or octree such that each run of `CHUNK`
    primitives is close together in space.

    The algorithm splits the points in halves along the longest axis.
    """
    done, left = [], [np.arange(len(centers))]
    while left:
        index = left.pop()
        if len(index) <= CHUNK:
            done.append(index)
            continue
        axis = int(np.argmax(np.ptp(centers[index], axis=0)))
        half = CHUNK * max(round(len(index) / 2 / CHUNK), 1)
        order = np.argpartition(centers[index, axis], half)
        left += [index[order[half:]], index[order[:half]]]
    return np.concatenate([np.zeros(0, np.intp), *done])
