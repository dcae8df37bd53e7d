"""Signed distances to solids that are fitted to points: negative inside, positive outside.

The distance is exact for a box, a cylinder and a sphere. Other shapes become a grid of distances, which is
interpolated between its nodes. A solid consists of parts in one frame; its distance is the smallest one of
its parts.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from armcell.core import SE3, Box, Cylinder, InputError, Mesh, Shape, Sphere

F64 = NDArray[np.float64]

BOX, CYLINDER, SPHERE, GRID = 0, 1, 2, 3
NODES = 44
"""Number of nodes along the longest side of a distance grid."""
_MARGIN = 4  # margin of a grid around the object, in nodes
_SAMPLES = 40_000  # number of samples on the surface


class Solid(NamedTuple):
    """Solid for computing signed distances. It consists of primitive parts or of one grid of distances.

    Kernels take it as one argument.

    The parts have kinds (k,), sizes (k, 3) and poses (k, 12) as rows of 3x4 matrices; kind GRID has a grid
    (i, j, k).
    """

    kinds: NDArray[np.int64]
    sizes: F64
    poses: F64
    grid: F64
    origin: F64  # (3,) [m] position of the grid's first node
    step: float  # [m] distance between nodes
    low: F64  # (3,) [m] corners of the bounding box in the solid's frame
    high: F64

    @property
    def radius(self) -> float:
        """Return the radius [m] of the ball around the frame's origin that contains the whole solid."""
        return float(np.linalg.norm(np.maximum(np.abs(self.low), np.abs(self.high))))

    @property
    def diameter(self) -> float:
        """Return the diagonal [m] of a solid's bounding box."""
        return float(np.linalg.norm(self.high - self.low))

    def distances(self, points: F64) -> F64:
        """Return the signed distances (n,) [m] from points (n, 3) to the solid.
        The points are given in the solid's frame.
        """
        return _distances(self, points)


NO_GRID = np.zeros((1, 1, 1))


def primitive(kind: int, size: tuple[float, float, float]) -> Solid:
    """Create a solid from a single primitive in its own frame, for computing the signed distances of camera
    points.

    The size is a box's half extents, a cylinder's radius and half length, or a sphere's radius.
    """
    half = {
        BOX: np.array(size),
        CYLINDER: np.array([size[0], size[0], size[1]]),
        SPHERE: np.full(3, size[0]),
    }[kind]
    pose = np.eye(4)[:3].reshape(1, 12)
    return Solid(np.array([kind]), np.array([size], float), pose, NO_GRID, np.zeros(3), 1.0, -half, half)


def solid_of(shapes: tuple[tuple[Shape, SE3], ...]) -> Solid:
    """Create a solid from the shapes of an object, for computing the signed distances of camera points.

    Args:
        shapes: (shape, T_object_shape) pairs, as in `CollisionObject.shapes`.
    Raises:
        InputError: a shape is infinite (plane) or consists of points.
    """
    return _solid_of(shapes)


@lru_cache(maxsize=64)
def _solid_of(shapes: tuple[tuple[Shape, SE3], ...]) -> Solid:
    parts = [_part(shape) for shape, _ in shapes]
    if any(part is None for part in parts):
        return _grid_of(shapes)
    corners = []
    for shape, T in shapes:
        half = shape.half_extents  # type: ignore[union-attr]
        for signs in np.ndindex(2, 2, 2):
            corners.append(T.apply(half * (2 * np.array(signs) - 1)))
    known = [part for part in parts if part is not None]
    return Solid(
        np.array([kind for kind, _ in known]),
        np.array([size for _, size in known], float),
        np.array([T.matrix[:3].ravel() for _, T in shapes]),
        NO_GRID, np.zeros(3), 1.0, np.min(corners, axis=0), np.max(corners, axis=0),
    )  # fmt: skip


def _part(shape: Shape) -> tuple[int, tuple[float, float, float]] | None:
    match shape:
        case Box():
            return BOX, (shape.x / 2, shape.y / 2, shape.z / 2)
        case Cylinder():
            return CYLINDER, (shape.radius, shape.length / 2, 0.0)
        case Sphere():
            return SPHERE, (shape.radius, 0.0, 0.0)
    return None


def surface_mesh(shapes: tuple[tuple[Shape, SE3], ...]) -> Mesh:
    """Return one triangle mesh with the surfaces of all shapes of an object, from which the signed distances
    of a solid are computed.

    The mesh is in the object's frame. Perception uses it to fit the object to camera data and to draw it.
    """
    import trimesh

    from armcell.core import Capsule, Cone

    vertices, faces, count = [], [], 0
    for shape, T in shapes:
        match shape:
            case Mesh():
                v, f = shape.vertices, shape.faces
            case Box():
                made = trimesh.creation.box((shape.x, shape.y, shape.z))
                v, f = made.vertices, made.faces
            case Cylinder():
                made = trimesh.creation.cylinder(shape.radius, shape.length, sections=48)
                v, f = made.vertices, made.faces
            case Sphere():
                made = trimesh.creation.icosphere(3, shape.radius)
                v, f = made.vertices, made.faces
            case Capsule():
                made = trimesh.creation.capsule(shape.length, shape.radius, count=[32, 32])
                v, f = np.array(made.vertices), made.faces
                v[:, 2] -= (v[:, 2].min() + v[:, 2].max()) / 2
            case Cone():
                made = trimesh.creation.cone(shape.radius, shape.length, sections=48)
                v, f = np.array(made.vertices), made.faces
                v[:, 2] -= shape.length / 2
            case _:
                raise InputError(
                    f"a {type(shape).__name__} has no surface that could be looked for",
                    hint="look for solids or meshes",
                )
        vertices.append(T.apply(v))
        faces.append(np.asarray(f) + count)
        count += len(v)
    return Mesh(np.vstack(vertices), np.vstack(faces).astype(np.int32))


def _grid_of(shapes: tuple[tuple[Shape, SE3], ...]) -> Solid:
    """Create a `Solid` from the shapes of an object: a grid of signed distances [m] from the surface of the
    shapes.

    A node's distance is that to the plane of the nearest of many samples on the surface. Near the surface, a
    node is inside if it is behind the sample's triangle; elsewhere, if it is not connected to the outside.
    """
    import trimesh
    from scipy.ndimage import label
    from scipy.spatial import KDTree

    mesh = surface_mesh(shapes)
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    step = float((high - low).max()) / (NODES - 2 * _MARGIN)
    origin = low - _MARGIN * step
    shape = np.ceil((high - low) / step).astype(int) + 2 * _MARGIN + 1
    tri = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    samples, face = trimesh.sample.sample_surface(tri, _SAMPLES, seed=0)[:2]  # type: ignore[misc]
    normals = tri.face_normals[face]
    spacing = float(np.sqrt(tri.area / _SAMPLES))
    nodes = np.stack(np.meshgrid(*(np.arange(n) for n in shape), indexing="ij"), -1).reshape(-1, 3)
    points = origin + nodes * step
    far, nearest = KDTree(samples).query(points, workers=1)
    away = points - samples[nearest]
    above = np.einsum("ij,ij->i", away, normals[nearest])
    aside = np.sqrt(np.maximum(far**2 - above**2, 0.0))
    distance = np.where(aside < 2 * spacing, np.abs(above), far)
    touched = (far <= step).reshape(shape)
    outside = np.asarray(label(~touched)[0])  # type: ignore[index]
    reached = (outside == outside[0, 0, 0]).ravel()
    inside = np.where(touched.ravel(), above < 0, ~reached)
    grid = np.where(inside, -distance, distance).reshape(shape)
    pose = np.eye(4)[:3].reshape(1, 12)
    return Solid(
        np.array([GRID]), np.zeros((1, 3)), pose, np.ascontiguousarray(grid), origin, step, low, high
    )


@njit(cache=True)
def part_distance(solid, part, x, y, z):
    """Return the signed distance [m] from a point to one part of a solid, given by its number.
    The point is given in the frame of the part.
    """
    kind, size = solid.kinds[part], solid.sizes[part]
    if kind == SPHERE:
        return np.sqrt(x * x + y * y + z * z) - size[0]
    if kind == BOX:
        a, b, c = abs(x) - size[0], abs(y) - size[1], abs(z) - size[2]
        outside = np.sqrt(max(a, 0.0) ** 2 + max(b, 0.0) ** 2 + max(c, 0.0) ** 2)
        return outside + min(max(a, b, c), 0.0)
    if kind == CYLINDER:
        a, b = np.sqrt(x * x + y * y) - size[0], abs(z) - size[1]
        return np.sqrt(max(a, 0.0) ** 2 + max(b, 0.0) ** 2) + min(max(a, b), 0.0)
    return _interpolated(solid.grid, solid.origin, solid.step, x, y, z)


@njit(cache=True)
def _interpolated(grid, origin, step, x, y, z):
    """Return the signed distance [m] from a point to a solid, interpolated in the solid's distance grid.

    Beyond the grid, the distance to the grid's edge is added.
    """
    f = np.empty(3)
    i = np.empty(3, np.int64)
    extra = 0.0
    p = (x, y, z)
    for d in range(3):
        g = (p[d] - origin[d]) / step
        top = grid.shape[d] - 1.0
        inside = min(max(g, 0.0), top)
        extra += ((g - inside) * step) ** 2
        i[d] = min(int(inside), grid.shape[d] - 2)
        f[d] = inside - i[d]
    total = 0.0
    for a in range(2):
        for b in range(2):
            for c in range(2):
                weight = (f[0] if a else 1 - f[0]) * (f[1] if b else 1 - f[1]) * (f[2] if c else 1 - f[2])
                total += weight * grid[i[0] + a, i[1] + b, i[2] + c]
    return total + np.sqrt(extra)


@njit(cache=True)
def solid_distance(solid, x, y, z):
    """Return the signed distance [m] from a point to a solid.
    The point is given in the frame of the solid.
    """
    least = np.inf
    for k in range(len(solid.kinds)):
        P = solid.poses[k]
        a, b, c = x - P[3], y - P[7], z - P[11]
        d = part_distance(
            solid, k, P[0] * a + P[4] * b + P[8] * c, P[1] * a + P[5] * b + P[9] * c,
            P[2] * a + P[6] * b + P[10] * c,
        )  # fmt: skip
        least = min(least, d)
    return least


@njit(cache=True)
def _distances(solid, points):
    out = np.empty(len(points))
    for i in range(len(points)):
        out[i] = solid_distance(solid, points[i, 0], points[i, 1], points[i, 2])
    return out
