"""Shapes of very many parts for the exact checker: coal is asked about the few parts that are near."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import coal
import numpy as np
from numpy.typing import NDArray

from armcell.core import Octree, PointCloud

if TYPE_CHECKING:
    from armcell.collision.shapes import Solid

Array = NDArray[np.float64]
Index = NDArray[np.intp]

CHUNK = 512
"""Parts whose common box is looked at first."""


@dataclass(frozen=True, eq=False)
class Many:
    """Balls (sizes are radii) or cubes (sizes are half edges), neighbours in chunks of `CHUNK`."""

    cubes: bool
    centres: Array  # (n, 3)
    sizes: Array  # (n,)
    low: Array  # (chunks, 3)
    high: Array

    @staticmethod
    def of(shape: PointCloud | Octree, scale: float = 1.0) -> Many:
        cubes = isinstance(shape, Octree)
        if isinstance(shape, Octree):
            centres, sizes = shape.centres, shape.sizes / 2
        else:
            centres, sizes = shape.points, np.full(len(shape.points), shape.radius)
        order = _halved(centres)
        centres, sizes = centres[order] * scale, sizes[order] * scale
        starts = np.arange(0, len(order), CHUNK)
        if len(order) == 0:
            return Many(cubes, centres, sizes, np.zeros((0, 3)), np.zeros((0, 3)))
        low = np.minimum.reduceat(centres - sizes[:, None], starts)
        high = np.maximum.reduceat(centres + sizes[:, None], starts)
        return Many(cubes, centres, sizes, low, high)

    def near(self, centre: Array, half: Array, R: Array, t: Array, within: float) -> tuple[Array, Index]:
        """Parts that may be within a distance [m] of a box, nearest first: lower bounds (k,), numbers (k,).

        The box has half extents `half` around `centre` in a frame at R, t in the parts' frame.
        """
        middle, reach = R @ centre + t, np.abs(R) @ half
        gap = np.maximum(np.maximum(self.low - middle - reach, middle - reach - self.high), 0.0)
        chunks = np.flatnonzero(np.linalg.norm(gap, axis=1) <= within)
        index = (chunks[:, None] * CHUNK + np.arange(CHUNK)).ravel()
        index = index[index < len(self.centres)]
        inside = np.abs((self.centres[index] - t) @ R - centre)  # in the box's frame
        radius = self.sizes[index] * (np.sqrt(3) if self.cubes else 1.0)
        bound = np.linalg.norm(np.maximum(inside - half, 0.0), axis=1) - radius
        order = np.argsort(bound, kind="stable")
        order = order[bound[order] <= within]
        return bound[order], index[order]

    def solids(self, index: Index, T: coal.Transform3s) -> Iterator[tuple]:
        """Parts by number as coal geometries with their transforms; the parts' frame is at T."""
        R, t, here = T.getRotation(), T.getTranslation(), coal.Transform3s()
        known: dict[float, coal.CollisionGeometry] = {}
        for k in index:
            size = float(self.sizes[k])
            if size not in known:
                known[size] = coal.Box(*[2 * size] * 3) if self.cubes else coal.Sphere(size)
            here.setTransform(R, R @ self.centres[k] + t)
            yield known[size], here


def _near(
    solid: Solid, T: coal.Transform3s, many: Many, T_many: coal.Transform3s, within: float
) -> tuple[Array, Index]:
    back = T_many.getRotation().T
    R, t = back @ T.getRotation(), back @ (T.getTranslation() - T_many.getTranslation())
    return many.near(solid.centre, solid.half, R, t, within)


def _holds(solid: Solid, T: coal.Transform3s, part: coal.Transform3s) -> bool:
    """Whether a part's middle is inside a mesh that is not convex."""
    return solid.holds(T.getRotation().T @ (part.getTranslation() - T.getTranslation()))


def touches_many(solid: Solid, T: coal.Transform3s, many: Many, T_many: coal.Transform3s,
                 request: coal.CollisionRequest, result: coal.CollisionResult) -> bool:  # fmt: skip
    """Whether a solid comes within the request's margin of any part."""
    _, index = _near(solid, T, many, T_many, request.security_margin)
    return any(
        coal.collide(solid.exact, T, part, there, request, result) or _holds(solid, T, there)
        for part, there in many.solids(index, T_many)
    )


def distance_to_many(solid: Solid, T: coal.Transform3s, many: Many, T_many: coal.Transform3s,
                     request: coal.DistanceRequest, result: coal.DistanceResult,
                     outer: bool = False) -> float:  # fmt: skip
    """Signed distance [m] of a solid (or its convex outer shape) to the nearest part, infinite without parts.

    `result` is left as coal has it for that part.
    """
    shape, best, nearest, within = solid.outer if outer else solid.exact, np.inf, np.zeros(0, np.intp), 0.1
    while best > within and within < 1e5:  # [m] looked at first, then ten times that
        bounds, index = _near(solid, T, many, T_many, within)
        for bound, k, (part, there) in zip(bounds, index, many.solids(index, T_many), strict=True):
            if bound >= best:
                break
            result.clear()
            distance = float(coal.distance(shape, T, part, there, request, result))
            if not outer and distance > 0 and _holds(solid, T, there):
                distance = -distance
            if distance < best:
                best, nearest = distance, np.array([k])
        within *= 10
    for part, there in many.solids(nearest, T_many):
        result.clear()
        coal.distance(shape, T, part, there, request, result)
    return best


def _halved(centres: Array) -> Index:
    """An order in which runs of `CHUNK` are close together: halves along the longest axis."""
    done, left = [], [np.arange(len(centres))]
    while left:
        index = left.pop()
        if len(index) <= CHUNK:
            done.append(index)
            continue
        axis = int(np.argmax(np.ptp(centres[index], axis=0)))
        half = CHUNK * max(round(len(index) / 2 / CHUNK), 1)
        order = np.argpartition(centres[index, axis], half)
        left += [index[order[half:]], index[order[:half]]]
    return np.concatenate([np.zeros(0, np.intp), *done])
