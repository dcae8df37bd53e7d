"""Exact pieces: the convex solids for the kernel's exact tests, as arrays."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from armcell.collision.coal_shapes import is_convex
from armcell.collision.convex_decomposition import convex_pieces
from armcell.collision.kernel import gjk
from armcell.collision.kernel.simd import L
from armcell.core import Box, Capsule, Cone, Cylinder, InputError, Mesh, Plane, Shape, Sphere
from armcell.core.geometry import local_bounds

F64 = NDArray[np.float64]
I32 = NDArray[np.int32]

Splitter = Callable[[Mesh], tuple[Mesh, ...]]


@dataclass(frozen=True, eq=False)
class HullVertices:
    """Vertices of the convex pieces that represent a body exactly: the number of vertices of each piece (e,),
    and the vertices of all pieces (n, 3).
    """

    count: I32
    points: F64

    @cached_property
    def lanes(self) -> dict[str, NDArray]:
        """Return the hull vertices of convex pieces as SIMD vectors for the collision kernel.
        The last vector is padded.
        """
        padded = -(-self.count // L) * L  # the kernel reads L points at once
        first = np.cumsum(padded) - padded
        begin = np.cumsum(self.count) - self.count
        index = np.repeat(begin - first, padded) + np.arange(padded.sum())
        index = np.minimum(index, np.repeat(begin + self.count - 1, padded)).astype(np.int64)
        points = self.points[index]
        return {
            "piece_points": np.column_stack([first, self.count]).astype(np.int32),
            "points": points,
            "points32": points.reshape(-1, L, 3).transpose(0, 2, 1).astype(np.float32),
        }


@dataclass(frozen=True, eq=False)
class ConvexPieces:
    """Convex pieces that represent bodies exactly, as arrays in one common frame.

    Kinds (e,), sizes (e, 3), poses (e, 12) as rows of a 3x4 matrix, bounding spheres (e, 4), and the vertices
    of the solids that are convex hulls.
    """

    kind: I32
    size: F64
    pose: F64
    ball: F64
    corners: HullVertices

    @property
    def tables(self) -> dict[str, NDArray]:
        """Return the convex pieces as tables in the array format of the collision kernel."""
        return {
            "piece_kind": self.kind,
            "piece_size": self.size,
            "piece_pose": self.pose,
            "piece_ball": self.ball,
            **self.corners.lanes,
        }

    def poses_after(self, T: F64) -> F64:
        """Return the poses (e, 12) of the convex pieces, multiplied from the left by T (4, 4)."""
        pose, own = np.empty((len(self.kind), 3, 4)), self.pose.reshape(-1, 3, 4)
        pose[:, :, :3] = T[:3, :3] @ own[:, :, :3]
        pose[:, :, 3] = own[:, :, 3] @ T[:3, :3].T + T[:3, 3]
        return pose.reshape(-1, 12)


def pieces_of(shapes: Sequence[tuple[Shape, F64]], split: Splitter = convex_pieces) -> ConvexPieces:
    """Return the convex pieces that represent the given shapes exactly at their poses (4, 4).

    `split` divides a nonconvex mesh into several pieces.
    """
    every = [(_piece(part), T) for shape, T in shapes for part in convex_parts(shape, split)]
    return ConvexPieces(
        np.array([p[0] for p, _ in every], np.int32),
        np.array([p[1] for p, _ in every], np.float64).reshape(-1, 3),
        np.array([T[:3].ravel() for _, T in every], np.float64).reshape(-1, 12),
        np.array([p[2] for p, _ in every], np.float64).reshape(-1, 4),
        HullVertices(
            np.array([len(p[3]) for p, _ in every], np.int32),
            np.concatenate([np.zeros((0, 3)), *(p[3] for p, _ in every)]),
        ),
    )


def concatenate(parts: Iterable[ConvexPieces]) -> ConvexPieces:
    every = (NO_PIECES, *parts)
    if len(every) == 2:
        return every[1]
    return ConvexPieces(
        np.concatenate([p.kind for p in every]),
        np.concatenate([p.size for p in every]),
        np.concatenate([p.pose for p in every]),
        np.concatenate([p.ball for p in every]),
        HullVertices(
            np.concatenate([p.corners.count for p in every]),
            np.concatenate([p.corners.points for p in every]),
        ),
    )


def join_pieces(robot: dict[str, NDArray], world: dict[str, NDArray]) -> dict[str, NDArray]:
    """Join the tables of the robot's convex pieces with those of the world's convex pieces."""
    joined = {name: np.concatenate([table, world[name]]) for name, table in robot.items()}
    joined["piece_points"][len(robot["piece_points"]) :, 0] += len(robot["points"])
    return joined


def convex_parts(shape: Shape, split: Splitter = convex_pieces) -> tuple[Shape, ...]:
    """Return convex pieces (shapes) whose union contains a shape, to represent the shape in exact tests of
    the kernel.
    """
    return split(shape) if isinstance(shape, Mesh) and not is_convex(shape) else (shape,)


def solid(shape: Shape) -> tuple[int, list[float]]:
    """Return the type of a convex piece and its three size values, as the kernel's GJK needs them."""
    match shape:
        case Mesh():
            return gjk.POINTS, [0.0, 0.0, 0.0]
        case Sphere():
            return gjk.SPHERE, [shape.radius, 0.0, 0.0]
        case Box():
            return gjk.BOX, [shape.x / 2, shape.y / 2, shape.z / 2]
        case Capsule():
            return gjk.CAPSULE, [shape.radius, shape.length / 2, 0.0]
        case Cylinder():
            return gjk.CYLINDER, [shape.radius, shape.length / 2, 0.0]
        case Cone():
            return gjk.CONE, [shape.radius, shape.length / 2, 0.0]
        case Plane():
            return gjk.HALFSPACE, [0.0, 0.0, 0.0]
    raise InputError(f"the kernel does not know {type(shape).__name__}")


def _piece(shape: Shape) -> tuple[int, list[float], F64, F64]:
    """Return the data of a convex piece: its type, size,
    bounding sphere (4,) in the shape's frame and hull vertices (n, 3).
    """
    kind, size = solid(shape)
    points: F64 = hull_points(shape) if isinstance(shape, Mesh) else np.zeros((0, 3))
    if isinstance(shape, Plane):
        return kind, size, np.array([0.0, 0.0, 0.0, 1e9]), points
    center, half = local_bounds(shape)
    radius = np.linalg.norm(points - center, axis=1).max() if len(points) else np.linalg.norm(half)
    return kind, size, np.array([*center, float(radius)]), points


@lru_cache(maxsize=1024)
def hull_points(mesh: Mesh) -> F64:
    """Return the vertices (n, 3) of a mesh's convex hull, which become a convex piece in the kernel."""
    from scipy.spatial import ConvexHull

    return mesh.vertices[ConvexHull(mesh.vertices).vertices]


NO_PIECES = ConvexPieces(
    np.zeros(0, np.int32),
    np.zeros((0, 3)),
    np.zeros((0, 12)),
    np.zeros((0, 4)),
    HullVertices(np.zeros(0, np.int32), np.zeros((0, 3))),
)
