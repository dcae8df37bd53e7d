"""Collision objects: shapes, pose, mass, inertia, friction, and obstacles with a known motion.

Center of mass and inertia of solid objects serve physics and payloads. Obstacles with a known motion
are, for example, a box on a conveyor, a door or another arm's load.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from armcell.core import (
    SE3,
    Box,
    Capsule,
    Cone,
    Cylinder,
    InputError,
    Mesh,
    Octree,
    Plane,
    PointCloud,
    Shape,
    Sphere,
    is_closed,
)
from armcell.core.checks import checked, float_array
from armcell.core.geometry import extent, local_bounds

Color = tuple[float, float, float, float]

DEFAULT_DENSITY = 600.0
"""Density [kg/m^3] of objects without a mass, between softwood and plastic parts."""


CLOUDS_STAND = "point clouds and octrees are obstacles that stand in the world; they cannot move or be held"
USE_A_SOLID = "describe what moves by solids or a mesh"
F64 = NDArray[np.float64]


@dataclass(frozen=True)
@checked()
class Material:
    """Material of a collision object, with its coefficients of Coulomb friction: static, dynamic, torsional
    and rolling.

    The coefficients of torsional and rolling friction are lengths [m]. The defaults are those of painted wood
    on rubber.

    Raises:
        InputError: a coefficient is negative or not finite, or dynamic friction exceeds static friction.
    """

    friction: float = (
        0.8  # static: largest tangential force of a contact at rest, as a fraction of the normal force
    )
    torsional_friction: float = 0.005
    rolling_friction: float = 0.0001
    dynamic_friction: float | None = None  # coefficient of a sliding contact; None: same as `friction`

    def __post_init__(self) -> None:
        for name in ("friction", "torsional_friction", "rolling_friction", "dynamic_friction"):
            value = getattr(self, name)
            if value is not None and (not np.isfinite(value) or value < 0):
                raise InputError(f"{name} is {value:g}, it must be a number >= 0")
        if self.dynamic_friction is not None and self.dynamic_friction > self.friction:
            raise InputError(
                f"dynamic friction {self.dynamic_friction:g} is above static friction {self.friction:g}",
                hint="a contact that slides holds less than one at rest; swap them?",
            )

    @property
    def sliding(self) -> float:
        """Return the friction coefficient that a collision object's material has in a sliding contact.

        The result is `dynamic_friction`, or `friction` if that is None.
        """
        return self.friction if self.dynamic_friction is None else self.dynamic_friction

    def scaled(self, factor: float) -> Material:
        """Return a collision object's material with its static and dynamic friction multiplied by
        `factor`.
        """
        dynamic = None if self.dynamic_friction is None else self.dynamic_friction * factor
        return replace(self, friction=self.friction * factor, dynamic_friction=dynamic)


@dataclass(frozen=True)
class ObjectType:
    """Type of a collision object: its key in an object database, like object_recognition_msgs/ObjectType."""

    key: str = ""
    db: str = ""


@dataclass(frozen=True)
@checked()
class ScrewThread:
    """Screw thread of a collision object.
    The object can only turn about its own z axis and moves along this axis as it turns.

    The thread is right-handed: turned clockwise, as seen from the tip of its z axis, the object moves along
    -z.
    """

    into: str  # name of the object with the threaded hole
    pitch: float  # [m] per turn
    travel: float  # [m] that the object can still be screwed in
    torque: float = 0.2  # [Nm] friction torque

    def __post_init__(self) -> None:
        for name in ("pitch", "travel"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0):
                raise InputError(f"a thread's {name} is {value:g} m, it must be positive")
        if not (np.isfinite(self.torque) and self.torque >= 0):
            raise InputError(f"a thread's torque is {self.torque:g} Nm, it must not be negative")


def is_color(color: Any) -> bool:
    """Return whether a value is a valid RGBA color of a collision object: a tuple of four numbers from 0 to
    1.
    """
    return len(color) == 4 and all(0 <= part <= 1 for part in color)


def _bad_color(name: str, color: Any) -> InputError:
    return InputError(f"object {name!r}: color is {color}, it must be r, g, b, a of 0 to 1")


@dataclass(frozen=True, eq=False)
@checked()
class CollisionObject:
    """Collision object: a named rigid object of a planning scene that is made of one or more shapes.

    Attributes:
        name: unique name in the scene.
        shapes: shapes with their poses in the object's frame.
        T_world_object: pose of the object.
        color: RGBA, 0 to 1.
        movable: whether the object is a free body in physics that can be picked; otherwise it is a fixed
            obstacle.
        mass: [kg]; None means volume times `DEFAULT_DENSITY`.
        material: friction.
        subframes: named frames on the object, which the scene knows as "object/subframe".
        type: key of the object's type in a database.
        thread: screw connection to another object, in physics.
        belt: surface velocity of a fixed object [m/s, object frame], such as a conveyor.
    """

    name: str
    shapes: tuple[tuple[Shape, SE3], ...]  # (shape, T_object_shape)
    T_world_object: SE3 = SE3.identity()
    color: Color = (0.6, 0.6, 0.6, 1.0)
    movable: bool = False
    mass: float | None = None
    material: Material = Material()
    subframes: Mapping[str, SE3] = field(default_factory=dict)  # T_object_subframe by name
    type: ObjectType = ObjectType()
    thread: ScrewThread | None = None  # screw connection to another object, in physics
    belt: tuple[float, float, float] | None = None  # [m/s, object frame] surface velocity of a fixed object
    WRITTEN_AS: ClassVar[str] = (
        'CollisionObject.single("box", Box(0.1, 0.1, 0.1), SE3.from_xyz(0.4, 0.0, 0.2))'
    )

    def __post_init__(self) -> None:
        if not self.name:
            raise InputError("an object needs a name")
        if any(not name or name != name.strip() for name in self.subframes):
            raise InputError(f"object {self.name!r}: a subframe needs a name")
        if not is_color(self.color):
            raise _bad_color(self.name, self.color)
        if not self.shapes:
            raise InputError(f"object {self.name!r} has no shape")
        if self.mass is not None and not (np.isfinite(self.mass) and self.mass > 0):
            raise InputError(f"object {self.name!r}: mass is {self.mass:g} kg, it must be positive")
        moves = self.belt is not None and np.isfinite(self.belt).all() and np.any(self.belt)
        if self.belt is not None and (self.movable or not moves):
            text = (
                f"object {self.name!r}: belt is {self.belt} m/s, it is the speed of a fixed object's surface"
            )
            raise InputError(text)
        if self.movable and any(isinstance(s, Plane) for s, _ in self.shapes):
            raise InputError(f"object {self.name!r}: a plane cannot move")
        if self.movable and self.has_cloud:
            raise InputError(f"object {self.name!r}: {CLOUDS_STAND}", hint=USE_A_SOLID)

    @staticmethod
    def single(name: str, shape: Shape, pose: SE3 | None = None, **properties) -> CollisionObject:
        """Create a collision object with a single shape, located at the origin of the object's frame."""
        return CollisionObject(name, ((shape, SE3.identity()),), pose or SE3.identity(), **properties)

    def at(self, T_world_object: SE3) -> CollisionObject:
        """Return the collision object at a new pose. Its other fields are not validated again."""
        return self._copy(T_world_object=T_world_object)

    def colored(self, color: Color) -> CollisionObject:
        """Return the collision object with a new RGBA color (0 to 1).
        Its other fields are not validated again.

        Raises:
            InputError: the color is invalid.
        """
        if not is_color(color):
            raise _bad_color(self.name, color)
        return self._copy(color=color)

    def _copy(self, **checked_fields: Any) -> CollisionObject:
        other = object.__new__(CollisionObject)
        other.__dict__.update(self.__dict__, **checked_fields)
        return other

    @property
    def has_cloud(self) -> bool:
        """Return whether any shape of a collision object is a point cloud or an octree."""
        return any(isinstance(shape, PointCloud | Octree) for shape, _ in self.shapes)

    @property
    def volume(self) -> float:
        """Return the volume [m^3] of a collision object, which is the sum over its shapes."""
        return sum(shape_volume(shape) for shape, _ in self.shapes)

    @property
    def mass_kg(self) -> float:
        return self.mass if self.mass is not None else DEFAULT_DENSITY * self.volume

    def extent(self, direction: NDArray[np.float64]) -> float:
        """Return the size [m] of a collision object along a unit direction (3,) in the object's frame."""
        ends, direction = [], float_array(direction, (3,), "a direction")
        for shape, T in self.shapes:
            low, high = extent(shape, T.rotation.matrix.T @ direction)
            shift = float(T.translation @ direction)
            ends.append((low + shift, high + shift))
        return max(e[1] for e in ends) - min(e[0] for e in ends)

    def bounds(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the lowest and the highest corner (3,) [m] of a collision object's bounding box, in the
        object's frame.
        """
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        for shape, T in self.shapes:
            center, half = local_bounds(shape)
            center = T.apply(center)
            half = np.abs(T.rotation.matrix) @ half
            low, high = np.minimum(low, center - half), np.maximum(high, center + half)
        return low, high


def shape_volume(shape: Shape) -> float:
    """Return the volume [m^3] of one shape of a collision object. A plane has volume 0.

    A mesh that is not closed counts as its convex hull. Overlapping points of a cloud count several times.
    """
    match shape:
        case Box():
            return shape.x * shape.y * shape.z
        case Sphere():
            return 4 / 3 * np.pi * shape.radius**3
        case Cylinder():
            return np.pi * shape.radius**2 * shape.length
        case Capsule():
            return np.pi * shape.radius**2 * (shape.length + 4 / 3 * shape.radius)
        case Cone():
            return np.pi * shape.radius**2 * shape.length / 3
        case Mesh():
            import trimesh

            mesh = trimesh.Trimesh(shape.vertices, shape.faces, process=False)
            return float(abs(mesh.volume) if is_closed(shape) else mesh.convex_hull.volume)
        case Octree():
            return float(np.sum(shape.sizes**3))
        case PointCloud():
            return float(len(shape.points) * 4 / 3 * np.pi * shape.radius**3)
        case Plane():
            return 0.0


def _unit_inertia(shape: Shape) -> tuple[F64, F64]:
    """Return the center of mass (3,) [m] and the inertia (3, 3) [m^2] of a collision object's shape with
    uniform density and a mass of 1 kg.

    The inertia is relative to the center of mass. A mesh that is not closed counts as its convex hull.
    """
    match shape:
        case Box():
            x, y, z = shape.x**2, shape.y**2, shape.z**2
            return np.zeros(3), np.diag([y + z, x + z, x + y]) / 12
        case Sphere():
            return np.zeros(3), np.eye(3) * 0.4 * shape.radius**2
        case Cylinder():
            r, h = shape.radius**2, shape.length**2
            return np.zeros(3), np.diag([r / 4 + h / 12, r / 4 + h / 12, r / 2])
        case Cone():
            r, h = shape.radius**2, shape.length**2
            side = 3 / 20 * r + 3 / 80 * h
            return np.array([0, 0, -shape.length / 4]), np.diag([side, side, 0.3 * r])
        case Capsule():
            r, h = shape.radius, shape.length
            ball = 4 / 3 * r / (h + 4 / 3 * r)  # fraction of the mass in the two hemispheres
            rod = 1 - ball
            axial = rod * r**2 / 2 + ball * 0.4 * r**2
            side = rod * (r**2 / 4 + h**2 / 12) + ball * (0.4 * r**2 + h**2 / 4 + 3 / 8 * h * r)
            return np.zeros(3), np.diag([side, side, axial])
        case Mesh():
            import trimesh

            mesh = trimesh.Trimesh(shape.vertices, shape.faces, process=False)
            if not (is_closed(shape) and abs(mesh.volume) > 0):
                mesh = mesh.convex_hull
            return np.array(mesh.center_mass), np.array(mesh.moment_inertia) / mesh.volume
        case Plane() | PointCloud() | Octree():
            raise ValueError(f"a {type(shape).__name__} does not move: it has no inertia")


def solid_inertia(shapes: Iterable[tuple[Shape, SE3]], mass: float) -> tuple[F64, F64]:
    """Return the center of mass (3,) [m] of a collision object and its inertia (3, 3) [kg m^2] about that
    center.

    Both are in the object's frame. The mass is distributed evenly over the shapes' volumes; overlaps count
    twice.

    Args:
        shapes: (shape, T_object_shape) pairs.
        mass: total mass [kg].
    """
    parts = []
    volumes = []
    for shape, T in shapes:
        center, inertia = _unit_inertia(shape)
        R = T.rotation.matrix
        parts.append((T.apply(center), R @ inertia @ R.T))
        volumes.append(shape_volume(shape))
    masses = mass * np.array(volumes) / sum(volumes)
    center = masses @ np.array([c for c, _ in parts]) / mass
    total = np.zeros((3, 3))
    for m, (c, inertia) in zip(masses, parts, strict=True):
        d = c - center
        total += m * (inertia + (d @ d) * np.eye(3) - np.outer(d, d))
    return center, total


@dataclass(frozen=True, eq=False)
class MovingObject:
    """Moving object of a planning scene with a known motion: a collision object whose poses are given at
    times (k,) [s].

    Between two times the object moves in a straight line and turns evenly; before the first and after the
    last time it is at rest. `object.T_world_object` is ignored.
    """

    object: CollisionObject
    times: F64
    poses: tuple[SE3, ...]  # T_world_object

    def __post_init__(self) -> None:
        name, times = self.object.name, np.array(float_array(self.times, None, "times", finite=False))
        object.__setattr__(self, "times", times)
        if times.ndim != 1 or len(times) == 0 or len(times) != len(self.poses):
            raise InputError(f"moving object {name!r} has {len(self.poses)} poses at {times.size} times")
        if not np.all(np.isfinite(times)) or np.any(np.diff(times) <= 0):
            raise InputError(f"moving object {name!r}: its times must be finite and increase")
        if self.object.has_cloud or not np.isfinite(self.reach):
            raise InputError(f"moving object {name!r}: a cloud or plane cannot move")
        # Upper bound of the distance [m] that any point of the object has moved by each time.
        far = [a.distance_to(b) for a, b in zip(self.poses, self.poses[1:], strict=False)]
        steps = [meters + radians * self.reach for meters, radians in far]
        object.__setattr__(self, "_travelled", np.concatenate([[0.0], np.cumsum(steps)]))

    @property
    def name(self) -> str:
        return self.object.name

    @property
    def reach(self) -> float:
        """Return an upper bound on the distance [m] from the origin of a moving collision object to any of
        its points.
        """
        found = 0.0
        for shape, T in self.object.shapes:
            center, half = local_bounds(shape)
            limit = np.inf if half.max() >= 50 else np.linalg.norm(half)  # a plane is infinite
            found = max(found, float(np.linalg.norm(T.apply(center)) + limit))
        return found

    def pose(self, t: float) -> SE3:
        """Return the pose T_world_object of a moving collision object at time `t` [s]."""
        i = int(np.searchsorted(self.times, t, side="right")) - 1
        if i < 0:
            return self.poses[0]
        if i >= len(self.times) - 1:
            return self.poses[-1]
        share = (t - self.times[i]) / (self.times[i + 1] - self.times[i])
        return self.poses[i].interpolate(self.poses[i + 1], float(share))

    def travel(self, t0: float, t1: float) -> float:
        """Return an upper bound on how far [m] a moving collision object travels between the times t0 and t1
        [s].

        The bound holds for every point of the object.
        """
        a, b = np.interp([t0, t1], self.times, self._travelled)  # pyright: ignore[reportAttributeAccessIssue]
        return float(b - a)

    def swept(self, t0: float, t1: float, step: float = 0.02, most: int = 200) -> CollisionObject:
        """Return one fixed collision object that consists of copies of a moving object, placed along its path
        between the times t0 and t1.

        The result does not cover the space between the copies, so a motion planned around it must still be
        checked against the moving object at its times.

        Args:
            t0, t1: start and end time [s].
            step: largest travel between two copies [m].
            most: maximum number of intervals between copies.
        """
        count = int(np.clip(np.ceil(self.travel(t0, t1) / step), 1, most)) + 1
        fine = np.union1d(np.linspace(t0, t1, 20 * count), self.times[(self.times > t0) & (self.times < t1)])
        way = np.interp(fine, self.times, self._travelled)  # pyright: ignore[reportAttributeAccessIssue]
        at = np.interp(np.linspace(way[0], way[-1], count), way, fine) if way[-1] > way[0] else [t0]
        shapes = [(shape, self.pose(float(t)) @ T) for t in at for shape, T in self.object.shapes]
        return CollisionObject(self.name, tuple(shapes), color=self.object.color)
