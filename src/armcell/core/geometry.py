"""Shapes of links and objects. Each shape is centered on its own frame.

Cylinder, capsule and cone have their axis along local z. Sizes are full lengths in meters.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from armcell.core.checks import checked, float_array
from armcell.core.clouds import Octree, PointCloud
from armcell.core.errors import InputError

Array = NDArray[np.float64]

PLANE_EXTENT_M = 100.0
"""Extent of a plane in images and bounding boxes [m]; contacts use the infinite half space."""

LARGEST_M = 1e6
"""Largest size of a shape [m]. Volumes and inertias of much larger shapes overflow."""


def _positive(what: str, **sizes: float) -> None:
    for name, value in sizes.items():
        if not 0 < value <= LARGEST_M:
            raise InputError(
                f"{what} has {name} {value:g}, it must be a positive number of meters up to {LARGEST_M:g}"
            )


@dataclass(frozen=True)
@checked()
class Box:
    """Box shape, centered on its own frame, with full edge lengths x, y and z [m]."""

    x: float
    y: float
    z: float

    def __post_init__(self) -> None:
        _positive("box", x=self.x, y=self.y, z=self.z)

    @property
    def half_extents(self) -> Array:
        return np.array([self.x, self.y, self.z]) / 2


@dataclass(frozen=True)
@checked()
class Sphere:
    radius: float

    def __post_init__(self) -> None:
        _positive("sphere", radius=self.radius)

    @property
    def half_extents(self) -> Array:
        return np.full(3, self.radius)


@dataclass(frozen=True)
@checked()
class Cylinder:
    radius: float
    length: float

    def __post_init__(self) -> None:
        _positive("cylinder", radius=self.radius, length=self.length)

    @property
    def half_extents(self) -> Array:
        return np.array([self.radius, self.radius, self.length / 2])


@dataclass(frozen=True)
@checked()
class Capsule:
    """Capsule shape: a cylindrical part of the given length and radius [m], with a half ball at each end.

    The total length is `length + 2 radius`.
    """

    radius: float
    length: float

    def __post_init__(self) -> None:
        _positive("capsule", radius=self.radius, length=self.length)

    @property
    def half_extents(self) -> Array:
        return np.array([self.radius, self.radius, self.length / 2 + self.radius])


@dataclass(frozen=True)
@checked()
class Cone:
    """Cone shape whose base is at -length/2 and whose apex is at +length/2 on the z axis [m]."""

    radius: float
    length: float

    def __post_init__(self) -> None:
        _positive("cone", radius=self.radius, length=self.length)

    @property
    def half_extents(self) -> Array:
        return np.array([self.radius, self.radius, self.length / 2])


@dataclass(frozen=True)
class Plane:
    """Plane shape, an obstacle that fills a half space: all points with z <= 0 in its own frame are solid."""

    @property
    def half_extents(self) -> Array:
        return np.array([PLANE_EXTENT_M, PLANE_EXTENT_M, PLANE_EXTENT_M])


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangle mesh shape with vertices (v, 3) [m] and faces (f, 3)."""

    vertices: Array  # (v, 3) [m]
    faces: NDArray[np.int32]  # (f, 3)
    file: Path | None = None

    def __post_init__(self) -> None:
        vertices = np.ascontiguousarray(float_array(self.vertices, None, "a mesh's vertices", finite=False))
        faces = np.ascontiguousarray(float_array(self.faces, None, "a mesh's faces"), dtype=np.int32)
        if vertices.ndim != 2 or vertices.shape[1] != 3 or faces.ndim != 2 or faces.shape[1] != 3:
            raise InputError("a mesh needs vertices (v, 3) and faces (f, 3)", file=self.file)
        if len(faces) == 0 or not np.all(np.isfinite(vertices)):
            raise InputError("mesh is empty or has a vertex that is not finite", file=self.file)
        if faces.min() < 0 or faces.max() >= len(vertices):
            raise InputError("mesh has a face that points at a vertex it does not have", file=self.file)
        vertices.setflags(write=False)
        faces.setflags(write=False)
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "faces", faces)

    @property
    def half_extents(self) -> Array:
        return np.maximum(np.abs(self.vertices.min(0)), np.abs(self.vertices.max(0)))


Shape = Box | Sphere | Cylinder | Capsule | Cone | Plane | Mesh | PointCloud | Octree


def extent(shape: Shape, direction: Array) -> tuple[float, float]:
    """Return the lowest and the highest coordinate [m] that a shape reaches along a direction, given as a
    unit vector (3,).

    The direction is in the shape's frame.
    """
    x, y, z = (float(v) for v in direction)
    across = float(np.hypot(x, y))
    match shape:
        case Mesh():
            along = shape.vertices @ np.asarray(direction)
            return float(along.min()), float(along.max())
        case PointCloud():
            along = shape.points @ np.asarray(direction)
            return float(along.min(initial=0.0)) - shape.radius, float(along.max(initial=0.0)) + shape.radius
        case Octree():
            along = shape.centers @ np.asarray(direction)
            reach = float(np.abs(direction).sum()) * shape.sizes / 2
            return float((along - reach).min(initial=0.0)), float((along + reach).max(initial=0.0))
        case Box():
            half = float(np.abs(direction) @ shape.half_extents)
        case Sphere():
            half = shape.radius
        case Cylinder():
            half = shape.radius * across + shape.length / 2 * abs(z)
        case Capsule():
            half = shape.radius + shape.length / 2 * abs(z)
        case Cone():
            rim, apex = shape.radius * across, shape.length / 2 * z
            return min(apex, -apex - rim), max(apex, -apex + rim)
        case Plane():
            half = PLANE_EXTENT_M
    return -half, half


def local_bounds(shape: Shape) -> tuple[Array, Array]:
    """Return the center and the half extents, each (3,) [m], of a shape's bounding box in the frame of the
    shape.

    The box is aligned with the axes of the shape's frame.
    """
    if isinstance(shape, Mesh):
        low, high = shape.vertices.min(0), shape.vertices.max(0)
        return (low + high) / 2, (high - low) / 2
    if isinstance(shape, PointCloud | Octree):
        low, high = shape.bounds
        return (low + high) / 2, (high - low) / 2
    if isinstance(shape, Plane):  # everything below z = 0
        return np.array([0.0, 0.0, -PLANE_EXTENT_M]), shape.half_extents
    return np.zeros(3), shape.half_extents
