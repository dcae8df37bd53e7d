"""Self-filter: removes points of the robot and its held objects from a point cloud."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.collision.kernel.convex_pieces import convex_parts
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
"""[m] Distance around the shapes that covers the errors of the depth camera and the robot's calibration."""


def remove_robot_points(
    scene: PlanningScene, points: ArrayLike, padding: float = PADDING, objects: Iterable[str] = ()
) -> Array:
    """Remove points on the robot and on held objects from a point cloud.
    Return the other points (n, 3) [m, world frame].

    See `robot_mask`.
    """
    cloud = float_array(points, (-1, 3), "points", finite=False).reshape(-1, 3)
    return cloud[~robot_mask(scene, cloud, padding, objects)]


def robot_mask(
    scene: PlanningScene, points: ArrayLike, padding: float = PADDING, objects: Iterable[str] = (),
    scale: float = 1.0,
) -> NDArray[np.bool_]:  # fmt: skip
    """Return a mask (n,) of the cloud points that the self-filter attributes to the robot: they are inside
    robot links or held objects, or within their padding.

    The padding moves the faces of a shape outward, so the padded region extends a little farther at edges and
    corners.

    Args:
        points: (n, 3) [m, world frame].
        padding: [m] distance around the shapes.
        objects: names of world objects to include, so that the point cloud does not duplicate them.
        scale: scale factor of every link's shapes, multiplied with the scene's own link scale.
    """
    placed = ((shape, T, factor * scale) for shape, T, factor in _placed(scene, objects))
    return _mask(placed, points, padding)


def object_mask(
    scene: PlanningScene, points: ArrayLike, padding: float, objects: Iterable[str]
) -> NDArray[np.bool_]:
    """Return a mask (n,) of the cloud points that the self-filter attributes to given scene objects. The
    points are inside the objects or within their padding.

    Args:
        points: (n, 3) [m, world frame].
        padding: [m] distance around the shapes.
        objects: names of the objects.
    """
    every = ((s, scene.object(n).T_world_object @ T, 1.0) for n in objects for s, T in scene.object(n).shapes)
    return _mask(every, points, padding)


def _mask(placed: Iterable[tuple[Shape, SE3, float]], points: ArrayLike, padding: float) -> NDArray[np.bool_]:
    if not np.isfinite(padding) or padding < 0:
        raise InputError(f"padding is {padding:g}, it must be a number of meters >= 0")
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
    """Yield the shapes whose points the self-filter removes, each with T_world_shape and scale.
    These are the shapes of the robot's links, the held objects and the given objects.
    """
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
    """Return a mask of the cloud points (3, n) that are inside the padded bounding box (world frame) of a
    shape, for the self-filter.
    """
    center, half = local_bounds(shape)
    center = T.apply(center * scale)
    half = np.abs(T.rotation.matrix) @ (half * scale + padding)
    inside = np.abs(columns[0] - center[0]) <= half[0]
    for axis in (1, 2):
        inside &= np.abs(columns[axis] - center[axis]) <= half[axis]
    return inside


def _outside(shape: Shape, p: Array) -> Array:
    """Return the distance [m] from each cloud point (n, 3) to a convex shape of the robot, for the
    self-filter. The distance is negative for points inside.

    The value is the largest signed distance from any of the shape's faces.
    """
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
            raise InputError("a cloud cannot be filtered by another one", hint="name solid objects only")


@lru_cache(maxsize=1024)
def _faces(mesh: Mesh) -> Array:
    """Return the outward normals and offsets (f, 4) of a convex mesh's faces, with which the self-filter
    tests cloud points.
    """
    from scipy.spatial import ConvexHull

    equations = ConvexHull(mesh.vertices).equations
    return np.unique(np.round(equations, 7), axis=0)
