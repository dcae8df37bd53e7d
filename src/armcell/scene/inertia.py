"""Center of mass and inertia of solid objects, for physics and for payloads."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from armcell.core import (
    SE3,
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
from armcell.scene.objects import shape_volume

Array = NDArray[np.float64]


def _unit_inertia(shape: Shape) -> tuple[Array, Array]:
    """Return the center of mass (3,) [m] and the inertia (3, 3) [m^2] of
    a shape with uniform density and a mass of 1 kg.

    The inertia is relative to the center of mass. A mesh that is not closed counts as its convex hull.
    """
    match shape:
        case Box():
            x, y, z = shape.x**2, shape.y**2, shape.z**2
            return np.zeros(3), np.diag([y + z, x + z, x + y]) / 12
        case Sphere():
            return np.zeros(3), np.eye(3) * 0.4 * shape.radius**2
        case Cylinder():
            r, h = shape.radius**2, shape.length**2
            return np.zeros(3), np.diag([r / 4 + h / 12, r / 4 + h / 12, r / 2])
        case Cone():
            r, h = shape.radius**2, shape.length**2
            side = 3 / 20 * r + 3 / 80 * h
            return np.array([0, 0, -shape.length / 4]), np.diag([side, side, 0.3 * r])
        case Capsule():
            r, h = shape.radius, shape.length
            ball = 4 / 3 * r / (h + 4 / 3 * r)  # fraction of the mass in the two hemispheres
            rod = 1 - ball
            axial = rod * r**2 / 2 + ball * 0.4 * r**2
            side = rod * (r**2 / 4 + h**2 / 12) + ball * (0.4 * r**2 + h**2 / 4 + 3 / 8 * h * r)
            return np.zeros(3), np.diag([side, side, axial])
        case Mesh():
            import trimesh

            mesh = trimesh.Trimesh(shape.vertices, shape.faces, process=False)
            if not (is_closed(shape) and abs(mesh.volume) > 0):
                mesh = mesh.convex_hull
            return np.array(mesh.center_mass), np.array(mesh.moment_inertia) / mesh.volume
        case Plane() | PointCloud() | Octree():
            raise ValueError(f"a {type(shape).__name__} does not move: it has no inertia")


def solid_inertia(shapes: Iterable[tuple[Shape, SE3]], mass: float) -> tuple[Array, Array]:
    """Return the center of mass (3,) [m] of an object and its inertia (3, 3) [kg m^2] about that center.

    Both are in the object's frame. The mass is distributed evenly over the shapes' volumes; overlaps count
    twice.

    Args:
        shapes: (shape, T_object_shape) pairs.
        mass: total mass [kg].
    """
    parts = []
    volumes = []
    for shape, T in shapes:
        center, inertia = _unit_inertia(shape)
        R = T.rotation.matrix
        parts.append((T.apply(center), R @ inertia @ R.T))
        volumes.append(shape_volume(shape))
    masses = mass * np.array(volumes) / sum(volumes)
    center = masses @ np.array([c for c, _ in parts]) / mass
    total = np.zeros((3, 3))
    for m, (c, inertia) in zip(masses, parts, strict=True):
        d = c - center
        total += m * (inertia + (d @ d) * np.eye(3) - np.outer(d, d))
    return center, total
