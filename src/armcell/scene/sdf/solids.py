"""Conversion of SDF collisions, visuals, surfaces and inertials to shapes and materials.

The results are shapes, materials, colors and masses.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from armcell.core import SE3, SO3, Format, InputError, Mesh, Plane, Shape, ShapeKind, named_shapes
from armcell.model.assets import load_mesh
from armcell.scene.objects import Color, Material, shape_volume
from armcell.scene.sdf.elements import (
    Element,
    SkippedElement,
    child,
    children,
    fail,
    file_of,
    local_child,
    number,
    numbers,
    skipped,
    text_of,
    vector,
)
from armcell.scene.sdf.includes import ResourceFinder

DEFAULT_MASS = 1.0  # [kg] of a link without <inertial>; SDF's default
WATER = 1000.0  # [kg/m^3]; SDF's default density for inertials that are computed
GAZEBO_COLORS: dict[str, Color] = {
    "Black": (0.0, 0.0, 0.0, 1.0), "Blue": (0.0, 0.0, 1.0, 1.0), "Bricks": (0.6, 0.35, 0.3, 1.0),
    "DarkGrey": (0.175, 0.175, 0.175, 1.0), "DarkYellow": (0.7, 0.7, 0.0, 1.0), "Gold": (0.8, 0.7, 0.1, 1.0),
    "Green": (0.0, 1.0, 0.0, 1.0), "Grey": (0.7, 0.7, 0.7, 1.0), "Indigo": (0.33, 0.0, 0.5, 1.0),
    "Orange": (1.0, 0.51, 0.06, 1.0), "Purple": (1.0, 0.0, 1.0, 1.0), "Red": (1.0, 0.0, 0.0, 1.0),
    "Turquoise": (0.0, 1.0, 1.0, 1.0), "White": (1.0, 1.0, 1.0, 1.0), "Wood": (0.6, 0.45, 0.3, 1.0),
    "WoodFloor": (0.6, 0.45, 0.3, 1.0), "WoodPallet": (0.6, 0.45, 0.3, 1.0), "Yellow": (1.0, 1.0, 0.0, 1.0),
}  # fmt: skip
"""Diffuse colors of the materials in gazebo.material; for textured materials the main color."""


@dataclass(frozen=True)
class SdfCollision:
    """One collision element of an SDF link as a solid, with shape, pose, density and friction."""

    shape: Shape
    T_link_shape: SE3
    density: float  # [kg/m^3]
    friction: tuple[float, float] | None  # static, dynamic


def geometry_of(element: Element, library: ResourceFinder) -> tuple[Shape, SE3] | SkippedElement:
    """Convert the geometry of an SDF <collision> or <visual> element to a solid: return its shape and its
    pose in the element's frame.

    Returns:
        (shape, T_element_shape), or a `SkippedElement` note if the shape is not converted.
    Raises:
        InputError: the geometry is missing, a size is not positive, or a mesh is not found or not readable.
    """
    geometry = child(element, "geometry")
    shapes = [] if geometry is None else [entry for entry in geometry if isinstance(entry.tag, str)]
    if not shapes:
        raise fail(element, "has no <geometry>")
    shape = shapes[0]
    read = _READERS.get(shape.tag)
    if read is None:
        return skipped(element, f"shape <{shape.tag}> is not converted")
    try:
        return read(shape, library)
    except InputError as error:
        if error.line is not None:
            raise
        raise fail(shape, str(error), None) from None


def _plane(element: Element, library: ResourceFinder) -> tuple[Shape, SE3]:
    normal = np.asarray(vector(element, "normal", 3, "0 0 1"))
    length = float(np.linalg.norm(normal))
    if length < 1e-9:
        raise fail(element, "the plane's normal has length 0")
    return Plane(), SE3(SO3.between((0.0, 0.0, 1.0), normal / length), np.zeros(3))


def _ellipsoid(element: Element, library: ResourceFinder) -> tuple[Shape, SE3]:
    import trimesh

    radii = np.asarray(vector(element, "radii", 3))
    if not np.all(radii > 0):
        raise fail(element, f"radii {radii.tolist()} must be positive")
    ball = trimesh.creation.icosphere(subdivisions=3)
    return Mesh(np.asarray(ball.vertices) * radii, np.asarray(ball.faces, np.int32)), SE3.identity()


def _mesh(element: Element, library: ResourceFinder) -> tuple[Shape, SE3] | SkippedElement:
    if child(element, "submesh") is not None:
        return skipped(element, "a submesh is not converted: export it as a file of its own")
    sx, sy, sz = vector(element, "scale", 3, "1 1 1")
    if 0.0 in (sx, sy, sz):
        raise fail(element, "mesh scale has a zero")
    uri = child(element, "uri")
    base = file_of(element).parent
    file = library.find(text_of(element, "uri"), base, element if uri is None else uri)
    return load_mesh(file, (sx, sy, sz)), SE3.identity()


def _sized(kind: ShapeKind) -> Callable[[Element, ResourceFinder], tuple[Shape, SE3]]:
    def read(element: Element, library: ResourceFinder) -> tuple[Shape, SE3]:
        shape = kind.from_named(
            lambda key: number(element, key), lambda key, count: vector(element, key, count)
        )
        return shape, SE3.identity()

    return read


_READERS: dict[str, Callable[[Element, ResourceFinder], tuple[Shape, SE3] | SkippedElement]] = {
    **{name: _sized(kind) for name, kind in named_shapes(Format.SDF).items()},
    "ellipsoid": _ellipsoid,
    "plane": _plane,
    "mesh": _mesh,
}


def friction_of(collision: Element) -> tuple[tuple[float, float] | None, SkippedElement | None]:
    """Return the friction (static, dynamic) of the solid in an SDF <collision> element, and a note on
    approximations.

    SDF has one coefficient per direction (ODE's mu and mu2, or Bullet's); armcell uses the smaller one.
    Drake's extension has a static and a dynamic coefficient.

    Returns:
        (static, dynamic) or None if the surface has no friction; the note or None.
    Raises:
        InputError: a coefficient is negative or not a number.
    """
    proximity = local_child(collision, "proximity_properties")
    if proximity is not None:
        mu = [local_child(proximity, name) for name in ("mu_static", "mu_dynamic")]
        given = [_coefficient(e) for e in mu if e is not None]
        if given:
            return (max(given[0], given[-1]), given[-1]), None
    for engine, first, second in (("ode", "mu", "mu2"), ("bullet", "friction", "friction2")):
        block = child(collision, f"surface/friction/{engine}")
        found = [child(block, tag) for tag in (first, second)] if block is not None else []
        given = [_coefficient(e) for e in found if e is not None]
        if given:
            note = None
            if max(given) != min(given) and block is not None:
                note = skipped(block, f"{first} and {second} differ: the smaller counts in all directions")
            return (min(given), min(given)), note
    return None, None


def _coefficient(element: Element) -> float:
    (value,) = numbers(element, (element.text or "").strip(), 1)
    if value < 0:
        raise fail(element, f"friction {value:g} is negative")
    return value


def material_of(solids: list[SdfCollision]) -> tuple[Material, bool]:
    """Combine the materials of the SDF solids of one object. Return the combined material, and True if the
    solids' materials differ.

    If they differ, the smallest static and dynamic friction apply.
    """
    given = {solid.friction for solid in solids if solid.friction is not None}
    if not given:
        return Material(), False
    static, dynamic = min(s for s, _ in given), min(d for _, d in given)
    return Material(static, dynamic_friction=None if dynamic == static else dynamic), len(given) > 1


def mass_of(link: Element, solids: list[SdfCollision]) -> float:
    """Return the total mass [kg] of an SDF link's solids, from the link's <inertial> element. Without this
    element, the mass is 1 kg.

    Raises:
        InputError: the mass is not positive.
    """
    inertial = child(link, "inertial")
    if inertial is None:
        return DEFAULT_MASS
    if inertial.get("auto", "false").lower() in ("true", "1"):
        density = number(inertial, "density", -1.0)
        every = ((solid.density if density < 0 else density) * shape_volume(solid.shape) for solid in solids)
        return sum(every)
    mass = number(inertial, "mass", DEFAULT_MASS)
    if mass <= 0:
        raise fail(inertial, f"mass {mass:g} kg must be positive")
    return mass


def color_of(link: Element) -> Color | None:
    """Return the color of the solids of an SDF link, which is the color of the link's first colored <visual>.
    Textures are ignored.
    """
    for visual in children(link, "visual"):
        color = _material_color(visual)
        if color is not None:
            opaque = 1.0 - float(np.clip(number(visual, "transparency", 0.0), 0.0, 1.0))
            return (*color[:3], color[3] * opaque)
    return None


def _material_color(visual: Element) -> Color | None:
    for tag in ("diffuse", "ambient"):
        found = child(visual, f"material/{tag}")
        if found is not None:
            words = (found.text or "").split()
            values = numbers(found, " ".join(words), 4 if len(words) == 4 else 3)
            r, g, b, a = np.clip([*values, 1.0][:4], 0.0, 1.0).tolist()
            return r, g, b, a
    script = child(visual, "material/script/name")
    return (
        GAZEBO_COLORS.get((script.text or "").strip().removeprefix("Gazebo/")) if script is not None else None
    )


def solid_of(
    collision: Element, T_link_collision: SE3, library: ResourceFinder
) -> tuple[SdfCollision | None, list[SkippedElement]]:
    """Convert an SDF <collision> element to a solid. The solid is None if its shape is not supported.

    Returns:
        The solid or None, and the notes about skipped or approximated content.
    """
    geometry = geometry_of(collision, library)
    if isinstance(geometry, SkippedElement):
        return None, [geometry]
    shape, T = geometry
    friction, note = friction_of(collision)
    solid = SdfCollision(shape, T_link_collision @ T, number(collision, "density", WATER), friction)
    return solid, [note] if note is not None else []
