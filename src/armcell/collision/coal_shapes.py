"""Conversion of shapes to coal geometries: primitives stay primitives, meshes stay exact."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import coal
import numpy as np
from numpy.typing import NDArray

from armcell.collision.primitive_set import PrimitiveSet
from armcell.collision.winding import winding_numbers
from armcell.core import (
    Box,
    Capsule,
    Cone,
    Cylinder,
    Mesh,
    Octree,
    Plane,
    PointCloud,
    Shape,
    Sphere,
    is_closed,
)
from armcell.core.geometry import local_bounds

Array = NDArray[np.float64]

CONVEX_EXCESS = 1e-3
CONVEX_DENT = 2e-4
"""A closed mesh is replaced by its convex hull if the hull's volume exceeds the mesh's by at most the
fraction `CONVEX_EXCESS` and no vertex is deeper than `CONVEX_DENT` [m] inside the hull."""


@dataclass(frozen=True, eq=False)
class CoalGeometry:
    """Shape prepared for coal: its exact geometry, and a convex outer geometry that contains it.

    For a convex shape, `outer` is `exact`. For a nonconvex mesh, coal sees only the surface: `hollow` is the
    mesh, for tests whether a point is inside, and `closed` is True if it is watertight. For a point cloud or
    octree, `primitives` holds the parts and `exact` is only the bounding box.
    """

    exact: coal.CollisionGeometry
    outer: coal.CollisionGeometry
    center: Array  # (3,) center of the bounding box [m, shape frame]
    half: Array  # (3,) half extents of the bounding box [m]
    hollow: Mesh | None = None
    primitives: PrimitiveSet | None = None
    closed: bool = True

    def holds(self, point: Array) -> bool:
        """Return whether a point (3,) [m, shape frame] is inside the nonconvex mesh of a coal geometry."""
        if self.hollow is None or np.any(np.abs(point - self.center) > self.half):
            return False
        return bool(abs(winding_numbers(point[None], self.hollow.vertices, self.hollow.faces)[0]) > 0.5)


@lru_cache(maxsize=1024)
def solid(shape: Shape, scale: float = 1.0) -> CoalGeometry:
    """Return the coal geometry of a shape, scaled by a factor about the shape's origin. The result
    is cached.
    """
    center, half = local_bounds(shape)
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
            return CoalGeometry(
                around, around, center * scale, half * scale, None, PrimitiveSet.of(shape, scale)
            )
        case Mesh():
            hull = _hull(shape.vertices * scale)
            if hull is not None and is_convex(shape):
                return CoalGeometry(hull, hull, center * scale, half * scale)
            outer = hull or _bounding_box(shape.vertices * scale)
            hollow = Mesh(shape.vertices * scale, shape.faces)
            exact = triangle_model(hollow.vertices, hollow.faces)
            return CoalGeometry(exact, outer, center * scale, half * scale, hollow, closed=is_closed(shape))
    return CoalGeometry(exact, exact, center * scale, half * scale)


@lru_cache(maxsize=1024)
def is_convex(mesh: Mesh) -> bool:
    """Return whether a watertight mesh nearly fills its convex hull,
    up to `CONVEX_EXCESS`. coal can then treat it as convex.

    No vertex may be deeper than `CONVEX_DENT` inside the hull.
    """
    import trimesh  # slow to import, and needed only for meshes
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


def _points(vertices: Array) -> coal.StdVec_Vec3s:
    points = coal.StdVec_Vec3s()
    for vertex in vertices:
        points.append(vertex)
    return points


def convex_hull(vertices: Array) -> coal.CollisionGeometry:
    """Return the convex hull of points (v, 3) as a coal shape, or their bounding box if they are coplanar."""
    return _hull(vertices) or _bounding_box(vertices)


def _hull(vertices: Array) -> coal.CollisionGeometry | None:
    """Return the convex hull of points (v, 3) as a coal shape, or None if coal cannot represent it."""
    if np.linalg.matrix_rank(vertices - vertices[:1]) < 3:  # coal's qhull may abort the process on these
        return None
    # coal allows 255 neighbors per vertex. "Qt" splits a round flange into triangles at one vertex, which has
    # more; joggled input ("QJ") splits it evenly.
    for options in ("Qt", "QJ"):
        try:
            return coal.ConvexBase.convexHull(_points(vertices), True, options)
        except Exception:  # coal raises several types
            continue
    return None


def _bounding_box(vertices: Array) -> coal.CollisionGeometry:
    low, high = vertices.min(0), vertices.max(0)
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
    extents = np.maximum(high - low, 1e-6)
    return coal.ConvexBase.convexHull(_points(low + corners * extents), True, "Qt")


def triangle_model(vertices: Array, faces: NDArray[np.int32]) -> coal.CollisionGeometry:
    """Return a triangle mesh as a coal shape. coal treats it as a surface without interior."""
    model = coal.BVHModelOBBRSS()
    model.beginModel(len(faces), len(vertices))
    triangles = coal.StdVec_Triangle()
    for a, b, c in faces:
        triangles.append(coal.Triangle(int(a), int(b), int(c)))
    model.addSubModel(_points(vertices), triangles)
    model.endModel()
    return model
