"""Shapes as coal geometries: primitives kept as primitives, meshes exact."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import coal
import numpy as np
from numpy.typing import NDArray

from armcell.collision.many import Many
from armcell.collision.winding import winding_numbers
from armcell.core import Box, Capsule, Cone, Cylinder, Mesh, Octree, Plane, PointCloud, Shape, Sphere
from armcell.core.geometry import local_bounds

Array = NDArray[np.float64]

CONVEX_EXCESS = 1e-3
CONVEX_DENT = 2e-4
"""A closed mesh is treated as its convex hull if that has at most `CONVEX_EXCESS` more volume (a share) and
no vertex is deeper than `CONVEX_DENT` [m] inside it."""


@dataclass(frozen=True, eq=False)
class Solid:
    """A shape ready for coal. `outer` is a convex geometry around it (itself, if it is convex).

    coal sees only the surface of a mesh that is not convex: `hollow` is that mesh, to ask what is inside, and
    `closed` says that it has no rim. What has very many parts is `many` (and `exact` the box around it, not
    to be used).
    """

    exact: coal.CollisionGeometry
    outer: coal.CollisionGeometry
    centre: Array  # (3,) of the box around it, in the shape's frame [m]
    half: Array  # (3,) half extents of that box [m]
    hollow: Mesh | None = None
    many: Many | None = None
    closed: bool = True

    def holds(self, point: Array) -> bool:
        """Whether a point (3,) of the shape's frame is inside a mesh that is not convex."""
        if self.hollow is None or np.any(np.abs(point - self.centre) > self.half):
            return False
        return bool(abs(winding_numbers(point[None], self.hollow.vertices, self.hollow.faces)[0]) > 0.5)


@lru_cache(maxsize=1024)
def solid(shape: Shape, scale: float = 1.0) -> Solid:
    """The coal geometry of a shape, grown by a factor about its own origin."""
    centre, half = local_bounds(shape)
    match shape:
        case Box():
            exact = coal.Box(shape.x * scale, shape.y * scale, shape.z * scale)
        case Sphere():
            exact = coal.Sphere(shape.radius * scale)
        case Cylinder():
            exact = coal.Cylinder(shape.radius * scale, shape.length * scale)
        case Capsule():
            exact = coal.Capsule(shape.radius * scale, shape.length * scale)
        case Cone():
            exact = coal.Cone(shape.radius * scale, shape.length * scale)
        case Plane():
            exact = coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0)
        case PointCloud() | Octree():
            around = coal.Box(*np.maximum(2 * half * scale, 1e-6))
            return Solid(around, around, centre * scale, half * scale, None, Many.of(shape, scale))
        case Mesh():
            outer = convex_hull(shape.vertices * scale)
            if is_convex(shape):
                return Solid(outer, outer, centre * scale, half * scale)
            hollow = Mesh(shape.vertices * scale, shape.faces)
            exact = triangle_model(hollow.vertices, hollow.faces)
            return Solid(exact, outer, centre * scale, half * scale, hollow, closed=is_closed(shape))
    return Solid(exact, exact, centre * scale, half * scale)


@lru_cache(maxsize=1024)
def is_convex(mesh: Mesh) -> bool:
    """Whether a closed mesh fills its convex hull (within `CONVEX_EXCESS`)."""
    import trimesh  # slow to load, and not needed where there are no meshes
    from scipy.spatial import ConvexHull

    surface = trimesh.Trimesh(mesh.vertices, mesh.faces, process=True)
    if not surface.is_watertight or surface.volume <= 0:
        return False
    if float(surface.convex_hull.volume) > abs(float(surface.volume)) * (1 + CONVEX_EXCESS):
        return False
    planes = ConvexHull(mesh.vertices).equations
    return all(
        float(np.max(planes[:, :3] @ vertex + planes[:, 3])) >= -CONVEX_DENT for vertex in mesh.vertices
    )


@lru_cache(maxsize=1024)
def is_closed(mesh: Mesh) -> bool:
    """Whether a mesh has no rim: what it encloses is solid. One with a rim is a surface, nothing more."""
    import trimesh

    return bool(trimesh.Trimesh(mesh.vertices, mesh.faces, process=True).is_watertight)


def _points(vertices: Array) -> coal.StdVec_Vec3s:
    points = coal.StdVec_Vec3s()
    for vertex in vertices:
        points.append(vertex)
    return points


def convex_hull(vertices: Array) -> coal.CollisionGeometry:
    """The hull of points (v, 3); the box around them where they are flat."""
    try:
        if np.linalg.matrix_rank(vertices - vertices[:1]) < 3:  # qhull in coal may end the process
            raise ValueError("flat")
        return coal.ConvexBase.convexHull(_points(vertices), True, "Qt")
    except Exception:  # a flat mesh: the box around it is a convex outer shape as well
        low, high = vertices.min(0), vertices.max(0)
        corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
        extents = np.maximum(high - low, 1e-6)
        return coal.ConvexBase.convexHull(_points(low + corners * extents), True, "Qt")


def triangle_model(vertices: Array, faces: NDArray[np.int32]) -> coal.CollisionGeometry:
    """A triangle mesh for coal; only its surface counts."""
    model = coal.BVHModelOBBRSS()
    model.beginModel(len(faces), len(vertices))
    triangles = coal.StdVec_Triangle()
    for a, b, c in faces:
        triangles.append(coal.Triangle(int(a), int(b), int(c)))
    model.addSubModel(_points(vertices), triangles)
    model.endModel()
    return model
