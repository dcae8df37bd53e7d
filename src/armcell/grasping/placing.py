"""Where to put an object: place candidates on a support, best first."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armcell.core import SE3, SO3, Box, Cylinder, InputError, Mesh
from armcell.core.geometry import extent
from armcell.grasping.stability import Rest, margin_of, polygon, resting_now, rests
from armcell.grasping.surface import surface_of
from armcell.scene import CollisionObject

RELEASE_GAP = 0.001  # [m] above the support when the fingers open
STABILITY_MARGIN = 0.004  # [m] the object's foot stays inside the support's edge, its mass inside the foot's
FREE_PLACES = 24  # besides the grid
OVERHANG = 0.4  # share of its margin that an object must keep where its foot reaches over an edge
ROLLS = 0.05  # of score less where an object stands on a round side

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Placement:
    """A pose to leave an object at; `T_world_object` is where it comes to rest."""

    name: str
    T_world_object: SE3
    score: float = 0.0


def support_surface(support: CollisionObject) -> tuple[SE3, float, float]:
    """The largest flat, upward surface of an object: its centre frame (z up) and its size x, y [m].

    Raises:
        InputError: none of its shapes has one.
    """
    best = None
    for shape, T_object_shape in support.shapes:
        T = support.T_world_object @ T_object_shape
        found = None
        if isinstance(shape, Box | Cylinder):
            found = _flat_end(shape, T)
        elif isinstance(shape, Mesh):
            found = _flat_top(shape, T)
        if found is not None and (best is None or found[1] * found[2] > best[1] * best[2]):
            best = found
    if best is None:
        raise InputError(
            f"object {support.name!r} has no flat surface on top", cure="place on a box, table or tray"
        )
    return best


def _flat_end(shape: Box | Cylinder, T: SE3) -> tuple[SE3, float, float] | None:
    """The upper side of a box or the upper end of a cylinder, if it is level."""
    half = shape.half_extents
    axis = int(np.argmax(np.abs(T.rotation.matrix[2])))
    sign = np.sign(T.rotation.matrix[2, axis])
    if abs(T.rotation.matrix[2, axis]) < 0.999 or (isinstance(shape, Cylinder) and axis != 2):
        return None
    x, y = [k for k in range(3) if k != axis]
    scale = 1 / np.sqrt(2) if isinstance(shape, Cylinder) else 1.0  # the square inside the circle
    offset = np.zeros(3)
    offset[axis] = sign * half[axis]
    X = T.rotation.matrix[:, x]
    Z = np.array([0.0, 0.0, 1.0])
    frame = SE3(SO3(np.column_stack([X, np.cross(Z, X), Z])), T.apply(offset))
    return frame, 2 * half[x] * scale, 2 * half[y] * scale


def _flat_top(mesh: Mesh, T: SE3) -> tuple[SE3, float, float] | None:
    """The largest level face of a mesh that fills a rectangle along the world's axes."""
    triangles = T.apply(mesh.vertices)[mesh.faces]
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    area = np.linalg.norm(normal, axis=1) / 2
    level = (area > 0) & (normal[:, 2] > 0.999 * 2 * area)
    best = None
    heights = triangles[:, :, 2].mean(1).round(4)
    for z in np.unique(heights[level]):
        same = level & (np.abs(heights - z) < 2e-4)
        at = triangles[same].reshape(-1, 3)
        low, high = at.min(0), at.max(0)
        x, y = (high - low)[:2]
        if area[same].sum() > 0.85 * x * y and (best is None or x * y > best[1] * best[2]):
            middle = (low + high) / 2
            best = SE3.from_xyz(float(middle[0]), float(middle[1]), float(z)), float(x), float(y)
    return best


def place_candidates(
    item: CollisionObject,
    support: CollisionObject,
    at: tuple[float, float] | None = None,
    step: float = 0.02,
    other_sides: bool = False,
) -> list[Placement]:
    """A 3 x 3 grid around a point of the support, then places all over it; the object turned to the support's
    axes or as it is. It stands on the side it is nearest to standing on.

    A foot may reach over the edge of what has no walls, if the centre of mass is over what is left of it.

    Args:
        item: the object at its present pose.
        at: point on the surface [m] from its centre; the centre by default, and then all over the surface.
        step: grid spacing [m].
        other_sides: also lay the object on its other sides, after the present one.
    Raises:
        InputError: no flat surface, the object does not fit on it, or does not stand on any side.
    """
    frame, size_x, size_y = support_surface(support)
    cx, cy = at or (0.0, 0.0)
    if abs(cx) > size_x / 2 or abs(cy) > size_y / 2:
        raise InputError(
            f"place {at} m is beside {support.name!r}: {size_x:.2f} x {size_y:.2f} m from its centre on"
        )
    open_edges = _highest(support) < frame.translation[2] + 1e-3
    now = resting_now(item)
    if now is None:
        raise InputError(f"object {item.name!r} does not stand on any side", cure="give it a flat side")
    sides = [now]
    if other_sides:
        sides += [r for r in rests(item) if r is not now and r.margin >= STABILITY_MARGIN]
    places = [(cx + dx, cy + dy, float(np.hypot(dx, dy)) * 10, dx == dy == 0)
              for dx in (0.0, -step, step) for dy in (0.0, -step, step)]  # fmt: skip
    if at is None:  # and all over it, evenly (two irrational steps)
        k = np.arange(1, FREE_PLACES + 1)
        spread = np.stack([k * 0.7548776662466927 % 1 - 0.5, k * 0.5698402909980532 % 1 - 0.5], 1)
        places += [(x * size_x, y * size_y, 2.0 + np.hypot(x, y), False) for x, y in spread.tolist()]
    found = []
    for n, side in enumerate(sides):
        found += _on_side(item, side, n, frame, (size_x, size_y), places, open_edges)
    if not found:
        raise InputError(
            f"object {item.name!r} does not fit on {support.name!r}: "
            f"its surface is {size_x * 1000:.0f} x {size_y * 1000:.0f} mm"
        )
    found.sort(key=lambda p: -p.score)
    return found


def _highest(support: CollisionObject) -> float:
    """Height of a support's highest point [m]."""
    up = support.T_world_object.rotation.matrix[2]
    tops = [extent(s, T.rotation.matrix.T @ up)[1] + float(T.translation @ up) for s, T in support.shapes]
    return max(tops) + float(support.T_world_object.translation[2])


def _on_side(
    item: CollisionObject,
    side: Rest,
    number: int,
    frame: SE3,
    size: tuple[float, float],
    places: list[tuple[float, float, float, bool]],
    open_edges: bool,
) -> list[Placement]:
    """Placements on one side of the object, at places (x, y, cost, is the middle) of the support."""
    upright = SO3.between(side.up, (0.0, 0.0, 1.0))
    surface = surface_of(item)
    corners = surface.triangles.reshape(-1, 3) if len(surface.triangles) else surface.points
    yaw_now = _yaw(item.T_world_object.rotation, upright)
    yaw_frame = _yaw(frame.rotation, SO3.identity())
    quarter = [yaw_frame + k * np.pi / 2 for k in range(4)]
    quarter.sort(key=lambda yaw: abs(_wrap(yaw - yaw_now)))
    half = np.asarray(size) / 2 - STABILITY_MARGIN
    found = []
    for i, yaw in enumerate([*quarter, yaw_now]):
        R = SO3.exp((0.0, 0.0, yaw)) @ upright
        turned = (frame.rotation.inv() @ R).matrix
        whole = (corners @ turned.T)[:, :2]
        low, high = whole.min(0), whole.max(0)
        middle, foot = (low + high) / 2, (high - low) / 2
        for x, y, cost, central in places:
            if np.any(np.abs((x, y)) + foot > half):
                stands = (side.foot @ turned.T)[:, :2] - middle + (x, y)
                mass = (turned @ surface.centre_of_mass)[:2] - middle + (x, y)
                if not (open_edges and central and _stands_on(stands, mass, half, side.margin)):
                    continue
            # The whole's middle goes to (x, y), wherever in the object its origin is.
            origin = np.array([x - middle[0], y - middle[1], side.height])
            score = -cost - 0.1 * i - 10.0 * number - (ROLLS if side.margin < 1e-3 else 0.0)
            found.append(
                Placement(
                    f"({x * 1000:+.0f}, {y * 1000:+.0f}) mm, {np.rad2deg(yaw):.0f} deg"
                    + (f", side {number}" if number else ""),
                    SE3(R, frame.apply(origin)),
                    score,
                )
            )
    return found


def _stands_on(foot: Array, mass: Array, half: Array, whole: float) -> bool:
    """Whether a centre of mass (2,) is well over the part of a foot (n, 2) that is on a rectangle.

    Args:
        whole: [m] margin on the whole foot, of which a share must be left.
    """
    for axis in range(2):
        for sign in (1.0, -1.0):
            foot = _clipped(foot, axis, sign, float(half[axis]))
            if len(foot) < 3:
                return False
    flat = np.column_stack([foot, np.zeros(len(foot))])
    up = np.array([0.0, 0.0, 1.0])
    return margin_of(polygon(flat, up), up, np.array([*mass, 0.0])) >= max(STABILITY_MARGIN, OVERHANG * whole)


def _clipped(ring: Array, axis: int, sign: float, limit: float) -> Array:
    """The part of a convex polygon (n, 2) with sign * coordinate <= limit (Sutherland and Hodgman)."""
    kept = []
    for a, b in zip(ring, np.roll(ring, -1, axis=0), strict=True):
        in_a, in_b = limit - sign * a[axis], limit - sign * b[axis]
        if in_a >= 0:
            kept.append(a)
        if (in_a >= 0) != (in_b >= 0):
            kept.append(a + (b - a) * in_a / (in_a - in_b))
    return np.array(kept).reshape(-1, 2)


def _yaw(R: SO3, upright: SO3) -> float:
    """Rotation about world z that is left when the upright turn is taken off."""
    return float((R @ upright.inv()).rpy[2])


def _wrap(angle: float) -> float:
    return float((angle + np.pi) % (2 * np.pi) - np.pi)
