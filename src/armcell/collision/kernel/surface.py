"""Surface and interior points of solids that a sphere cover must contain."""

from __future__ import annotations

import coal
import numpy as np
from numpy.typing import NDArray

from armcell.collision.coal_shapes import triangle_model
from armcell.collision.winding import winding_numbers
from armcell.core import Box, Capsule, Cone, Cylinder, Mesh, Octree, Plane, PointCloud, Shape, Sphere

Array = NDArray[np.float64]

SECTIONS = 48  # number of facets around round shapes


def triangulated(shape: Shape) -> tuple[Array, NDArray[np.int64], float]:
    """Return the vertices (v, 3) and faces (f, 3) of a triangulated shape,
    and the largest gap [m] to the shape's true surface.

    The gap is the largest distance by which the true surface is outside the triangles.
    """
    import trimesh  # slow to import, and not needed if the covers are in the disk cache

    match shape:
        case Mesh():
            return np.asarray(shape.vertices, float), shape.faces.astype(np.int64), 0.0
        case Box():
            mesh, gap = trimesh.creation.box((shape.x, shape.y, shape.z)), 0.0
        case Cylinder():
            mesh = trimesh.creation.cylinder(shape.radius, shape.length, sections=SECTIONS)
            gap = shape.radius * (1 - np.cos(np.pi / SECTIONS))
        case Cone():
            mesh = trimesh.creation.cone(shape.radius, shape.length, sections=SECTIONS)
            mesh.apply_translation((0, 0, -shape.length / 2))
            gap = shape.radius * (1 - np.cos(np.pi / SECTIONS))
        case Capsule():
            mesh = trimesh.creation.capsule(shape.length, shape.radius, count=(24, 24))
            mesh.apply_translation(-mesh.bounds.mean(axis=0))
            gap = shape.radius * (1 - np.cos(np.pi / 24)) * 2
        case Sphere():
            mesh = trimesh.creation.icosphere(3, shape.radius)
            gap = shape.radius * 0.01
        case Plane() | PointCloud() | Octree():
            raise ValueError(
                f"a {type(shape).__name__} has no cover: it is no part of robots or moving objects"
            )
    return np.asarray(mesh.vertices, float), np.asarray(mesh.faces, np.int64), float(gap)


def small_triangles(vertices: Array, faces: NDArray[np.int64], edge: float) -> Array:
    """Split the surface of a solid for the collision kernel into triangles (m, 3, 3) whose edges are at most
    `edge` [m] long.

    The algorithm halves the longest edges. A sphere is convex, so it contains a triangle if it contains its
    vertices: covers need no margin between sample points.
    """
    left, done = vertices[faces], []
    while len(left):
        sides = np.stack([left[:, (k + 1) % 3] - left[:, k] for k in range(3)], axis=1)
        lengths = (sides**2).sum(axis=2)
        big = lengths.max(axis=1) > edge * edge
        done.append(left[~big])
        left, k = left[big], lengths[big].argmax(axis=1)
        rows = np.arange(len(left))
        a, b, c = left[rows, k], left[rows, (k + 1) % 3], left[rows, (k + 2) % 3]
        middle = (a + b) / 2
        left = np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])
    return np.concatenate(done)


def outer_skin(vertices: Array, faces: NDArray[np.int64], edge: float) -> Array:
    """Return the outer surface of a solid's mesh as small triangles (m, 3, 3), which the kernel covers with
    spheres.

    Parts of the surface that are inside the same mesh are left out and need no cover: robot meshes often
    consist of several closed solids that intersect.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    _, parts = connected_components(
        coo_matrix(
            (np.ones(3 * len(faces)), (faces.ravel(), np.roll(faces, 1, axis=1).ravel())),
            (len(vertices),) * 2,
        )
    )
    part_of_face = parts[faces[:, 0]]
    names = np.unique(part_of_face)
    if len(names) == 1:
        return small_triangles(vertices, faces, edge)
    kept = []
    for part in names:
        elements = small_triangles(vertices, faces[part_of_face == part], edge)
        buried = np.zeros(len(elements), dtype=bool)
        # Test points slightly outside the face: where two solids abut, each face is inside the other solid.
        normal = np.cross(elements[:, 1] - elements[:, 0], elements[:, 2] - elements[:, 0])
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-18)
        points = elements.mean(axis=1) + 2e-4 * normal
        for other in names:
            if other == part:
                continue
            solid = faces[part_of_face == other]
            low, high = vertices[solid].min(axis=(0, 1)), vertices[solid].max(axis=(0, 1))
            near = np.flatnonzero(~buried & np.all((points > low) & (points < high), axis=1))
            buried[near] = winding_numbers(points[near], vertices, solid) > 0.5
        kept.append(elements[~buried])
    return np.concatenate(kept)


def depths(points: Array, skin: Array) -> Array:
    """Return the depths (m,) [m] of interior points of a solid below the solid's surface triangles (k, 3,
    3).
    """
    corners, index = np.unique(np.round(skin.reshape(-1, 3), 9), axis=0, return_inverse=True)
    model = triangle_model(corners, index.reshape(-1, 3).astype(np.int32))
    point, radius = coal.Sphere(1e-6), 1e-6
    here, there = coal.Transform3s(), coal.Transform3s()
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    out, R = np.empty(len(points)), np.eye(3)
    for i, p in enumerate(points):
        there.setTransform(R, p)
        result.clear()
        out[i] = coal.distance(model, here, point, there, request, result) + radius
    return np.maximum(out, 0.0)


def interior_points(vertices: Array, faces: NDArray[np.int64], spacing: float) -> Array:
    """Return grid points (m, 3) inside a solid and away from its surface.
    The solid's sphere cover must contain them.
    """
    low, high = vertices.min(0), vertices.max(0)
    axes = [np.arange(a + (b - a) % spacing / 2, b, spacing) for a, b in zip(low, high, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    if len(grid) == 0:
        return grid
    return grid[winding_numbers(grid, vertices, faces) > 0.5]
