"""Objects for the tests of the grasping room, and their surfaces by another way: trimesh's primitives."""

from __future__ import annotations

import numpy as np
import trimesh

from armcell.core import SE3, Box, Cylinder, Sphere
from armcell.scene import CollisionObject

FINE = 180  # sections of a round surface: its polygon is 0.02 % inside the circle


def solid(shape, pose: SE3 | None = None, T_object_shape: SE3 | None = None, **properties) -> CollisionObject:
    """A movable object of one shape, which may stand off the object's own origin."""
    shapes = ((shape, T_object_shape or SE3.identity()),)
    return CollisionObject("item", shapes, pose or SE3.identity(), movable=True, **properties)


def surface(item: CollisionObject) -> np.ndarray:
    """Points (n, 3) [m] of an object's surface in its own frame; their hull is the object's."""
    return np.vstack([T.apply(_vertices(shape)) for shape, T in item.shapes])


def _vertices(shape) -> np.ndarray:
    match shape:
        case Box():
            return trimesh.creation.box((shape.x, shape.y, shape.z)).vertices
        case Cylinder():
            return trimesh.creation.cylinder(shape.radius, shape.length, sections=FINE).vertices
        case Sphere():
            return trimesh.creation.icosphere(subdivisions=4, radius=shape.radius).vertices
    raise TypeError(shape)


def world_surface(item: CollisionObject, T_world_object: SE3 | None = None) -> np.ndarray:
    """The same points in the world frame."""
    return (T_world_object or item.T_world_object).apply(surface(item))
