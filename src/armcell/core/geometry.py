"""Shapes of links and objects: solids, planes, meshes and whether they are closed.

Each shape is centered on its own frame. Cylinder, capsule and cone have their axis along local z. Sizes
are full lengths in meters. A mesh is closed if each of its directed edges has a counterpart in the opposite
direction. This also holds for bodies that touch along an edge, where four triangles meet. Point clouds and
octrees are in `cloud_shapes`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from armcell.core.checks import checked, float_array
from armcell.core.cloud_shapes import Octree, PointCloud
from armcell.core.errors import InputError

F64 = NDArray[np.float64]
PLANE_EXTENT_M = 100.0
"""Extent of a plane in images and bounding boxes [m]; contacts use the infinite half space."""
LARGEST_M = 1e6
"""Largest size of a shape [m]. Volumes and inertias of much larger shapes overflow."""
Ints = NDArray[np.int64]
SAME = 1e-8  # [m] grid on which vertices count as one
LARGEST_HOLES = 0.05  # of the mesh's area: larger holes are openings of a surface, not defects


def _positive(what: str, **sizes: float) -> None:
    for name, value in sizes.items():
        if not 0 < value <= LARGEST_M:
            raise InputError(
                f"{what} has {name} {value:g}, it must be a positive number of meters up to {LARGEST_M:g}"
            )


@dataclass(frozen=True)
@checked()
class Box:
    """Geometric shape of a box, centered on its own frame, with full edge lengths x, y and z [m]."""

    x: float
    y: float
    z: float

    def __post_init__(self) -> None:
        _positive("box", x=self.x, y=self.y, z=self.z)

    @property
    def half_extents(self) -> F64:
        return np.array([self.x, self.y, self.z]) / 2


@dataclass(frozen=True)
@checked()
class Sphere:
    radius: float

    def __post_init__(self) -> None:
        _positive("sphere", radius=self.radius)

    @property
    def half_extents(self) -> F64:
        return np.full(3, self.radius)


@dataclass(frozen=True)
@checked()
class Cylinder:
    radius: float
    length: float

    def __post_init__(self) -> None:
        _positive("cylinder", radius=self.radius, length=self.length)

    @property
    def half_extents(self) -> F64:
        return np.array([self.radius, self.radius, self.length / 2])


@dataclass(frozen=True)
@checked()
class Capsule:
    """Geometric shape of a capsule: a cylindrical part of the given length and radius [m], with a half ball
    at each end.

    The total length is `length + 2 radius`.
    """

    radius: float
    length: float

    def __post_init__(self) -> None:
        _positive("capsule", radius=self.radius, length=self.length)

    @property
    def half_extents(self) -> F64:
        return np.array([self.radius, self.radius, self.length / 2 + self.radius])


@dataclass(frozen=True)
@checked()
class Cone:
    """Geometric shape of a cone, whose base is at -length/2 and whose apex is at +length/2 on the z axis
    [m].
    """

    radius: float
    length: float

    def __post_init__(self) -> None:
        _positive("cone", radius=self.radius, length=self.length)

    @property
    def half_extents(self) -> F64:
        return np.array([self.radius, self.radius, self.length / 2])


@dataclass(frozen=True)
class Plane:
    """Geometric shape of a plane, which fills a half space: all points with z <= 0 in its own frame are
    solid.
    """

    @property
    def half_extents(self) -> F64:
        return np.array([PLANE_EXTENT_M, PLANE_EXTENT_M, PLANE_EXTENT_M])


@dataclass(frozen=True, eq=False)
class Mesh:
    """Geometric shape of a triangle mesh with vertices (v, 3) [m] and faces (f, 3)."""

    vertices: F64  # (v, 3) [m]
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
    def half_extents(self) -> F64:
        return np.maximum(np.abs(self.vertices.min(0)), np.abs(self.vertices.max(0)))


Shape = Box | Sphere | Cylinder | Capsule | Cone | Plane | Mesh | PointCloud | Octree


def extent(shape: Shape, direction: F64) -> tuple[float, float]:
    """Return the lowest and the highest coordinate [m] that a geometric shape reaches along a direction,
    given as a unit vector (3,).

    The direction is in the shape's frame.

    Raises:
        InputError: `shape` is not a shape.
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
        case _:
            raise InputError(f"{shape!r} is not a shape")
    return -half, half


def local_bounds(shape: Shape) -> tuple[F64, F64]:
    """Return the center and the half extents, each (3,) [m], of a geometric shape's bounding box in the frame
    of the shape.

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


@lru_cache(maxsize=256)
def open_edges(mesh: Mesh) -> Ints:
    """Return the directed edges (e, 2) at which the geometry of a mesh is open, as vertex indices. At these
    edges, no adjacent triangle has the opposite edge.

    Vertices at the same point count as one. A mesh in which every edge has two triangles is closed, even if
    the triangles are not oriented consistently.
    """
    first, same = np.unique((mesh.vertices / SAME).round(), axis=0, return_index=True, return_inverse=True)[
        1:
    ]
    a, b, c = first[same.ravel()[mesh.faces]].T.astype(np.int64)
    starts, ends = np.concatenate([a, b, c]), np.concatenate([b, c, a])
    real, count = starts != ends, len(mesh.vertices)
    starts, ends = starts[real], ends[real]
    edges, net = np.unique(np.minimum(starts, ends) * count + np.maximum(starts, ends), return_inverse=True)
    excess = np.bincount(net, weights=np.where(starts < ends, 1, -1)).astype(int)
    if np.all(np.bincount(net) == 2):
        excess[:] = 0
    low, high = np.divmod(edges, count)
    pairs = np.where((excess > 0)[:, None], np.column_stack([low, high]), np.column_stack([high, low]))
    return np.repeat(pairs, np.abs(excess), axis=0)


def is_closed(mesh: Mesh) -> bool:
    """Return whether the geometry of a mesh is closed, so that it encloses a volume."""
    return not len(open_edges(mesh))


def with_small_holes_filled(mesh: Mesh) -> Mesh:
    """Close the geometry of a mesh: return the mesh with its holes filled by triangles, if the holes are
    small defects.

    The mesh itself is returned if it is closed, or if the holes together have more than `LARGEST_HOLES` of
    its area. Each hole is filled by a fan from one of its vertices.
    """
    edges = open_edges(mesh)
    if not len(edges):
        return mesh
    fans = [(loop[0], loop[i + 1], loop[i]) for loop in _loops(edges) for i in range(1, len(loop) - 1)]
    caps = np.array(fans, dtype=mesh.faces.dtype).reshape(-1, 3)
    if _area(mesh.vertices, caps) > LARGEST_HOLES * _area(mesh.vertices, mesh.faces):
        return mesh
    return Mesh(mesh.vertices, np.vstack([mesh.faces, caps]), mesh.file)


def _loops(edges: Ints) -> list[list[int]]:
    """Divide the open edges in the geometry of a mesh into simple loops of vertices. Each vertex has as many
    incoming as outgoing edges.
    """
    after: dict[int, list[int]] = {}
    for a, b in edges.tolist():
        after.setdefault(a, []).append(b)
    found: list[list[int]] = []
    for start in list(after):
        while after[start]:
            path = [start]
            while after[path[-1]]:
                following = after[path[-1]].pop()
                if following in path:  # cut the loop off, and go on with what led to it
                    at = path.index(following)
                    found.append(path[at:])
                    del path[at + 1 :]
                else:
                    path.append(following)
    return found


def _area(vertices: F64, faces: NDArray[np.int32]) -> float:
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()) / 2
