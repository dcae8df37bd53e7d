"""Which points of a cloud are the robot itself, or what it holds: they are no obstacles."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.collision.kernel.pieces import convex_parts
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
from armcell.core.checks import float_array
from armcell.core.geometry import local_bounds
from armcell.kinematics import kinematic_tree
from armcell.scene import PlanningScene

Array = NDArray[np.float64]

PADDING = 0.02
"""[m] around the shapes: what a depth camera and the robot's calibration are off by."""


def without_robot(
    scene: PlanningScene, points: ArrayLike, padding: float = PADDING, objects: Iterable[str] = ()
) -> Array:
    """The points (n, 3) [m, world frame] that are neither the robot nor what it holds (see `robot_mask`)."""
    cloud = float_array(points, (-1, 3), "points", finite=False).reshape(-1, 3)
    return cloud[~robot_mask(scene, cloud, padding, objects)]


def robot_mask(
    scene: PlanningScene, points: ArrayLike, padding: float = PADDING, objects: Iterable[str] = ()
) -> NDArray[np.bool_]:
    """Which points (n, 3) [m, world frame] are inside links or held objects, or within the padding of them.

    Faces are moved out by the padding, so that at corners and edges points a little farther off count too.

    Args:
        objects: names of objects in the world to count as well, so that they are not there twice.
    """
    return _mask(_placed(scene, objects), points, padding)


def object_mask(
    scene: PlanningScene, points: ArrayLike, padding: float, objects: Iterable[str]
) -> NDArray[np.bool_]:
    """Which points (n, 3) [m, world frame] are inside objects of the scene, or within the padding of them."""
    every = ((s, scene.object(n).T_world_object @ T, 1.0) for n in objects for s, T in scene.object(n).shapes)
    return _mask(every, points, padding)


def _mask(placed: Iterable[tuple[Shape, SE3, float]], points: ArrayLike, padding: float) -> NDArray[np.bool_]:
    if not np.isfinite(padding) or padding < 0:
        raise InputError(f"padding is {padding:g}, it must be a number of metres >= 0")
    cloud = float_array(points, (-1, 3), "points", finite=False).reshape(-1, 3)
    mask = np.zeros(len(cloud), bool)
    columns = np.ascontiguousarray(cloud.T)
    for shape, T, scale in placed:
        near = np.flatnonzero(_in_box(columns, shape, T, scale, padding))
        local = (cloud[near] - T.translation) @ (T.rotation.matrix / scale)
        for part in convex_parts(shape):
            mask[near] |= _outside(part, local) * scale <= padding
    return mask


def _placed(scene: PlanningScene, objects: Iterable[str]) -> Iterator[tuple[Shape, SE3, float]]:
    """Shapes with T_world_shape and the factor they are grown by."""
    tree = kinematic_tree(scene.model)
    Ts = [SE3.from_matrix(T) for T in tree.link_transforms(scene.positions)]
    for link in scene.model.links.values():
        for c in link.collisions:
            T = Ts[tree.link_index[link.name]] @ c.T_link_shape
            yield c.shape, T, scene.link_scale.get(link.name, 1.0)
    for item in (*map(scene.object, scene.attached), *map(scene.object, objects)):
        for shape, T in item.shapes:
            yield shape, item.T_world_object @ T, 1.0


def _in_box(columns: Array, shape: Shape, T: SE3, scale: float, padding: float) -> NDArray[np.bool_]:
    """Points (3, n) in the box around a shape in the world."""
    centre, half = local_bounds(shape)
    centre = T.apply(centre * scale)
    half = np.abs(T.rotation.matrix) @ (half * scale + padding)
    inside = np.abs(columns[0] - centre[0]) <= half[0]
    for axis in (1, 2):
        inside &= np.abs(columns[axis] - centre[axis]) <= half[axis]
    return inside


def _outside(shape: Shape, p: Array) -> Array:
    """How far (n,) [m] points (n, 3) are beyond the face of a convex shape that they are farthest beyond."""
    r, z = np.hypot(p[:, 0], p[:, 1]), p[:, 2]
    match shape:
        case Box():
            return np.max(np.abs(p) - shape.half_extents, axis=1, initial=-np.inf)
        case Sphere():
            return np.linalg.norm(p, axis=1) - shape.radius
        case Cylinder():
            return np.maximum(r - shape.radius, np.abs(z) - shape.length / 2)
        case Capsule():
            return np.hypot(r, np.maximum(np.abs(z) - shape.length / 2, 0.0)) - shape.radius
        case Cone():
            slant = (shape.length * r + shape.radius * (z - shape.length / 2)) / np.hypot(
                shape.length, shape.radius
            )  # fmt: skip
            return np.maximum(slant, -shape.length / 2 - z)
        case Plane():
            return z
        case Mesh():
            planes = _faces(shape)
            found = np.full(len(p), -np.inf)
            for plane in planes:
                np.maximum(found, p @ plane[:3] + plane[3], out=found)
            return found
        case PointCloud() | Octree():
            raise InputError("a cloud cannot be filtered by another one", cure="name solid objects only")


@lru_cache(maxsize=1024)
def _faces(mesh: Mesh) -> Array:
    """Outward normals and offsets (f, 4) of a convex mesh."""
    from scipy.spatial import ConvexHull

    equations = ConvexHull(mesh.vertices).equations
    return np.unique(np.round(equations, 7), axis=0)
