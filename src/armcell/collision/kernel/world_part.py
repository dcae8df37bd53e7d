"""Kernel data of world objects: shapes in world coordinates."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from armcell.collision.kernel.box_tree import HUGE
from armcell.collision.kernel.cloud_part import Cloud, cloud_of
from armcell.collision.kernel.lru_cache import LruCache
from armcell.collision.kernel.pieces import Pieces, concatenate, pieces_of, solid
from armcell.core import Mesh, Plane, Shape
from armcell.core.geometry import local_bounds
from armcell.scene import CollisionObject

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I32 = NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class ObjectPart:
    """Kernel data of the convex shapes of one world object (o shapes).

    A point cloud, an octree, or a nonconvex mesh counts as one shape: its bounding box, with a cloud.
    """

    kind: I32  # (o,)
    pose: F32  # (o, 12) rows of T_shape_world
    size: F32  # (o, 3)
    planes: F32  # (n, 4) face planes of convex hulls
    planes_end: I32  # (o,)
    low: F64  # (o, 3) lower corners of the world bounding boxes
    high: F64  # (o, 3) upper corners
    pieces: Pieces
    pieces_end: I32  # (o,)
    cloud: I32  # (o,) index in `clouds` of the cloud whose bounding box the shape is, or -1
    clouds: tuple[Cloud, ...]


_parts: LruCache[ObjectPart] = LruCache(512)
_of_object: WeakKeyDictionary[CollisionObject, ObjectPart] = WeakKeyDictionary()


def object_part(item: CollisionObject) -> ObjectPart:
    """Return the kernel data of an object, cached for objects with the same shapes and pose."""
    found = _of_object.get(item)
    if found is None:
        shapes = tuple((shape, T.matrix.tobytes()) for shape, T in item.shapes)
        found = _parts.get((item.T_world_object.matrix.tobytes(), shapes), lambda: _object_part(item))
        _of_object[item] = found
    return found


def _object_part(item: CollisionObject) -> ObjectPart:
    T_world_object = item.T_world_object.matrix
    kinds, poses, sizes, planes, planes_end, low, high = [], [], [], [], [], [], []
    pieces, pieces_end, cloud, clouds = [], [], [], []
    count = 0
    for shape, T_object_shape in item.shapes:
        T = T_world_object @ T_object_shape.matrix
        found = cloud_of(shape)
        if found is not None:
            if found.empty:
                continue
            shape, T = found.box, T @ found.T_shape_box
            clouds.append(found)
        cloud.append(-1 if found is None else len(clouds) - 1)
        kind, size = solid(shape)
        kinds.append(kind)
        sizes.append(size)
        poses.append(np.linalg.inv(T)[:3].ravel())
        if isinstance(shape, Mesh):
            planes.append(_hull_planes(shape))
        planes_end.append(sum(map(len, planes)))
        lo, hi = _world_box(shape, T)
        low.append(lo)
        high.append(hi)
        pieces.append(pieces_of([(shape, T)]))
        count += len(pieces[-1].kind)
        pieces_end.append(count)
    return ObjectPart(
        np.array(kinds, np.int32),
        np.array(poses, np.float32).reshape(-1, 12),
        np.array(sizes, np.float32).reshape(-1, 3),
        np.concatenate([np.zeros((0, 4)), *planes]).astype(np.float32),
        np.array(planes_end, np.int32),
        np.array(low).reshape(-1, 3),
        np.array(high).reshape(-1, 3),
        concatenate(pieces),
        np.array(pieces_end, np.int32),
        np.array(cloud, np.int32),
        tuple(clouds),
    )


@lru_cache(maxsize=1024)
def _hull_planes(mesh: Mesh) -> F64:
    """Return the outward normals and offsets (n, 4) of the faces of a mesh's convex hull."""
    from scipy.spatial import ConvexHull

    equations = ConvexHull(mesh.vertices).equations  # n x + d <= 0 inside
    _, index = np.unique(np.round(equations, 6), axis=0, return_index=True)
    planes = equations[np.sort(index)]
    return np.column_stack([planes[:, :3], -planes[:, 3]])


def _world_box(shape: Shape, T: F64) -> tuple[F64, F64]:
    if isinstance(shape, Plane):
        return np.full(3, -HUGE), np.full(3, HUGE)
    centre, half = local_bounds(shape)
    centre = T[:3, :3] @ centre + T[:3, 3]
    half = np.abs(T[:3, :3]) @ half
    return centre - half, centre + half
