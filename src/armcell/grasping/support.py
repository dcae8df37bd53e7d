"""Flat surfaces of objects on which other objects can be placed."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from armcell.core import SE3, SO3, Box, Cylinder, InputError, Mesh
from armcell.scene import CollisionObject
from armcell.scene.resting import polygon

LEVEL = float(np.arccos(0.999))  # [rad] maximum tilt of a level surface
UPWARD = np.deg2rad(75)  # [rad] steeper surfaces are walls
FILLED = 0.85  # minimum fraction of its bounding rectangle that a mesh face must fill
SAME_PLANE = 2e-4  # [m]

Array = NDArray[np.float64]
Found = tuple[SE3, float, float]


def support_surface(support: CollisionObject, steepest: float = LEVEL) -> Found:
    """Return the surface of an object on which other objects can stand: its largest flat,
    upward-facing face. Level faces are preferred.

    Args:
        steepest: [rad] maximum tilt from the horizontal.
    Returns:
        Frame at the surface's center (z along its normal, x and y along its edges) and size x, y [m].
    Raises:
        InputError: no shape has such a surface; the text states the smallest tilt.
    """
    level = _largest(f for shape, T in _placed(support) for f in _level(shape, T))
    if level is not None:
        return level
    tilted = [f for shape, T in _placed(support) for f in _tilted(shape, T)]
    found = _largest(f for f in tilted if tilt_of(f[0]) <= steepest)
    if found is not None:
        return found
    text = f"object {support.name!r} has no flat surface on top"
    if not tilted:
        raise InputError(text, hint="place on a box, table or tray")
    leans, most = (np.degrees(angle) for angle in (min(tilt_of(f[0]) for f in tilted), steepest))
    if steepest <= LEVEL:
        raise InputError(f"{text} that is level: it leans by {leans:.1f} degrees", hint="level it")
    raise InputError(
        f"{text} that holds: it leans by {leans:.1f} degrees, friction with its margin holds to {most:.1f}",
        hint="level it, or use a material of more friction",
    )


def tilt_of(frame: SE3) -> float:
    """Return the tilt [rad] of a support surface, which is the angle between its normal (z) and the
    vertical.
    """
    z = frame.rotation.matrix[:, 2]
    return float(np.arctan2(np.hypot(z[0], z[1]), z[2]))


def _placed(support: CollisionObject) -> Iterator[tuple[object, SE3]]:
    for shape, T_object_shape in support.shapes:
        yield shape, support.T_world_object @ T_object_shape


def _largest(found: Iterator[Found]) -> Found | None:
    return max(found, key=lambda f: f[1] * f[2], default=None)


# --- level surfaces ---
def _level(shape: object, T: SE3) -> Iterator[Found]:
    if isinstance(shape, Box | Cylinder):
        yield from _level_end(shape, T)
    elif isinstance(shape, Mesh):
        yield from _level_face(shape, T)


def _level_end(shape: Box | Cylinder, T: SE3) -> Iterator[Found]:
    """Yield the level top face of a box or cylinder as a support surface, if there is one."""
    axis = int(np.argmax(np.abs(T.rotation.matrix[2])))
    if abs(T.rotation.matrix[2, axis]) < np.cos(LEVEL) or (isinstance(shape, Cylinder) and axis != 2):
        return
    sign = np.sign(T.rotation.matrix[2, axis])
    frame, size_x, size_y = _side(shape, T, axis, sign, np.array([0.0, 0.0, 1.0]))
    yield frame, size_x, size_y


def _level_face(mesh: Mesh, T: SE3) -> Iterator[Found]:
    """Yield the level areas of a mesh as support surfaces: axis-aligned rectangles in the world frame. An
    area must nearly fill its bounding rectangle.
    """
    triangles = T.apply(mesh.vertices)[mesh.faces]
    normal, area = _normals(triangles)
    level = (area > 0) & (normal[:, 2] > np.cos(LEVEL))
    heights = triangles[:, :, 2].mean(1).round(4)
    for z in np.unique(heights[level]):
        same = level & (np.abs(heights - z) < SAME_PLANE)
        at = triangles[same].reshape(-1, 3)
        low, high = at.min(0), at.max(0)
        x, y = (high - low)[:2]
        if area[same].sum() > FILLED * x * y:
            middle = (low + high) / 2
            yield SE3.from_xyz(float(middle[0]), float(middle[1]), float(z)), float(x), float(y)


# --- tilted surfaces ---
def _tilted(shape: object, T: SE3) -> Iterator[Found]:
    """Yield the upward-facing but tilted sides of a shape as support surfaces. `_level` yields the level
    sides.
    """
    if isinstance(shape, Box | Cylinder):
        for axis in range(3) if isinstance(shape, Box) else (2,):
            z = T.rotation.matrix[2, axis]
            if np.cos(UPWARD) < abs(z) < np.cos(LEVEL):
                sign = np.sign(z)
                yield _side(shape, T, axis, sign, sign * T.rotation.matrix[:, axis])
    elif isinstance(shape, Mesh):
        yield from _tilted_faces(shape, T)


def _tilted_faces(mesh: Mesh, T: SE3) -> Iterator[Found]:
    """Yield the tilted planar faces of a mesh that are nearly rectangular, as support surfaces for other
    objects.
    """
    triangles = T.apply(mesh.vertices)[mesh.faces]
    normal, area = _normals(triangles)
    left = (area > 0) & (normal[:, 2] > np.cos(UPWARD)) & (normal[:, 2] < np.cos(LEVEL))
    while left.any():
        n = normal[int(np.argmax(np.where(left, area, 0.0)))]
        depth = triangles.mean(1) @ n
        same = left & (normal @ n > 1 - 1e-5)
        same &= np.abs(depth - depth[int(np.argmax(np.where(same, area, 0.0)))]) < SAME_PLANE
        corners = triangles[same].reshape(-1, 3)
        X = _along_an_edge(corners, n)
        R = np.column_stack([X, np.asarray(np.cross(n, X), dtype=np.float64), n])
        at = corners @ R
        low, high = at.min(0), at.max(0)
        if area[same].sum() > FILLED * np.prod((high - low)[:2]):
            size_x, size_y = (float(v) for v in (high - low)[:2])
            yield SE3(SO3(R), R @ ((low + high) / 2)), size_x, size_y
        left &= ~same


def _along_an_edge(corners: Array, normal: Array) -> Array:
    """Return the direction (3,) of one edge of the smallest rectangle
    that contains the points (n, 3) of a support face.
    """
    ring = polygon(corners, normal)
    best, least = ring[1] - ring[0], np.inf
    for edge in np.roll(ring, -1, axis=0) - ring:
        edge = edge / np.linalg.norm(edge)
        area = float(np.ptp(corners @ edge) * np.ptp(corners @ np.cross(normal, edge)))
        if area < least - 1e-12:
            best, least = edge, area
    return best / np.linalg.norm(best)


# --- common helpers ---
def _side(shape: Box | Cylinder, T: SE3, axis: int, sign: float, normal: Array) -> Found:
    """Return the face of a box or cylinder at the positive or negative end of one of its axes, as a support
    surface for other objects.
    """
    x, y = [k for k in range(3) if k != axis]
    half = shape.half_extents
    scale = 1 / np.sqrt(2) if isinstance(shape, Cylinder) else 1.0  # inscribed square of the circle
    offset = np.zeros(3)
    offset[axis] = sign * half[axis]
    X = T.rotation.matrix[:, x]
    frame = SE3(SO3(np.column_stack([X, np.cross(normal, X), normal])), T.apply(offset))
    return frame, 2 * half[x] * scale, 2 * half[y] * scale


def _normals(triangles: Array) -> tuple[Array, Array]:
    """Return the unit normals (n, 3) and areas (n,) [m^2] of triangles (n, 3, 3), to find faces that support
    objects.
    """
    across = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    double = np.linalg.norm(across, axis=1)
    return across / np.maximum(double, 1e-300)[:, None], double / 2
