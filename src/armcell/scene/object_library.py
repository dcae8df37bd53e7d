"""A library of everyday objects made of simple solids, with adjustable sizes.

The origin of each object's frame is at the center of its footprint, with z up, so the object's pose is the
pose of the surface point below it. The solids of one object do not overlap, so volumes and inertias are
exact.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from armcell.core import SE3, Box, Cylinder, InputError, Mesh, Registry, Shape
from armcell.core.checks import checked
from armcell.scene.objects import CollisionObject, Color, Material

Solids = tuple[tuple[Shape, SE3], ...]
WALL_PIECES = 16  # number of flat segments of a mug's round wall


@dataclass(frozen=True)
@checked()
class ObjectKind:
    """A type of everyday object in the object library, with a function that creates it from sizes,
    density, friction and color.
    """

    solids: Callable[..., Solids]
    density: float  # [kg/m^3] mean density of the solids, including the content of a full can
    friction: float
    color: Color

    @property
    def sizes(self) -> dict[str, float]:
        """Return the adjustable sizes of an object of the library, by name, with their default values [m]."""
        return {p.name: float(p.default) for p in inspect.signature(self.solids).parameters.values()}


library: Registry[ObjectKind] = Registry("library object", "armcell.objects")


def object_names() -> list[str]:
    """Return the names of the objects in the library of everyday objects."""
    return list(library)


def library_object(
    kind: str,
    name: str | None = None,
    pose: SE3 | None = None,
    movable: bool = True,
    scale: float = 1.0,
    sizes: dict[str, float] | None = None,
    **properties,
) -> CollisionObject:
    """Create an everyday object from the object library.

    Args:
        kind: name of the library object, see `object_names()`.
        name: name in the scene; by default `kind`.
        pose: T_world_object of the center of the object's footprint.
        movable: whether the object can be moved.
        scale: factor for all sizes.
        sizes: values for some of `library[kind].sizes` [m], before scaling.
        properties: fields of `CollisionObject` that replace the library's values (mass, material, color,
            ...).
    Raises:
        UnknownNameError: the library has no such kind.
        InputError: the kind has no such size, or the sizes are not possible.
    """
    made = library[kind]
    wanted = {**made.sizes, **(sizes or {})}
    if unknown := sorted(set(wanted) - set(made.sizes)):
        raise InputError(f"a {kind} has no size {unknown[0]!r}; it has: {', '.join(made.sizes)}")
    for key, value in wanted.items():
        if not (np.isfinite(value) and value > 0 and np.isfinite(scale) and scale > 0):
            raise InputError(f"{kind}: {key} is {value:g} times {scale:g}, it must be positive")
    try:
        solids = made.solids(**{key: value * scale for key, value in wanted.items()})
    except InputError as error:
        raise InputError(f"{kind}: these sizes do not fit together: {error.reason}") from None
    item = CollisionObject(name or kind, solids, pose or SE3.identity())
    given = {
        "mass": made.density * item.volume,
        "material": Material(made.friction),
        "color": made.color,
        **properties,
    }
    return CollisionObject(item.name, solids, item.T_world_object, movable=movable, **given)


def _kind(name: str, density: float, friction: float, color: Color):
    def add(solids: Callable[..., Solids]) -> Callable[..., Solids]:
        library.register(name)(ObjectKind(solids, density, friction, color))
        return solids

    return add


def _at(x: float, y: float, z: float) -> SE3:
    return SE3.from_xyz(x, y, z)


@_kind("box", 300.0, 0.5, (0.78, 0.62, 0.42, 1.0))  # a filled carton
def _box(length: float = 0.06, width: float = 0.04, height: float = 0.09) -> Solids:
    return ((Box(length, width, height), _at(0, 0, height / 2)),)


@_kind("can", 900.0, 0.4, (0.80, 0.25, 0.22, 1.0))  # a full beverage can
def _can(radius: float = 0.033, height: float = 0.115) -> Solids:
    return ((Cylinder(radius, height), _at(0, 0, height / 2)),)


@_kind("bottle", 900.0, 0.5, (0.35, 0.60, 0.40, 1.0))
def _bottle(
    radius: float = 0.03, body: float = 0.12, shoulder: float = 0.03, neck: float = 0.012, top: float = 0.03
) -> Solids:
    if neck >= radius:
        raise InputError("the neck is not narrower than the body")
    return (
        (Cylinder(radius, body), _at(0, 0, body / 2)),
        (frustum(radius, neck, shoulder), _at(0, 0, body)),
        (Cylinder(neck, top), _at(0, 0, body + shoulder + top / 2)),
    )


@_kind("mug", 2300.0, 0.5, (0.92, 0.90, 0.84, 1.0))  # stoneware
def _mug(radius: float = 0.036, height: float = 0.085, wall: float = 0.004, handle: float = 0.03) -> Solids:
    if wall >= radius / 2 or 3 * wall >= height:
        raise InputError("the wall is too thick")
    step = 2 * np.pi / WALL_PIECES
    inner, apothem = radius - wall, radius * np.cos(step / 2)
    parts: list[tuple[Shape, SE3]] = [(Cylinder(inner * np.cos(step / 2), wall), _at(0, 0, wall / 2))]
    for k in range(WALL_PIECES):
        a, b = (k - 0.5) * step, (k + 0.5) * step
        ring = [(r * np.cos(t), r * np.sin(t)) for r, t in ((inner, a), (radius, a), (radius, b), (inner, b))]
        parts.append((prism(np.array(ring), height), SE3.identity()))
    bar, low, high = 2 * wall, 0.25 * height, 0.75 * height
    for z in (low, high):  # the handle: two horizontal bars and one vertical bar
        parts.append((Box(handle, bar, bar), _at(apothem + handle / 2, 0, z)))
    parts.append((Box(bar, bar, high - low - bar), _at(apothem + handle - bar / 2, 0, (low + high) / 2)))
    return tuple(parts)


@_kind("l_bracket", 2700.0, 0.4, (0.70, 0.72, 0.75, 1.0))  # aluminum
def _l_bracket(
    length: float = 0.06, width: float = 0.04, height: float = 0.06, thickness: float = 0.006
) -> Solids:
    upright = height - thickness
    return (
        (Box(length, width, thickness), _at(0, 0, thickness / 2)),
        (Box(thickness, width, upright), _at((thickness - length) / 2, 0, thickness + upright / 2)),
    )


@_kind("rod", 700.0, 0.5, (0.70, 0.52, 0.33, 1.0))  # wood; horizontal along x
def _rod(radius: float = 0.012, length: float = 0.2) -> Solids:
    return ((Cylinder(radius, length), SE3.from_xyz_rpy((0, 0, radius), (0, np.pi / 2, 0))),)


@_kind("bolt", 7850.0, 0.35, (0.55, 0.56, 0.60, 1.0))  # steel, M16; upright, head down
def _bolt(
    across_flats: float = 0.024, head: float = 0.010, shank: float = 0.008, length: float = 0.06
) -> Solids:
    corners = across_flats / np.sqrt(3) * np.exp(1j * np.pi / 3 * np.arange(6))
    return (
        (prism(np.stack([corners.real, corners.imag], 1), head), SE3.identity()),
        (Cylinder(shank, length), _at(0, 0, head + length / 2)),
    )


@_kind("tray", 600.0, 0.5, (0.30, 0.55, 0.40, 1.0))
def _tray(length: float = 0.26, width: float = 0.26, height: float = 0.04, wall: float = 0.008) -> Solids:
    return _open_box(length, width, height, wall)


@_kind("bin", 600.0, 0.5, (0.35, 0.45, 0.60, 1.0))
def _bin(length: float = 0.36, width: float = 0.26, height: float = 0.12, wall: float = 0.008) -> Solids:
    return _open_box(length, width, height, wall)


def _open_box(length: float, width: float, height: float, wall: float) -> Solids:
    side, z = height - wall, wall + (height - wall) / 2
    return (
        (Box(length, width, wall), _at(0, 0, wall / 2)),
        (Box(length, wall, side), _at(0, (width - wall) / 2, z)),
        (Box(length, wall, side), _at(0, (wall - width) / 2, z)),
        (Box(wall, width - 2 * wall, side), _at((length - wall) / 2, 0, z)),
        (Box(wall, width - 2 * wall, side), _at((wall - length) / 2, 0, z)),
    )


# --- convex meshes ---
def prism(outline: np.ndarray, height: float) -> Mesh:
    """Return a closed mesh of a prism with a convex outline, from z = 0 up to a height [m], for objects of
    the library.

    Args:
        outline: corners (n, 2) [m], counterclockwise.
        height: [m].
    Raises:
        InputError: the height is not positive.
    """
    n = len(outline)
    if height <= 0:
        raise InputError(f"a prism has height {height:g} m, it must be positive")
    return _rings(np.column_stack([outline, np.zeros(n)]), np.column_stack([outline, np.full(n, height)]))


def frustum(low: float, high: float, height: float, edges: int = 32) -> Mesh:
    """Return a conical frustum as a closed mesh, for the object library. Its radius at z = 0 is `low` [m].

    The radius at `height` [m] is `high` [m].
    """
    t = 2 * np.pi * np.arange(edges) / edges
    circle = np.column_stack([np.cos(t), np.sin(t)])
    bottom = np.column_stack([low * circle, np.zeros(edges)])
    return _rings(bottom, np.column_stack([high * circle, np.full(edges, height)]))


def _rings(bottom: np.ndarray, top: np.ndarray) -> Mesh:
    n = len(bottom)
    i, j = np.arange(n), (np.arange(n) + 1) % n
    sides = np.vstack([np.stack([i, j, n + j], 1), np.stack([i, n + j, n + i], 1)])
    k = np.arange(1, n - 1)
    caps = np.vstack([np.stack([0 * k, k + 1, k], 1), np.stack([0 * k + n, n + k, n + k + 1], 1)])
    return Mesh(np.vstack([bottom, top]), np.vstack([sides, caps]).astype(np.int32))
