"""The outer surface of an object as triangles and points with normals, for grasp checks."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from armcell.core import (
    SE3,
    Box,
    Capsule,
    Cone,
    Cylinder,
    InputError,
    Mesh,
    Octree,
    Plane,
    PointCloud,
    Shape,
    Sphere,
)
from armcell.core.checks import float_array, require
from armcell.scene import CollisionObject, solid_inertia

Array = NDArray[np.float64]

SECTIONS = 48  # segments of round shapes
SPACING = 0.004  # [m] spacing of points, if their number is then within the next two limits
FEWEST, MOST = 400, 1500
KEPT = 64  # cached surfaces
NEIGHBORS = 16  # neighbors used for a cloud point's normal


@dataclass(frozen=True, eq=False)
class Surface:
    """Outer surface of an object in the object's frame, as triangles and as points with normals.

    Normals point outwards as far as the shapes define it.
    """

    points: Array  # (n, 3) [m]
    normals: Array  # (n, 3)
    triangles: Array  # (t, 3, 3) [m]; empty for a cloud
    center_of_mass: Array  # (3,) [m]; for a cloud its center
    key: tuple  # equal for equal shapes

    @property
    def bounds(self) -> tuple[Array, Array]:
        return self.points.min(0), self.points.max(0)


_kept: OrderedDict[tuple, Surface] = OrderedDict()


def surface_of(item: CollisionObject) -> Surface:
    """Return the outer surface of an object. The result is cached for objects with the same shapes.

    Raises:
        InputError: the object is a plane or an empty point cloud and cannot be grasped.
    """
    key = tuple((_key(shape), T.matrix.round(9).tobytes()) for shape, T in item.shapes)
    if key not in _kept:
        _kept[key] = _cloud_surface(item, key) if item.has_cloud else _solid_surface(item, key)
        while len(_kept) > KEPT:
            _kept.popitem(last=False)
    _kept.move_to_end(key)
    return _kept[key]


def cloud_surface(points: Array, key: tuple | None = None) -> Surface:
    """Create a `Surface` (points and normals) from a point cloud (n, 3) [m]. Each normal is that of a plane
    fitted to a point's nearest neighbors.

    Normals point away from the cloud's center, because a cloud seen from one side is a shell.

    Raises:
        InputError: too few points for normals.
    """
    from scipy.spatial import KDTree

    points = float_array(points, (None, 3), "points")
    if len(points) <= NEIGHBORS:
        raise InputError(f"a cloud of {len(points)} points is too thin to be gripped", hint="look closer")
    if len(points) > MOST:  # thin evenly: one point per cell, with growing cells
        edge = SPACING / 2
        while len(points) > MOST:
            _, first = np.unique(np.floor(points / edge).astype(np.int64), axis=0, return_index=True)
            points, edge = points[np.sort(first)], edge * 1.25
        require(len(points) > NEIGHBORS, "the cloud's points are all in one place")
    _, near = KDTree(points).query(points, k=min(NEIGHBORS, len(points)))
    around = points[near] - points[near].mean(axis=1, keepdims=True)
    normals = np.linalg.svd(around)[2][:, 2].copy()  # contiguous, or Numba compiles `fit_hand` once more
    middle = (points.min(0) + points.max(0)) / 2
    normals *= np.where(np.einsum("ij,ij->i", normals, points - middle) < 0, -1.0, 1.0)[:, None]
    return Surface(points, normals, np.zeros((0, 3, 3)), middle, key or ("cloud", points.tobytes()))


def _cloud_surface(item: CollisionObject, key: tuple) -> Surface:
    parts = []
    for shape, T in item.shapes:
        if isinstance(shape, PointCloud):
            parts.append(T.apply(shape.points))
        elif isinstance(shape, Octree):
            parts.append(T.apply(shape.centers))
        else:
            parts.append(T.apply(_sampled(triangles_of(shape), MOST)[0]))
    return cloud_surface(np.vstack(parts), key)


def _solid_surface(item: CollisionObject, key: tuple) -> Surface:
    each = [_placed(triangles_of(shape), T) for shape, T in item.shapes]
    area = sum(float(_areas(t).sum()) for t in each)
    thinnest = min(float(np.ptp(t.reshape(-1, 3), axis=0).min()) for t in each)
    spacing = max(min(SPACING, thinnest / 4), 1e-4)
    count = float(np.clip(area / spacing**2, FEWEST, MOST))
    points, normals = [], []
    for i, triangles in enumerate(each):
        found, ways = _sampled(triangles, int(np.ceil(count * _areas(triangles).sum() / area)))
        outside = np.ones(len(found), dtype=bool)
        for k, (shape, T) in enumerate(item.shapes):
            if k != i and outside.any():
                outside &= ~_inside(shape, T.inverse().apply(found))
        points.append(found[outside])
        normals.append(ways[outside])
    movable = [(s, T) for s, T in item.shapes if not isinstance(s, Plane)]
    center, _ = solid_inertia(movable, 1.0)
    return Surface(np.vstack(points), np.vstack(normals), np.concatenate(each), center, key)


def _key(shape: Shape) -> tuple:
    if isinstance(shape, Mesh):
        return ("mesh", hash(shape.vertices.tobytes()), hash(shape.faces.tobytes()))
    if isinstance(shape, PointCloud):
        return ("cloud", hash(shape.points.tobytes()), shape.radius)
    if isinstance(shape, Octree):
        return ("octree", hash(shape.centers.tobytes()), hash(shape.sizes.tobytes()))
    return (type(shape).__name__, *shape.half_extents.tolist(), getattr(shape, "length", 0.0))


def _placed(triangles: Array, T: SE3) -> Array:
    return T.apply(triangles.reshape(-1, 3)).reshape(-1, 3, 3)


def _areas(triangles: Array) -> Array:
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2


def _sampled(triangles: Array, count: int) -> tuple[Array, Array]:
    """Sample about `count` surface points with normals on triangles, evenly by area; all corners are
    included.
    """
    areas = _areas(triangles)
    triangles, areas = triangles[areas > 0], areas[areas > 0]
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    ways = np.cross(b - a, c - a) / (2 * areas)[:, None]
    total = np.cumsum(areas)
    which = np.searchsorted(total, (np.arange(count) + 0.5) / count * total[-1])
    # Two irrational steps distribute points evenly over each triangle without a random generator.
    k = np.arange(count)
    u, v = (0.7548776662466927 * k) % 1.0, (0.5698402909980532 * k) % 1.0
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    inner = a[which] + u[:, None] * (b - a)[which] + v[:, None] * (c - a)[which]
    normals = ways[which]
    step = max(1, 6 * len(triangles) // max(count, 1))  # a fine mesh has enough points in its triangles
    corners = triangles[::step].reshape(-1, 3)
    return np.vstack([inner, corners]), np.vstack([normals, np.repeat(ways[::step], 3, axis=0)])


def _inside(shape: Shape, points: Array) -> NDArray[np.bool_]:
    """Return a mask of the surface points that are well inside another convex shape of the same object.

    The mask of a non-convex mesh is False.
    """
    tolerance = 2e-5
    triangles = triangles_of(shape)
    areas = _areas(triangles)
    a, b, c = (triangles[areas > 0][:, k] for k in range(3))
    n = np.cross(b - a, c - a)
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    n, index = np.unique(n.round(6), axis=0, return_index=True)
    d = np.einsum("ij,ij->i", n, a[index])
    if isinstance(shape, Mesh) and np.any(shape.vertices @ n.T > d + 1e-4):
        return np.zeros(len(points), dtype=bool)
    return np.all(points @ n.T < d - tolerance, axis=1)


def triangles_of(shape: Shape) -> Array:
    """Return the outer surface of a shape as triangles (t, 3, 3) [m] in its own frame, counterclockwise seen
    from outside.

    Raises:
        InputError: the shape is a plane or a cloud.
    """
    match shape:
        case Box():
            return _box(shape.half_extents)
        case Cylinder():
            h = shape.length / 2
            return _revolved([(0, -h), (shape.radius, -h), (shape.radius, h), (0, h)])
        case Cone():
            h = shape.length / 2
            return _revolved([(0, -h), (shape.radius, -h), (0, h)])
        case Sphere():
            return _revolved(_arc(shape.radius, 0.0, -np.pi / 2, np.pi / 2, 24))
        case Capsule():
            h, r = shape.length / 2, shape.radius
            return _revolved([*_arc(r, -h, -np.pi / 2, 0.0, 12), *_arc(r, h, 0.0, np.pi / 2, 12)])
        case Mesh():
            triangles = shape.vertices[shape.faces]
            volume = np.einsum("ij,ij->", triangles[:, 0], np.cross(triangles[:, 1], triangles[:, 2]))
            return triangles[:, ::-1] if volume < 0 else triangles  # the file's triangles are inverted
        case Plane() | PointCloud() | Octree():
            raise InputError(f"a {type(shape).__name__} has no surface that can be gripped")


def _box(half: Array) -> Array:
    corner = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * half
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [f for a, b, c, d in quads for f in ((a, b, c), (a, c, d))]
    return corner[np.array(faces)]


def _arc(radius: float, z: float, start: float, end: float, steps: int) -> list[tuple[float, float]]:
    t = np.linspace(start, end, steps + 1)
    r = np.where(np.abs(np.cos(t)) < 1e-12, 0.0, radius * np.cos(t))
    return list(zip(r.tolist(), (z + radius * np.sin(t)).tolist(), strict=True))


def _revolved(profile: list[tuple[float, float]]) -> Array:
    """Return the triangles of a round object's surface for grasp planning: a surface of revolution about z,
    given by its profile (radius, z).

    The profile runs from bottom to top.
    """
    t = 2 * np.pi * np.arange(SECTIONS + 1) / SECTIONS
    circle = np.column_stack([np.cos(t), np.sin(t)])
    found = []
    for (r0, z0), (r1, z1) in pairwise(profile):
        low = np.column_stack([r0 * circle, np.full(len(t), z0)])
        high = np.column_stack([r1 * circle, np.full(len(t), z1)])
        if r0 > 0:
            found.append(np.stack([low[:-1], low[1:], high[1:]], 1))
        if r1 > 0:
            found.append(np.stack([low[:-1], high[1:], high[:-1]], 1))
    return np.concatenate(found)
