"""Conversion of shapes to coal geometries: primitives, exact meshes, and parts of point clouds and octrees.

Primitives stay primitives, and meshes stay exact. A point cloud or octree becomes a `PrimitiveSet`: each
part is one sphere or one cube, and a broad phase selects the parts that may touch.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache

import coal
import numpy as np
from numpy.typing import NDArray

from armcell._array_store import key_of, recall_or_compute
from armcell.collision.convex_decomposition import signed_volume
from armcell.collision.winding import WindingNumbers
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

F64 = NDArray[np.float64]
Index = NDArray[np.intp]

CHUNK = 512
"""Number of neighboring parts that share a bounding box for the broad phase."""
CONVEX_EXCESS = 1e-3
CONVEX_DENT = 2e-4
"""A closed mesh is replaced by its convex hull if the hull's volume exceeds the mesh's by at most the
fraction `CONVEX_EXCESS` and no vertex is deeper than `CONVEX_DENT` [m] inside the hull."""


@dataclass(frozen=True, eq=False)
class PrimitiveSet:
    """Spheres or cubes that represent a point cloud or octree for the collision library coal. Sizes are radii
    or half edge lengths.

    They are stored in chunks of `CHUNK` neighbors.
    """

    cubes: bool
    centers: F64  # (n, 3)
    sizes: F64  # (n,)
    low: F64  # (chunks, 3)
    high: F64

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

    def near(self, center: F64, half: F64, R: F64, t: F64, within: float) -> tuple[F64, Index]:
        """Return the primitives (spheres or cubes) of a cloud that coal must test against an oriented box,
        nearest first.

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
        """Yield primitives (spheres or cubes) of a cloud as coal geometries with their transforms. `T` is the
        transform of the cloud's frame.
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
) -> tuple[F64, Index]:
    back = T_primitives.getRotation().T
    R, t = back @ T.getRotation(), back @ (T.getTranslation() - T_primitives.getTranslation())
    return primitives.near(solid.center, solid.half, R, t, within)


def _holds(solid: CoalGeometry, T: coal.Transform3s, part: coal.Transform3s) -> bool:
    """Return whether the nonconvex mesh of a coal geometry contains the center of a primitive (sphere or
    cube). The primitive belongs to a point cloud or octree.
    """
    return solid.holds(T.getRotation().T @ (part.getTranslation() - T.getTranslation()))


def touches_primitives(solid: CoalGeometry, T: coal.Transform3s,
                       primitives: PrimitiveSet, T_primitives: coal.Transform3s,
                 request: coal.CollisionRequest, result: coal.CollisionResult) -> bool:  # fmt: skip
    """Return whether a coal geometry is closer than `request.security_margin` to any primitive (sphere or
    cube) of a point cloud or octree.
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
    """Return the signed distance [m] from a coal geometry to the nearest primitive (sphere or cube) of a
    point cloud or octree.

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


def _halved(centers: F64) -> Index:
    """Order the primitives (spheres or cubes) that represent a cloud in coal, such that each run of `CHUNK`
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


@dataclass(frozen=True, eq=False)
class CoalGeometry:
    """Shape prepared for coal: its exact geometry, and a convex outer geometry that contains it.

    For a convex shape, `outer` is `exact`. For a nonconvex mesh, coal sees only the surface: `hollow` is the
    mesh, for tests whether a point is inside, and `closed` is True if it is watertight. For a point cloud or
    octree, `primitives` holds the parts and `exact` is only the bounding box.
    """

    exact: coal.CollisionGeometry
    outer: coal.CollisionGeometry
    center: F64  # (3,) center of the bounding box [m, shape frame]
    half: F64  # (3,) half extents of the bounding box [m]
    hollow: Mesh | None = None
    primitives: PrimitiveSet | None = None
    closed: bool = True

    @cached_property
    def _winding(self) -> WindingNumbers:
        assert self.hollow is not None
        return WindingNumbers(self.hollow.vertices, self.hollow.faces)

    def holds(self, point: F64) -> bool:
        """Return whether a point (3,) [m, shape frame] is inside the nonconvex mesh of a coal geometry."""
        if self.hollow is None or np.any(np.abs(point - self.center) > self.half):
            return False
        return bool(abs(self._winding(point[None])[0]) > 0.5)


@lru_cache(maxsize=1024)
def solid(shape: Shape, scale: float = 1.0) -> CoalGeometry:
    """Return a shape as a geometry of the collision library coal, scaled by a factor about the shape's
    origin. The result is cached.
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
    """Return whether the collision library coal can treat a mesh as convex: the mesh is watertight, and its
    hull's volume is larger by at most the fraction `CONVEX_EXCESS`.

    No vertex may be deeper than `CONVEX_DENT` inside the hull.
    """
    key = key_of("convex", mesh.vertices, mesh.faces, f"{CONVEX_EXCESS} {CONVEX_DENT}")
    stored = recall_or_compute("meshes", key, lambda: {"convex": np.array(_is_convex(mesh))})
    return bool(stored["convex"])


def _is_convex(mesh: Mesh) -> bool:
    import trimesh  # slow to import, and needed only for new meshes
    from scipy.spatial import ConvexHull, QhullError

    volume = signed_volume(mesh.vertices[mesh.faces])
    if volume <= 0:
        return False
    try:
        hull = ConvexHull(mesh.vertices)
    except QhullError:  # flat
        return False
    if hull.volume > volume * (1 + CONVEX_EXCESS):
        return False
    if not trimesh.Trimesh(mesh.vertices, mesh.faces).is_watertight:  # slow, and most meshes are not convex
        return False
    planes = hull.equations
    return all(
        float(np.max(planes[:, :3] @ vertex + planes[:, 3])) >= -CONVEX_DENT for vertex in mesh.vertices
    )


def _points(vertices: F64) -> coal.StdVec_Vec3s:
    points = coal.StdVec_Vec3s()
    for vertex in vertices:
        points.append(vertex)
    return points


def convex_hull(vertices: F64) -> coal.CollisionGeometry:
    """Return the convex hull of points (v, 3) as a coal shape, or their bounding box if they are coplanar."""
    return _hull(vertices) or _bounding_box(vertices)


def _hull(vertices: F64) -> coal.CollisionGeometry | None:
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


def _bounding_box(vertices: F64) -> coal.CollisionGeometry:
    low, high = vertices.min(0), vertices.max(0)
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
    extents = np.maximum(high - low, 1e-6)
    return coal.ConvexBase.convexHull(_points(low + corners * extents), True, "Qt")


def triangle_model(vertices: F64, faces: NDArray[np.integer]) -> coal.CollisionGeometry:
    """Return a triangle mesh as a coal shape. coal treats it as a surface without interior."""
    model = coal.BVHModelOBBRSS()
    model.beginModel(len(faces), len(vertices))
    model.addVertices(np.asarray(vertices, float))
    model.addTriangles(np.asarray(faces, np.int64))
    model.endModel()
    return model
