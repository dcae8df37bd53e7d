"""Objects of the grasp benchmark: everyday objects and machine parts from packages, at true scale.

The meshes come from wheels on PyPI, which pip downloads and this module unpacks into armcell's cache folder:
the scans of ContactDB and the test solids in myosuite's `object_sim`, the groceries of robosuite, and small
parts of robots in pybullet_data. None of them is a YCB object. The wheels' other dependencies are not
installed.

The set is divided into two halves by name. Only the half "tune" may be used to change armcell; the half
"held out" shows what the changes are worth on other objects.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import coal
import numpy as np
from numpy.typing import NDArray

from armcell._cache import cache_root
from armcell.collision.coal_shapes import solid, triangle_model
from armcell.collision.convex_decomposition import convex_pieces
from armcell.core import SE3, Mesh
from armcell.grasping import surface_of
from armcell.grasping.grasp import directions_around, needed_force, tcp_pose
from armcell.grasping.hand_fit_kernel import cast
from armcell.kinematics import kinematic_tree
from armcell.model import Gripper, RobotModel
from armcell.scene import CollisionObject, Material, library_object, mesh_object

Array = NDArray[np.float64]
Parts = list[tuple[Any, SE3]]  # coal.CollisionObject and its pose in the tcp frame

FRICTION = 0.5
HALVES = ("tune", "held out")

# --- the set ---
WHEELS = {  # requirement and folder of the meshes in the wheel
    "contactdb": ("myosuite==2.11.6", "myosuite/simhive/object_sim/"),
    "robosuite": ("robosuite==1.5.2", "robosuite/models/assets/objects/meshes/"),
    "pybullet": ("pybullet==3.2.7", "pybullet_data/"),
}
CONTACTDB = (  # without second copies (coffeemug, cubemiddle, rubberduck, stamp, wristwatch) and the table
    "airplane alarmclock apple banana binoculars bowl camera cubelarge cubemedium cubesmall cup "
    "cylinderlarge cylindermedium cylindersmall doorknob duck elephant eyeglasses flashlight flute fryingpan "
    "gamecontroller hammer hand headphones knife lightbulb mouse mug phone piggybank pyramidlarge "
    "pyramidmedium pyramidsmall scissors spherelarge spheremedium spheresmall stanfordbunny stapler teapot "
    "toothbrush toothpaste toruslarge torusmedium torussmall train watch waterbottle wineglass"
)
ROBOSUITE = "bottle bread can cereal lemon milk"
PYBULLET = {
    "bracket h101": "quadruped/microtaur/fr12_h101.stl",
    "bracket h103": "quadruped/microtaur/fr12_h103_lowres.stl",
    "bracket s102": "quadruped/microtaur/fr13_s102_lowerscaled.stl",
    "channel 4 inch": "quadruped/microtaur/channel_4inch.stl",
    "computer": "quadruped/microtaur/xavier.stl",
    "depth camera": "quadruped/microtaur/d435i.stl",
    "mug 2": "objects/mug.obj",
    "plate": "quadruped/microtaur/plate.stl",
    "prism": "toys/prism.obj",
    "servo": "quadruped/microtaur/xm430w210.stl",
    "toe": "quadruped/microtaur/toe_brake.stl",
}


@dataclass(frozen=True)
class Listed:
    """An object of the set: its name, its source, its mesh file in the source's wheel, and its half."""

    name: str
    source: str
    file: str
    half: str


@cache
def listed() -> tuple[Listed, ...]:
    """Return the objects of the set by name; every second one is held out."""
    found = [(name, "contactdb", f"{name}/{name}.stl") for name in CONTACTDB.split()]
    found += [(name, "robosuite", f"{name}.stl") for name in ROBOSUITE.split()]
    found += [(name, "pybullet", file) for name, file in PYBULLET.items()]
    return tuple(Listed(*row, HALVES[i % 2]) for i, row in enumerate(sorted(found)))


LIBRARY = tuple(
    Listed(f"library {kind}", "library", kind, "tune")
    for kind in ("box", "can", "bottle", "mug", "l_bracket", "rod", "bolt")
)
"""Objects of armcell's library, of which many tests know the shapes: not a part of the set."""


def load(entry: Listed) -> CollisionObject:
    """Return an object of the set, with armcell's default density and a friction of 0.5, or of the library.

    Raises:
        subprocess.CalledProcessError: pip cannot download the wheel.
    """
    if entry.source == "library":
        return library_object(entry.file)
    file = folder(entry.source) / WHEELS[entry.source][1] / entry.file
    return mesh_object(entry.name, file, material=Material(FRICTION))


def folder(source: str) -> Path:
    """Return the folder with a wheel's meshes, which is filled at the first call."""
    requirement, inside = WHEELS[source]
    home = cache_root() / "grasp objects"
    target = home / requirement
    if not target.exists():
        home.mkdir(parents=True, exist_ok=True)
        words = ["download", "--quiet", "--no-deps", "--only-binary=:all:", "--python-version=3.11"]
        words += ["--platform=manylinux2014_x86_64", f"--dest={home}", requirement]
        subprocess.run([sys.executable, "-m", "pip", *words], check=True)
        (wheel,) = home.glob(f"{requirement.split('==')[0]}-*.whl")
        partial = home / f"{requirement}.partial"
        with ZipFile(wheel) as archive:
            wanted = [n for n in archive.namelist() if n.startswith(inside) and "random_urdfs" not in n]
            archive.extractall(partial, wanted)
        partial.rename(target)
        wheel.unlink()
    return target


# --- the rule ---
RULE = (
    "An object in a pose is graspable if the gripper is strong enough for its weight and if, for some of "
    "1000 points of its surface, all of this holds: the ray along the inward normal leaves the object "
    "through a surface that faces it within the friction cone, at a distance below the gripper's opening "
    "less 2 mm; and in one of 16 directions around this pair of points, at three depths, the exact convex "
    "pieces of the open hand's links touch neither the object nor the table (3 mm), at the grasp and 25 and "
    "50 mm before it. The rule uses coal and neither armcell's candidates nor the arm."
)
POINTS, TURNS, DEPTHS = 1000, 16, (0.0, 0.4, 0.8)
SPARE, WIDER = 0.002, 0.010  # [m] opening that a pair must leave, and opening beyond the pair
TABLE_GAP = 0.003  # [m]
BEFORE = (0.0, 0.025, 0.05)  # [m] distances before the grasp at which the hand must be free


def graspable(item: CollisionObject, model: RobotModel, gripper: Gripper, pad: Array) -> str:
    """Return why an object on a table is not graspable by the written rule; empty if it is.

    Args:
        pad: (2, 2) [m] minimum and maximum x and z of the pads in the tcp frame.
    """
    if needed_force(item) > gripper.max_force:
        return f"needs {needed_force(item):.0f} N per finger"
    up = item.T_world_object.rotation.matrix[2]
    pairs = list(_pairs(item, gripper.max_width - SPARE))
    if not pairs:
        return "no opposing pair within the opening"
    obstacles = _solid(item), _table(item, up)
    for start, closing, width in pairs:
        middle = start + closing * width / 2
        hand = _hand(model, gripper, min(width + WIDER, gripper.max_width))
        for approach in directions_around(closing, TURNS, -up):
            for depth in DEPTHS:
                T = tcp_pose(closing, approach, middle - approach * depth * pad[1, 1])
                if _is_free(hand, T, approach, obstacles):
                    return ""
    return f"the hand touches object or table at all of {len(pairs)} pairs"


def _pairs(item: CollisionObject, opening: float) -> Iterator[tuple[Array, Array, float]]:
    """Yield opposing pairs within the opening: start point, direction and distance [m]."""
    surface = surface_of(item)
    triangles = np.ascontiguousarray(surface.triangles)
    rng = np.random.default_rng(1)
    areas = np.linalg.norm(
        np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1
    )
    which = rng.choice(len(triangles), POINTS, p=areas / areas.sum())
    u, v = np.sqrt(rng.uniform(size=(1, POINTS, 1))), rng.uniform(size=(1, POINTS, 1))
    a, b, c = triangles[which].transpose(1, 0, 2)
    start = ((1 - u) * a + u * (1 - v) * b + u * v * c)[0]
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-18)
    inward = -normals[which]
    distance, where = cast(start + 1e-6 * inward, inward, triangles)
    facing = np.einsum("nej,nj->ne", normals[where], inward)
    good = (where >= 0) & (distance > 2e-4) & (distance < opening) & (facing > 1 / np.hypot(1, FRICTION))
    for i, k in zip(*np.nonzero(good), strict=True):
        yield start[i], inward[i], float(distance[i, k])


def _solid(item: CollisionObject) -> Any:
    vertices = surface_of(item).triangles.reshape(-1, 3)
    faces = np.arange(len(vertices), dtype=np.int32).reshape(-1, 3)
    return coal.CollisionObject(triangle_model(vertices, faces))


def _table(item: CollisionObject, up: Array) -> Any:
    """Return the half-space of the table, with the gap, in the object's frame."""
    floor = float((surface_of(item).triangles.reshape(-1, 3) @ up).min())
    return coal.CollisionObject(coal.Halfspace(np.asarray(up), floor + TABLE_GAP))


@cache
def _links(model: RobotModel, gripper: Gripper) -> tuple[tuple[str, Any, SE3], ...]:
    """Return the convex pieces of the hand's links: link, shape and pose in the link."""
    return tuple(
        (name, solid(piece).exact, collision.T_link_shape)
        for name in gripper.hand_links
        for collision in model.links[name].collisions
        for piece in (
            convex_pieces(collision.shape) if isinstance(collision.shape, Mesh) else (collision.shape,)
        )
    )


@cache
def _hand_at(model: RobotModel, gripper: Gripper, millimeters: int) -> Parts:
    width, tree = millimeters / 1000, kinematic_tree(model)
    q = model.default_positions()
    for column in model.columns(gripper.joint_names):
        q[column] = gripper.joint_position(width)
    T_tcp_world = tree.link_pose(q, gripper.tcp_link).inverse()
    return [
        (coal.CollisionObject(shape), T_tcp_world @ tree.link_pose(q, name) @ T)
        for name, shape, T in _links(model, gripper)
    ]


def _hand(model: RobotModel, gripper: Gripper, width: float) -> Parts:
    """Return the shapes of the open hand and their poses in the tcp frame; the opening is rounded to 1 mm."""
    return _hand_at(model, gripper, int(width * 1000))


def _is_free(
    hand: Parts, T: Array, approach: Array,
    obstacles: tuple[Any, ...],
) -> bool:  # fmt: skip
    request, R = coal.CollisionRequest(), T[:3, :3]
    for back in BEFORE:
        at = T[:3, 3] - back * approach
        for part, T_tcp_shape in hand:
            t = R @ T_tcp_shape.translation + at
            part.setTransform(coal.Transform3s(R @ T_tcp_shape.rotation.matrix, t))
            part.computeAABB()
            for obstacle in obstacles:
                if coal.collide(part, obstacle, request, coal.CollisionResult()):
                    return False
    return True
