"""A table of the shapes that sizes describe, with one row per shape, for all file formats.

Cell files, records, MoveIt's .scene files, ROS messages, URDF, SDF and Unity convert shapes by this table, so
a new shape is one row here. A package adds a shape as a function from sizes to a mesh:

    @register_shape("wedge")
    def wedge(x: float, y: float, z: float) -> tuple[ArrayLike, ArrayLike]:
        return vertices, faces

`wedge: [0.1, 0.05, 0.03]` is then valid in cell files. Planning and physics treat the shape as its mesh, and
formats that do not know it by name get the mesh. The entry point group for packages is `armcell.shapes`.

Meshes, point clouds and octrees have no row: their data are arrays or files, which each format has code for.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from armcell.core.checks import is_number
from armcell.core.errors import InputError
from armcell.core.geometry import Box, Capsule, Cone, Cylinder, Mesh, Plane, Shape, Sphere
from armcell.core.registry import Registry
from armcell.core.transforms import SE3


class Format(StrEnum):
    """File or message format that supports only some of the shapes in the shape table.

    Cell files and records are not listed, because they support all of these shapes.
    """

    SCENE_FILE = "scene_file"  # MoveIt's .scene
    URDF = "urdf"
    URDF_READ = "urdf_read"  # accepted when reading a URDF, beyond the standard
    SDF = "sdf"
    UNITY = "unity"


@dataclass(frozen=True)
class SolidPrimitive:
    """Entry of the shape table that describes a shape as shape_msgs/SolidPrimitive: its `type` and the order
    of its `dimensions`.
    """

    type: int
    dimensions: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class SizedMesh(Mesh):
    """Mesh of a custom shape in the shape table. A function registered with `register_shape` creates the mesh
    from the sizes of the shape.

    Attributes:
        name: name of the shape in the table.
        sizes: its sizes [m], in the table's order.
    """

    name: str = ""
    sizes: tuple[float, ...] = ()


@dataclass(frozen=True)
class ShapeKind:
    """Row of the shape table, which describes one kind of shape: its constructor, the names of its sizes, and
    the formats that support it.

    Attributes:
        make: the shape's class, or a function that makes the shape from its sizes.
        sizes: names of the sizes [m], in the order of lists in cell files, records and .scene files.
        formats: formats that know the shape by its name; others get its parts or its mesh.
        vector: key under which formats with named values store all sizes as one list; empty: each size is
            stored under its own name.
        primitive: the shape in shape_msgs/SolidPrimitive; None: ROS does not know it.
        parts: equivalent shapes with poses, for formats that do not know the shape.
    """

    make: Callable[..., Any]
    sizes: tuple[str, ...]
    formats: frozenset[Format] = frozenset()
    vector: str = ""
    primitive: SolidPrimitive | None = None
    parts: Callable[[Any, SE3], list[tuple[Shape, SE3]]] | None = None

    def values(self, shape: Any) -> list[float]:
        """Return the sizes [m] of a shape in the order that the shape table defines."""
        if isinstance(shape, SizedMesh):
            return list(shape.sizes)
        return [float(getattr(shape, size)) for size in self.sizes]

    def named(self, shape: Any) -> dict[str, Any]:
        """Return the sizes [m] of a shape as a dictionary with keys from the shape table, such as `radius`.
        For a shape whose sizes form a vector, the dictionary has a single key with a list of all sizes.
        """
        values = self.values(shape)
        return {self.vector: values} if self.vector else dict(zip(self.sizes, values, strict=True))

    def from_named(
        self, number: Callable[[str], float], vector: Callable[[str, int], Sequence[float]]
    ) -> Shape:
        """Create a shape of the kind that this row of the shape table describes. The callbacks `number` and
        `vector` look up the shape's sizes by name, such as `radius`.

        Args:
            number: reads one number by name.
            vector: reads a list of the given length by name.
        """
        if self.vector:
            return self.make(*vector(self.vector, len(self.sizes)))
        return self.make(*(number(size) for size in self.sizes))


shapes: Registry[ShapeKind] = Registry("shape", "armcell.shapes")
"""The table of shapes by name."""


def make_shape(name: str, sizes: Sequence[float]) -> Shape:
    """Create a shape from its name in the shape table and its sizes [m].

    Raises:
        UnknownNameError: the table has no such shape.
        InputError: the number of sizes is wrong, or a size is not positive.
    """
    kind = shapes[name]
    if len(sizes) != len(kind.sizes):
        need = ", ".join(kind.sizes) or "none"
        raise InputError(f"{name} has {len(sizes)} sizes, it needs {len(kind.sizes)} ({need})")
    return kind.make(*sizes)


def shape_name(shape: Shape) -> str:
    """Return the name that the shape table uses for a shape.

    Meshes and clouds have no row; the result is their class name in lower case.
    """
    return shape.name if isinstance(shape, SizedMesh) else type(shape).__name__.lower()


def shape_kind(shape: Shape, format: Format | None = None) -> ShapeKind | None:
    """Return the row of the shape table that describes a shape, or None if there is no such row.

    The result is None for meshes and clouds, and if `format` does not know the shape by name.
    """
    kind = shapes.imported().get(shape_name(shape))
    return kind if kind is None or format is None or format in kind.formats else None


def simpler_parts(shape: Shape, T: SE3) -> list[tuple[Shape, SE3]]:
    """Return simpler shapes, each with its pose, that together replace a shape at pose T. If the shape table
    defines no parts for the shape, return the shape itself.

    The result is for formats that do not know the shape.
    """
    kind = shape_kind(shape)
    return [(shape, T)] if kind is None or kind.parts is None else kind.parts(shape, T)


def named_shapes(format: Format) -> Mapping[str, ShapeKind]:
    """Return the kinds of shapes that a file or message format supports, as a dict by shape name."""
    return {name: kind for name, kind in shapes.imported().items() if format in kind.formats}


MeshFunction = Callable[..., tuple[ArrayLike, ArrayLike]]


def register_shape(name: str) -> Callable[[MeshFunction], MeshFunction]:
    """Return a decorator that adds a new kind of shape to the shape table. The decorated function creates the
    mesh of the shape.

    The function takes the sizes [m] of the shape and returns vertices (v, 3) and faces (f, 3).

    The names of the function's parameters are the names of the sizes. The mesh should be closed, with
    outward normals, and centered on its own frame.
    """

    def add(function: MeshFunction) -> MeshFunction:
        names = tuple(inspect.signature(function).parameters)

        def make(*sizes: float) -> SizedMesh:
            for size, value in zip(names, sizes, strict=True):
                if not is_number(value) or value <= 0:
                    raise InputError(f"{name} has {size} {value!r}, it must be a positive number of meters")
            vertices, faces = function(*sizes)
            return SizedMesh(
                np.asarray(vertices, float), np.asarray(faces), None, name, tuple(map(float, sizes))
            )

        shapes.register(name)(ShapeKind(make, names))
        return function

    return add


# --- the rows ---
def _capsule_parts(capsule: Capsule, T: SE3) -> list[tuple[Shape, SE3]]:
    ball = Sphere(capsule.radius)
    ends = [T @ SE3.from_xyz(0.0, 0.0, end) for end in (-capsule.length / 2, capsule.length / 2)]
    return [(Cylinder(capsule.radius, capsule.length), T), *((ball, end) for end in ends)]


_ROUND = ("radius", "length")
_EVERYWHERE = frozenset(Format)

shapes.register("box")(
    ShapeKind(Box, ("x", "y", "z"), _EVERYWHERE, "size", SolidPrimitive(1, ("x", "y", "z")))
)
shapes.register("sphere")(
    ShapeKind(Sphere, ("radius",), _EVERYWHERE, primitive=SolidPrimitive(2, ("radius",)))
)
shapes.register("cylinder")(
    ShapeKind(Cylinder, _ROUND, _EVERYWHERE, primitive=SolidPrimitive(3, ("length", "radius")))
)
shapes.register("capsule")(
    ShapeKind(Capsule, _ROUND, frozenset({Format.URDF_READ, Format.SDF, Format.UNITY}), parts=_capsule_parts)
)
shapes.register("cone")(
    ShapeKind(
        Cone,
        _ROUND,
        frozenset({Format.SCENE_FILE, Format.SDF, Format.UNITY}),
        primitive=SolidPrimitive(4, ("length", "radius")),
    )
)
shapes.register("plane")(ShapeKind(Plane, (), frozenset({Format.UNITY})))
