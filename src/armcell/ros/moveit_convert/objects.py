"""Conversion of shapes and collision objects from and to shape_msgs and moveit_msgs/CollisionObject.

Shapes are shape_msgs/SolidPrimitive, Mesh and Plane. Both sides use full lengths, not half-lengths.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armcell.core import (
    SE3,
    SO3,
    InputError,
    Mesh,
    Plane,
    Shape,
    ShapeKind,
    SolidPrimitive,
    shape_kind,
    shapes,
    simpler_parts,
)
from armcell.ros.convert import pose_from_message, pose_message
from armcell.ros.schema import Schema
from armcell.scene import WORLD, CollisionObject, ObjectType

PRISM = 5  # shape_msgs/SolidPrimitive's type of a prism, only in ROS 2; armcell makes it a mesh


def _primitives() -> dict[int, tuple[str, ShapeKind | None, SolidPrimitive]]:
    """Return the shapes that shape_msgs/SolidPrimitive can describe, by type number. Each entry has the
    shape's name, its row of the shape table (None for a prism) and the order of its dimensions.
    """
    return _primitives_of(tuple(shapes.imported()))


@lru_cache(maxsize=2)
def _primitives_of(names: tuple[str, ...]) -> dict[int, tuple[str, ShapeKind | None, SolidPrimitive]]:
    found: dict[int, tuple[str, ShapeKind | None, SolidPrimitive]] = {
        PRISM: ("prism", None, SolidPrimitive(PRISM, ("height",)))
    }
    for name in names:
        if (primitive := shapes[name].primitive) is not None:
            found[primitive.type] = name, shapes[name], primitive
    return found


def primitive_type(name: str) -> int:
    """Return the type number that shape_msgs/SolidPrimitive assigns to a shape name such as "box"."""
    return next(number for number, (known, _, _) in _primitives().items() if known == name)


def primitive_shape(message: Any) -> Shape:
    """Convert a shape_msgs/SolidPrimitive message to a box, sphere, cylinder or cone of armcell.

    Raises:
        InputError: the type is unknown, dimensions are missing, or a dimension is not positive.
    """
    number, sizes, known = int(message.type), [float(v) for v in message.dimensions], _primitives()
    if number not in known:
        names = ", ".join(f"{number} {name}" for number, (name, _, _) in sorted(known.items()))
        raise InputError(f"solid primitive of type {number}", hint=names)
    name, kind, primitive = known[number]
    if len(sizes) < len(primitive.dimensions):
        need = len(primitive.dimensions)
        raise InputError(f"a {name} has {len(sizes)} dimensions, it needs {need}")
    if kind is None:
        return prism(np.array([(p.x, p.y) for p in message.polygon.points]).reshape(-1, 2), sizes[0])
    by_name = dict(zip(primitive.dimensions, sizes, strict=False))
    return kind.make(*(by_name[size] for size in kind.sizes))


def prism(base: NDArray[np.float64], height: float) -> Mesh:
    """Convert a shape_msgs prism to a mesh. The polygon is extruded by half of `height` in both directions.

    Args:
        base: corners (n, 2) [m] of a polygon without holes.
        height: total height [m].
    Raises:
        InputError: the polygon has fewer than three corners, no area or crossing edges, or the height is not
            positive.
    """
    if len(base) < 3 or not np.all(np.isfinite(base)) or not (np.isfinite(height) and height > 0):
        raise InputError(f"a prism has {len(base)} corners and height {height:g} m", hint="3 corners or more")
    if _area(base) < 0:
        base = base[::-1]
    n, half = len(base), np.full((len(base), 1), height / 2)
    caps = _triangles(base)
    sides = [
        face for i in range(n) for j in [(i + 1) % n] for face in ([i, j, n + j], [i, n + j, n + i])
    ]  # fmt: skip
    faces = [*caps[:, ::-1].tolist(), *(caps + n).tolist(), *sides]
    vertices = np.vstack([np.hstack([base, -half]), np.hstack([base, half])])
    return Mesh(vertices, np.array(faces, dtype=np.int32))


def _area(corners: NDArray[np.float64]) -> float:
    """Return the signed area [m^2] of the base polygon (n, 2) of a shape_msgs prism. The area is positive if
    the corners are counterclockwise.
    """
    (x, y), (u, v) = corners.T, np.roll(corners, -1, axis=0).T
    return float(np.sum(x * v - u * y)) / 2


def _triangles(base: NDArray[np.float64]) -> NDArray[np.int64]:
    """Triangulate the base polygon (n, 2) of a shape_msgs prism into n - 2 triangles by ear clipping. The
    corners must be counterclockwise.

    Source: Meisters 1975.
    """
    left, found = list(range(len(base))), []
    while len(left) > 3:
        for k in range(len(left)):
            ear = [left[k - 1], left[k], left[(k + 1) % len(left)]]
            others = [i for i in left if i not in ear]
            if _area(base[ear]) > 0 and not any(_inside(base[i], base[ear]) for i in others):
                found.append(ear)
                del left[k]
                break
        else:
            raise InputError("the edges of a prism's polygon cross, or it has no area")
    if _area(base[left]) <= 0:
        raise InputError("a prism's polygon has no area")
    return np.array([*found, left])


def _inside(point: NDArray[np.float64], triangle: NDArray[np.float64]) -> bool:
    return all(_area(np.array([triangle[i - 1], triangle[i], point])) >= 0 for i in range(3))


def mesh_shape(message: Any) -> Mesh:
    """Convert a shape_msgs/Mesh message to a mesh shape.

    Raises:
        InputError: the mesh has no triangles, or a triangle refers to a vertex that does not exist.
    """
    vertices = np.array([(v.x, v.y, v.z) for v in message.vertices], dtype=float).reshape(-1, 3)
    faces = np.array([list(t.vertex_indices) for t in message.triangles], dtype=np.int64).reshape(-1, 3)
    return Mesh(vertices, faces.astype(np.int32))


def plane_pose(message: Any) -> SE3:
    """Return the pose at which armcell's plane shape represents the shape_msgs/Plane a x + b y + c z + d = 0.

    In armcell, the z axis of the plane's frame is the normal, and the half-space below z = 0 is solid.

    Raises:
        InputError: the normal has length zero.
    """
    a, b, c, d = (float(v) for v in message.coef)
    normal = np.array([a, b, c])
    length = float(np.linalg.norm(normal))
    if not np.isfinite(length) or length < 1e-9 or not np.isfinite(d):
        raise InputError(f"a plane has coefficients {[a, b, c, d]}, its normal needs a length")
    normal /= length
    return SE3(SO3.between(np.array([0.0, 0.0, 1.0]), normal), -d / length * normal)


class ShapeMessages:
    """Shapes of a collision object or a bounding volume as shape_msgs messages, with their poses.

    `add` appends one shape at a time.
    """

    def __init__(self, schema: Schema):
        self._schema = schema
        self.primitives: list[tuple[Any, SE3]] = []
        self.meshes: list[tuple[Any, SE3]] = []
        self.planes: list[tuple[Any, SE3]] = []

    def add(self, shape: Shape, T: SE3) -> None:
        """Convert a shape at pose T to shape_msgs messages, and add them to the lists of messages and poses
        for an object. A capsule becomes a cylinder and two spheres.

        Point clouds and octrees are omitted, because these lists cannot represent them.
        """
        for part, T_part in simpler_parts(shape, T):
            kind = shape_kind(part)
            if kind is not None and kind.primitive is not None:
                sizes = dict(zip(kind.sizes, kind.values(part), strict=True))
                self._primitive(kind.primitive, sizes, T_part)
            elif isinstance(part, Plane):
                coefficients = np.array([0.0, 0.0, 1.0, 0.0])
                self.planes.append((self._schema.new("shape_msgs/Plane", coef=coefficients), T_part))
            elif isinstance(part, Mesh):
                self.meshes.append((self._mesh(part), T_part))

    def _primitive(self, primitive: SolidPrimitive, sizes: dict[str, float], T: SE3) -> None:
        dimensions = np.array([sizes[name] for name in primitive.dimensions], dtype=float)
        new = self._schema.new("shape_msgs/SolidPrimitive", type=primitive.type, dimensions=dimensions)
        self.primitives.append((new, T))

    def _mesh(self, shape: Mesh) -> Any:
        Point = self._schema.message("geometry_msgs/Point")
        Triangle = self._schema.message("shape_msgs/MeshTriangle")
        return self._schema.new(
            "shape_msgs/Mesh",
            triangles=[Triangle(vertex_indices=f.astype(np.uint32)) for f in shape.faces],
            vertices=[Point(*v) for v in shape.vertices.tolist()],
        )


ADD, REMOVE, APPEND, MOVE = 0, 1, 2, 3  # moveit_msgs/CollisionObject


def frame_of(header: Any) -> str:
    """Return the frame in the header of a CollisionObject or another MoveIt message, without a leading slash.
    An empty name stands for the world frame.
    """
    return header.frame_id.lstrip("/") or WORLD


def shapes_from_message(message: Any) -> tuple[tuple[Shape, SE3], ...]:
    """Convert the shapes in a CollisionObject or BoundingVolume message to pairs (shape, T_object_shape).

    A shape without a pose is at the origin, as in MoveIt.

    Raises:
        InputError: a shape is invalid, or the message has more poses than shapes.
    """
    found: list[tuple[Shape, SE3]] = []

    def each(kind: str, items: Any, poses: Any) -> list[tuple[Any, SE3]]:
        if len(poses) > len(items):
            raise InputError(f"{len(poses)} {kind} poses for {len(items)} shapes")
        placed = [pose_from_message(p) for p in poses]
        placed += [SE3.identity() for _ in items[len(placed) :]]
        return list(zip(items, placed))

    for item, T in each("primitive", message.primitives, message.primitive_poses):
        found.append((primitive_shape(item), T))
    for item, T in each("mesh", message.meshes, message.mesh_poses):
        found.append((mesh_shape(item), T))
    if hasattr(message, "planes"):
        for item, T in each("plane", message.planes, message.plane_poses):
            found.append((Plane(), T @ plane_pose(item)))
    return tuple(found)


def object_from_message(message: Any, like: CollisionObject | None = None) -> CollisionObject:
    """Convert a moveit_msgs/CollisionObject message to a collision object of the planning scene.

    If the object has one shape and no pose, the pose of the shape becomes the pose of the object, as in
    MoveIt.

    Args:
        message: the CollisionObject message.
        like: a known object with this name; its mass, friction and color are kept.
    Raises:
        InputError: the object has no name or no shape, or a shape is invalid.
    """
    shapes, T = shapes_from_message(message), pose_from_message(message.pose)
    if not shapes:
        raise InputError(f"object {message.id!r} has no shape")
    if len(shapes) == 1 and _is_unset(message.pose):
        T, shapes = shapes[0][1], ((shapes[0][0], SE3.identity()),)
    subframes = {
        name: pose_from_message(pose) for name, pose in zip(message.subframe_names, message.subframe_poses)
    }
    kind = ObjectType(message.type.key, message.type.db)
    if like is None:
        return CollisionObject(message.id, shapes, T, subframes=subframes, type=kind)
    return replace(like, shapes=shapes, T_world_object=T, subframes=subframes, type=kind)


def object_message(schema: Schema, header: Any, item: CollisionObject, operation: int = ADD) -> Any:
    """Convert a collision object of the planning scene to a moveit_msgs/CollisionObject message in the world
    frame.

    Point clouds and octrees are omitted; an object that consists only of these has no shapes in its message.

    Args:
        schema: the message types.
        header: header that names the world frame.
        item: the object.
        operation: ADD, REMOVE, APPEND or MOVE.
    """
    lists = ShapeMessages(schema)
    for shape, T in item.shapes:
        lists.add(shape, T)
    poses = lambda pairs: [pose_message(schema, T) for _, T in pairs]  # noqa: E731
    return schema.new(
        "moveit_msgs/CollisionObject",
        header=header,
        pose=pose_message(schema, item.T_world_object),
        id=item.name,
        type=schema.new("object_recognition_msgs/ObjectType", key=item.type.key, db=item.type.db),
        primitives=[m for m, _ in lists.primitives],
        primitive_poses=poses(lists.primitives),
        meshes=[m for m, _ in lists.meshes],
        mesh_poses=poses(lists.meshes),
        planes=[m for m, _ in lists.planes],
        plane_poses=poses(lists.planes),
        subframe_names=list(item.subframes),
        subframe_poses=[pose_message(schema, T) for T in item.subframes.values()],
        operation=operation,
    )


def _is_unset(pose: Any) -> bool:
    p, r = pose.position, pose.orientation
    return not (p.x or p.y or p.z or r.x or r.y or r.z) and r.w in (0.0, 1.0)
