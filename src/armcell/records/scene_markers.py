"""Markers of links, objects and contacts for the MCAP file, as messages of Foxglove's type SceneUpdate.

Foxglove's and Lichtblick's 3D panels draw them. A marker has the frame of its link or movable object, so it
is written once, and only /tf repeats. After a seek, a panel reads the last message of each topic, so each
message contains all markers of its topic.

Source of the messages: https://docs.foxglove.dev/docs/sdk/schemas (ROS 2 package foxglove_msgs).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armcell.core import SE3, Box, Cone, Contact, Cylinder, Mesh, Plane, Shape, Sphere, simpler_parts
from armcell.model import Link, RobotModel
from armcell.model.assets import DEFAULT_COLOR, visual_parts
from armcell.model.mesh_decimation import decimated
from armcell.scene import WORLD, CollisionObject

Color = tuple[float, ...]  # RGBA, 0..1
Drawn = tuple[Shape, SE3, Color]  # a shape, its pose in the frame of its marker, and its color
LINKS, OBJECTS, CONTACTS = "/robot_links", "/scene_objects", "/contact_markers"
SCENE_UPDATE = "foxglove_msgs/msg/SceneUpdate"
CONTACT_PERIOD = 0.04  # [s] between two messages of contacts
PERIOD_PER_OBJECT = 0.001  # [s] between two messages of objects, for each object in the scene
MAX_FACES = 1000
"""Maximum faces per colored part of a mesh; larger parts are decimated, to keep the file small."""
_GRID = 2.0**-14  # [m] vertices are rounded to 0.06 mm, because rounded numbers compress well
_PLANE_DRAWN, _PLANE_THICKNESS = 6.0, 0.01  # [m]
_CONTACT_DIAMETER, _CONTACT_COLOR = 0.008, (0.85, 0.1, 0.1, 1.0)

MARKER_TYPES = (
    ("foxglove_msgs/msg/Color", "float64 r\nfloat64 g\nfloat64 b\nfloat64 a"),
    ("foxglove_msgs/msg/KeyValuePair", "string key\nstring value"),
    (
        "foxglove_msgs/msg/ArrowPrimitive",
        "geometry_msgs/Pose pose\nfloat64 shaft_length\nfloat64 shaft_diameter\nfloat64 head_length\n"
        "float64 head_diameter\nfoxglove_msgs/Color color",
    ),
    (
        "foxglove_msgs/msg/CubePrimitive",
        "geometry_msgs/Pose pose\ngeometry_msgs/Vector3 size\nfoxglove_msgs/Color color",
    ),
    (
        "foxglove_msgs/msg/SpherePrimitive",
        "geometry_msgs/Pose pose\ngeometry_msgs/Vector3 size\nfoxglove_msgs/Color color",
    ),
    (
        "foxglove_msgs/msg/CylinderPrimitive",
        "geometry_msgs/Pose pose\ngeometry_msgs/Vector3 size\nfloat64 bottom_scale\nfloat64 top_scale\n"
        "foxglove_msgs/Color color",
    ),
    (
        "foxglove_msgs/msg/LinePrimitive",
        "uint8 LINE_STRIP=0\nuint8 LINE_LOOP=1\nuint8 LINE_LIST=2\nuint8 type\ngeometry_msgs/Pose pose\n"
        "float64 thickness\nbool scale_invariant\ngeometry_msgs/Point[] points\nfoxglove_msgs/Color color\n"
        "foxglove_msgs/Color[] colors\nuint32[] indices",
    ),
    (
        "foxglove_msgs/msg/TriangleListPrimitive",
        "geometry_msgs/Pose pose\ngeometry_msgs/Point[] points\nfoxglove_msgs/Color color\n"
        "foxglove_msgs/Color[] colors\nuint32[] indices",
    ),
    (
        "foxglove_msgs/msg/TextPrimitive",
        "geometry_msgs/Pose pose\nbool billboard\nfloat64 font_size\nbool scale_invariant\n"
        "foxglove_msgs/Color color\nstring text",
    ),
    (
        "foxglove_msgs/msg/ModelPrimitive",
        "geometry_msgs/Pose pose\ngeometry_msgs/Vector3 scale\nfoxglove_msgs/Color color\n"
        "bool override_color\nstring url\nstring media_type\nuint8[] data",
    ),
    (
        "foxglove_msgs/msg/SceneEntityDeletion",
        "builtin_interfaces/Time timestamp\nuint8 MATCHING_ID=0\nuint8 ALL=1\nuint8 type\nstring id",
    ),
    (
        "foxglove_msgs/msg/SceneEntity",
        "builtin_interfaces/Time timestamp\nstring frame_id\nstring id\n"
        "builtin_interfaces/Duration lifetime\nbool frame_locked\nfoxglove_msgs/KeyValuePair[] metadata\n"
        "foxglove_msgs/ArrowPrimitive[] arrows\nfoxglove_msgs/CubePrimitive[] cubes\n"
        "foxglove_msgs/SpherePrimitive[] spheres\nfoxglove_msgs/CylinderPrimitive[] cylinders\n"
        "foxglove_msgs/LinePrimitive[] lines\nfoxglove_msgs/TriangleListPrimitive[] triangles\n"
        "foxglove_msgs/TextPrimitive[] texts\nfoxglove_msgs/ModelPrimitive[] models",
    ),
    (
        SCENE_UPDATE,
        "foxglove_msgs/SceneEntityDeletion[] deletions\nfoxglove_msgs/SceneEntity[] entities",
    ),
)
"""Names and definitions of foxglove_msgs/SceneUpdate and of the messages that it contains."""

_LISTS = ("metadata", "arrows", "cubes", "spheres", "cylinders", "lines", "triangles", "texts", "models")


class SceneMarkers:
    """Markers that show the scene of a run in its MCAP file. This class creates the SceneUpdate messages that
    are due at each time.

    Args:
        types: message classes by name, with `MARKER_TYPES`.
        model: the robot; its link meshes are loaded by `links`.
        objects: scene objects at the start, by name. Point clouds and octrees are not drawn.
    """

    def __init__(self, types: Mapping[str, Any], model: RobotModel, objects: Mapping[str, CollisionObject]):
        self._types = types
        self._model = model
        self._objects = dict(objects)
        self._posed: set[str] = set()  # objects whose poses /tf contains
        self._changed = True
        self._objects_due, self._pause = -np.inf, 0.0  # [s]
        self._contacts_due = -np.inf  # [s]
        self._touching = False

    def links(self, stamp: Any) -> Any:
        """Return the message with scene markers that draw all links of the robot, each in its own frame."""
        named = ((link.name, link.name, _link_shapes(link)) for link in self._model.links.values())
        return self._update(stamp, named)

    def change(self, changes: Mapping[str, Any]) -> None:
        """Apply the data of an event of kind "scene" (`scene_changes`) to the objects that are drawn as
        markers.
        """
        new = {**changes.get("added", {}), **changes.get("changed", {})}
        moved = {n: self._objects[n].at(T) for n, T in changes.get("moved", {}).items() if n in self._objects}
        removed = [self._objects.pop(name) for name in changes.get("removed", ()) if name in self._objects]
        self._objects |= {**new, **moved}
        redrawn = [*new.values(), *removed, *(item for n, item in moved.items() if n not in self._posed)]
        self._changed |= any(not item.has_cloud for item in redrawn)

    def objects(self, stamp: Any, time: float, posed: Iterable[str]) -> Any | None:
        """Return the message with the markers of all objects, or None if nothing has changed.

        Args:
            stamp: time of the message.
            time: [s]; a scene with many objects that changes often is written at a lower rate.
            posed: names of the objects whose poses /tf contains now.
        """
        self._changed |= not self._posed.issuperset(posed)
        if not self._changed or self._objects_due - self._pause <= time < self._objects_due:
            return None
        self._changed = False
        self._posed.update(posed)
        self._pause = PERIOD_PER_OBJECT * len(self._objects)
        self._objects_due = time + self._pause
        return self._update(stamp, map(self._object, self._objects.values()))

    def _object(self, item: CollisionObject) -> tuple[str, str, list[Drawn]]:
        frame, T = (item.name, SE3.identity()) if item.name in self._posed else (WORLD, item.T_world_object)
        return item.name, frame, [(shape, T @ T_shape, item.color) for shape, T_shape in item.shapes]

    def contacts(self, stamp: Any, time: float, contacts: tuple[Contact, ...]) -> Any | None:
        """Return the message with a sphere marker at each contact, or None if it is not due at time [s]."""
        if not (contacts or self._touching):
            return None
        if contacts and self._touching and self._contacts_due - CONTACT_PERIOD <= time < self._contacts_due:
            return None
        self._touching, self._contacts_due = bool(contacts), time + CONTACT_PERIOD
        ball = Sphere(_CONTACT_DIAMETER / 2)
        drawn = [(ball, SE3.from_xyz(*c.position), _CONTACT_COLOR) for c in contacts]
        return self._update(stamp, [("contacts", WORLD, drawn)])

    def _update(self, stamp: Any, named: Iterable[tuple[str, str, Sequence[Drawn]]]) -> Any:
        """Convert scene markers (id, frame, shapes with poses in the frame and colors) to a complete
        SceneUpdate message.
        """
        clear = self._new("SceneEntityDeletion", timestamp=stamp, type=1, id="")  # all entities
        entities = [self._entity(stamp, *marker) for marker in named]
        return self._new("SceneUpdate", deletions=[clear], entities=[e for e in entities if e is not None])

    def _entity(self, stamp: Any, id: str, frame: str, shapes: Sequence[Drawn]) -> Any | None:
        lists: dict[str, list[Any]] = {name: [] for name in _LISTS}
        for shape, T, color in shapes:
            for part, T_part in simpler_parts(shape, T) if not isinstance(shape, Cone) else [(shape, T)]:
                primitive = self._primitive(part, T_part, color)
                if primitive is not None:
                    lists[primitive[0]].append(primitive[1])
        if not any(lists.values()):
            return None
        lifetime = self._types["builtin_interfaces/msg/Duration"](sec=0, nanosec=0)  # unlimited
        fixed = {"timestamp": stamp, "lifetime": lifetime, "frame_locked": True}
        return self._new("SceneEntity", frame_id=frame, id=id, **fixed, **lists)

    def _primitive(self, shape: Shape, T: SE3, color: Color) -> tuple[str, Any] | None:
        """Convert a marker's shape at pose T to the name of its list in SceneEntity and a primitive of that
        list.
        """
        tint = self._new("Color", **dict(zip("rgba", map(float, color), strict=True)))
        at: dict[str, Any] = {"pose": self._pose(T), "color": tint}
        match shape:
            case Box():
                return "cubes", self._new("CubePrimitive", size=self._size(shape.x, shape.y, shape.z), **at)
            case Plane():
                at["pose"] = self._pose(T @ SE3.from_xyz(0, 0, -_PLANE_THICKNESS / 2))
                size = self._size(_PLANE_DRAWN, _PLANE_DRAWN, _PLANE_THICKNESS)
                return "cubes", self._new("CubePrimitive", size=size, **at)
            case Sphere():
                size = self._size(*[2 * shape.radius] * 3)
                return "spheres", self._new("SpherePrimitive", size=size, **at)
            case Cylinder() | Cone():
                size = self._size(2 * shape.radius, 2 * shape.radius, shape.length)
                top = float(isinstance(shape, Cylinder))
                return "cylinders", self._new(
                    "CylinderPrimitive", size=size, bottom_scale=1.0, top_scale=top, **at
                )
            case Mesh():
                vertices, indices = _drawn(shape)
                point: Callable[..., Any] = self._types["geometry_msgs/msg/Point"]
                points = [point(*xyz) for xyz in vertices.tolist()]
                return "triangles", self._new(
                    "TriangleListPrimitive", points=points, colors=[], indices=indices, **at
                )
        return None

    def _pose(self, T: SE3) -> Any:
        xyz, quat = T.translation.tolist(), T.quat_xyzw.tolist()
        point, turn = (self._types[f"geometry_msgs/msg/{kind}"] for kind in ("Point", "Quaternion"))
        return self._types["geometry_msgs/msg/Pose"](point(*xyz), turn(*quat))

    def _size(self, x: float, y: float, z: float) -> Any:
        return self._types["geometry_msgs/msg/Vector3"](float(x), float(y), float(z))

    def _new(self, name: str, **fields: Any) -> Any:
        return self._types[f"foxglove_msgs/msg/{name}"](**fields)


@lru_cache(maxsize=256)
def _drawn(mesh: Mesh) -> tuple[NDArray[np.float64], NDArray[np.uint32]]:
    """Return the vertices (v, 3) [m] that a marker draws for a mesh, and the indices (3 f,) of its faces."""
    vertices, faces = decimated(mesh.vertices, mesh.faces, MAX_FACES)
    used, indices = np.unique(faces, return_inverse=True)
    return np.round(vertices[used] / _GRID) * _GRID, indices.ravel().astype(np.uint32)


def _link_shapes(link: Link) -> list[Drawn]:
    """Return the shapes with which a marker draws a link: its visual shapes or, without these, its collision
    shapes.
    """
    if not link.visuals:
        return [(c.shape, c.T_link_shape, DEFAULT_COLOR) for c in link.collisions]
    shapes: list[Drawn] = []
    for visual in link.visuals:
        if visual.shape is not None:
            shapes.append((visual.shape, visual.T_link_visual, visual.color or DEFAULT_COLOR))
        shapes += [(mesh, visual.T_link_visual, color) for mesh, color in visual_parts(visual)]
    return shapes
