"""Shapes: shape_msgs/SolidPrimitive, Mesh and Plane. Lengths are full lengths in both."""

from __future__ import annotations

from typing import Any

import numpy as np

from armcell.core import (
    SE3,
    SO3,
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
from armcell.ros.schema import Schema

BOX, SPHERE, CYLINDER, CONE = 1, 2, 3, 4  # shape_msgs/SolidPrimitive
NAMES = {BOX: "box", SPHERE: "sphere", CYLINDER: "cylinder", CONE: "cone"}
COUNTS = {BOX: 3, SPHERE: 1, CYLINDER: 2, CONE: 2}


def primitive_shape(message: Any) -> Shape:
    """The solid of a shape_msgs/SolidPrimitive.

    Raises:
        InputError: an unknown kind, too few dimensions, or one that is not positive.
    """
    kind, sizes = int(message.type), [float(v) for v in message.dimensions]
    if kind not in NAMES:
        raise InputError(f"solid primitive of type {kind}", cure="1 box, 2 sphere, 3 cylinder, 4 cone")
    if len(sizes) < COUNTS[kind]:
        raise InputError(f"a {NAMES[kind]} has {len(sizes)} dimensions, it needs {COUNTS[kind]}")
    if kind == BOX:
        return Box(*sizes[:3])
    if kind == SPHERE:
        return Sphere(sizes[0])
    height, radius = sizes[:2]
    return Cylinder(radius, height) if kind == CYLINDER else Cone(radius, height)


def mesh_shape(message: Any) -> Mesh:
    """The mesh of a shape_msgs/Mesh.

    Raises:
        InputError: no triangles, or one that names a vertex that is not there.
    """
    vertices = np.array([(v.x, v.y, v.z) for v in message.vertices], dtype=float).reshape(-1, 3)
    faces = np.array([list(t.vertex_indices) for t in message.triangles], dtype=np.int64).reshape(-1, 3)
    return Mesh(vertices, faces.astype(np.int32))


def plane_pose(message: Any) -> SE3:
    """T of our plane's frame (solid below its z) for a shape_msgs/Plane a x + b y + c z + d = 0.

    Raises:
        InputError: a normal of length zero.
    """
    a, b, c, d = (float(v) for v in message.coef)
    normal = np.array([a, b, c])
    length = float(np.linalg.norm(normal))
    if not np.isfinite(length) or length < 1e-9 or not np.isfinite(d):
        raise InputError(f"a plane has coefficients {[a, b, c, d]}, its normal needs a length")
    normal /= length
    return SE3(SO3.between(np.array([0.0, 0.0, 1.0]), normal), -d / length * normal)


class ShapeMessages:
    """The lists that collision objects and bounding volumes carry, filled shape by shape."""

    def __init__(self, schema: Schema):
        self._schema = schema
        self.primitives: list[tuple[Any, SE3]] = []
        self.meshes: list[tuple[Any, SE3]] = []
        self.planes: list[tuple[Any, SE3]] = []

    def add(self, shape: Shape, T: SE3) -> None:
        """A capsule becomes a cylinder and two spheres; clouds have no message here and are left out."""
        match shape:
            case Box():
                self._primitive(BOX, (shape.x, shape.y, shape.z), T)
            case Sphere():
                self._primitive(SPHERE, (shape.radius,), T)
            case Cylinder():
                self._primitive(CYLINDER, (shape.length, shape.radius), T)
            case Cone():
                self._primitive(CONE, (shape.length, shape.radius), T)
            case Capsule():
                self._primitive(CYLINDER, (shape.length, shape.radius), T)
                for end in (-shape.length / 2, shape.length / 2):
                    self._primitive(SPHERE, (shape.radius,), T @ SE3.from_xyz(0.0, 0.0, end))
            case Plane():
                coefficients = np.array([0.0, 0.0, 1.0, 0.0])
                self.planes.append((self._schema.new("shape_msgs/Plane", coef=coefficients), T))
            case Mesh():
                self.meshes.append((self._mesh(shape), T))
            case PointCloud() | Octree():
                pass

    def _primitive(self, kind: int, sizes: tuple[float, ...], T: SE3) -> None:
        new = self._schema.new(
            "shape_msgs/SolidPrimitive", type=kind, dimensions=np.array(sizes, dtype=float)
        )
        self.primitives.append((new, T))

    def _mesh(self, shape: Mesh) -> Any:
        Point = self._schema.message("geometry_msgs/Point")
        Triangle = self._schema.message("shape_msgs/MeshTriangle")
        return self._schema.new(
            "shape_msgs/Mesh",
            triangles=[Triangle(vertex_indices=f.astype(np.uint32)) for f in shape.faces],
            vertices=[Point(*v) for v in shape.vertices.tolist()],
        )
