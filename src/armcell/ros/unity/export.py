"""Export of a cell for Unity: C# package, JSON scene file, the robot as one flattened URDF with STL meshes.

The URDF needs no xacro and avoids constructs that cause errors in URDF importers: paths are relative,
visual and collision meshes have distinct names, each mesh has one color, each link has an inertia in
its principal axes, and collision meshes consist of convex pieces within Unity's limits. STL files are
binary.

The scene file contains the parts of a cell that its robot's URDF does not describe. Frames and units
follow ROS (forward-left-up, m, rad, quaternions xyzw); the C# package converts them.
"""

from __future__ import annotations

import json
import math
import os
import re
import shutil
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from lxml import etree
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from armcell.cell import Cell
from armcell.collision.convex_decomposition import convex_pieces
from armcell.core import SE3, SO3, Format, InputError, Mesh, Shape, shape_kind, shape_name, simpler_parts
from armcell.execution import ExecutionSettings
from armcell.model import Gripper, Inertial, Joint, Link, RobotModel
from armcell.model.assets import DEFAULT_COLOR, visual_parts
from armcell.records.mcap_writer import ros_name
from armcell.ros.message_generators import generate_csharp, write
from armcell.ros.nodes.gripper_node import TOPIC as GRIPPER
from armcell.ros.nodes.state_publisher import RATE
from armcell.ros.schema import Schema, schema
from armcell.scene import CollisionObject
from armcell.sim import PhysicsSettings
from armcell.sim.settings import effective_gains

Array = NDArray[np.float64]

MAX_HULL_POINTS = 128

"""Maximum corners of a hull: n corners give up to 2 n - 4 triangles, and Unity allows 255."""

SMALL_MASS = 1e-3  # [kg] mass of a link without a mass: physics engines require one

SMALL_INERTIA = 1e-7  # [kg m^2]


def write_stl(mesh: Mesh, file: Path) -> None:
    """Write a mesh [m] for Unity as a binary STL file.

    Corners keep the mesh's order; normals follow the right-hand rule.
    """
    corners = mesh.vertices[mesh.faces]  # (f, 3, 3)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    rows = np.zeros(
        len(corners), np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("tag", "<u2")])
    )
    rows["normal"] = np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0)
    rows["corners"] = corners
    file.write_bytes(b"armcell".ljust(80, b" ") + np.uint32(len(rows)).tobytes() + rows.tobytes())


def small_hull(mesh: Mesh, points: int = MAX_HULL_POINTS) -> tuple[Mesh, float]:
    """Approximate a mesh by a convex hull with at most `points` corners, and return the hull and its error
    [m]. Unity limits the number of corners of a collider.

    The error is the largest distance [m] of an unused corner outside the planes of the hull's faces. The hull
    grows by the corner that is farthest outside, so it is inside the convex hull of the mesh.

    Args:
        mesh: the mesh.
        points: maximum number of corners.
    Raises:
        QhullError: the mesh is flat.
    """
    corners = np.unique(mesh.vertices, axis=0)
    corners = corners[ConvexHull(corners).vertices]
    chosen = _spread(corners)
    while True:
        hull = ConvexHull(corners[chosen])
        outside = (corners @ hull.equations[:, :3].T + hull.equations[:, 3]).max(1)
        farthest = int(np.argmax(outside))
        if outside[farthest] < 1e-9 or len(chosen) >= min(points, len(corners)):
            return _oriented(corners[chosen], hull), max(float(outside[farthest]), 0.0)
        chosen.append(farthest)


def _spread(corners: Array) -> list[int]:
    """Return the indices of at least four non-coplanar mesh corners, from which the convex hull for Unity is
    grown.

    The corners are the extremes along ten directions, and further corners if these are coplanar.
    """
    directions = np.vstack([np.eye(3), -np.eye(3), [[1, 1, 1], [-1, 1, 1], [1, -1, 1], [1, 1, -1]]])
    chosen = list(dict.fromkeys(np.argmax(corners @ directions.T, axis=0).tolist()))
    for i in range(len(corners)):
        try:
            ConvexHull(corners[chosen])
            break
        except (QhullError, ValueError):  # fewer than four corners, or coplanar corners
            if i not in chosen:
                chosen.append(i)
    return chosen


def _oriented(points: Array, hull: ConvexHull) -> Mesh:
    """Return the convex hull of a mesh for Unity, with the normals of all faces pointing outward."""
    index = np.full(len(points), -1)
    index[hull.vertices] = np.arange(len(hull.vertices))
    faces, vertices = index[hull.simplices], points[hull.vertices]
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), hull.equations[:, :3]) < 0
    faces[inward] = faces[inward][:, ::-1]
    return Mesh(vertices, faces.astype(np.int32))


def write_urdf(model: RobotModel, folder: Path, name: str = "robot.urdf") -> Path:
    """Write the flattened URDF of a robot for Unity to a folder, with the meshes in the subfolder `meshes/`.

    Returns:
        Path of the URDF.
    """
    for kind in ("visual", "collision"):
        (folder / "meshes" / kind).mkdir(parents=True, exist_ok=True)
    robot = etree.Element("robot", name=model.name)
    writer = _Writer(folder)
    for link in model.links.values():
        writer.link(robot, link)
    for joint in model.joints.values():
        _joint(robot, joint)
    etree.indent(robot)
    file = folder / name
    file.write_bytes(etree.tostring(robot, xml_declaration=True, encoding="utf-8", pretty_print=True))
    return file


def file_name(name: str) -> str:
    """Convert the name of a link or object to a text that is valid in the file names of an exported URDF."""
    return re.sub(r"[^A-Za-z0-9_.-]", "_", name)


def principal_inertia(inertial: Inertial | None) -> tuple[float, SE3, np.ndarray]:
    """Return the mass [kg], the principal frame and the principal moments
    of inertia of a link for the URDF that Unity imports.

    The frame T_link_principal has its origin at the center of mass. The moments (3,) are in [kg m^2]. Missing
    masses and moments become small positive values.
    """
    if inertial is None or inertial.mass <= 0:
        T = SE3.identity() if inertial is None else inertial.T_link_com
        return SMALL_MASS, T, np.full(3, SMALL_INERTIA)
    moments, axes = np.linalg.eigh((inertial.inertia + inertial.inertia.T) / 2)
    if np.linalg.det(axes) < 0:
        axes[:, 2] *= -1.0
    turned = SE3(SO3(axes), np.zeros(3))
    return inertial.mass, inertial.T_link_com @ turned, np.maximum(moments, SMALL_INERTIA)


class _Writer:
    def __init__(self, folder: Path):
        self._folder = folder

    def link(self, robot: etree._Element, link: Link) -> None:
        element = etree.SubElement(robot, "link", name=link.name)
        mass, T, (ixx, iyy, izz) = principal_inertia(link.inertial)
        inertial = etree.SubElement(element, "inertial")
        _origin(inertial, T)
        etree.SubElement(inertial, "mass", value=_text(mass))
        values = {"ixx": ixx, "ixy": 0.0, "ixz": 0.0, "iyy": iyy, "iyz": 0.0, "izz": izz}
        etree.SubElement(inertial, "inertia", **{k: _text(v) for k, v in values.items()})
        self._visuals(element, link)
        self._collisions(element, link)

    def _visuals(self, element: etree._Element, link: Link) -> None:
        drawn = 0
        for visual in link.visuals:
            if visual.shape is None:
                parts: list[tuple[Shape, tuple]] = list(visual_parts(visual))
            else:
                parts = [(visual.shape, visual.color or DEFAULT_COLOR)]
            for shape, color in parts:
                drawn += self._draw(element, link.name, drawn, shape, visual.T_link_visual, color)
        if not drawn:  # without visuals, draw the collision shapes
            for collision in link.collisions:
                drawn += self._draw(
                    element, link.name, drawn, collision.shape, collision.T_link_shape, DEFAULT_COLOR
                )

    def _draw(
        self, element: etree._Element, link: str, number: int, shape: Shape, T: SE3, color: tuple
    ) -> int:
        """Write a shape as visual elements of the exported URDF and return the number of elements.

        A capsule becomes three elements.
        """
        solids = simpler_parts(shape, T)
        for i, (solid, T_link_solid) in enumerate(solids):
            visual = etree.SubElement(element, "visual")
            self._geometry(visual, "visual", f"{file_name(link)}_{number + i}", solid, T_link_solid)
            material = etree.SubElement(visual, "material", name=f"{file_name(link)}_{number + i}")
            etree.SubElement(material, "color", rgba=" ".join(_text(c) for c in color))
        return len(solids)

    def _collisions(self, element: etree._Element, link: Link) -> None:
        number = 0
        for collision in link.collisions:
            shape, T = collision.shape, collision.T_link_shape
            pieces = convex_pieces(shape) if isinstance(shape, Mesh) else (shape,)
            for piece in pieces:
                small = small_hull(piece)[0] if isinstance(piece, Mesh) else piece
                for solid, T_link_solid in simpler_parts(small, T):
                    child = etree.SubElement(element, "collision")
                    self._geometry(
                        child, "collision", f"{file_name(link.name)}_{number}", solid, T_link_solid
                    )
                    number += 1

    def _geometry(self, element: etree._Element, kind: str, name: str, shape: Shape, T: SE3) -> None:
        _origin(element, T)
        geometry = etree.SubElement(element, "geometry")
        row = shape_kind(shape, Format.URDF)
        if row is not None:
            sizes = {k: _texts(*np.atleast_1d(v)) for k, v in row.named(shape).items()}
            etree.SubElement(geometry, shape_name(shape), **sizes)
        elif isinstance(shape, Mesh):
            path = f"meshes/{kind}/{name}.stl"
            write_stl(shape, self._folder / path)
            etree.SubElement(geometry, "mesh", filename=path)
        else:
            raise ValueError(f"a link cannot be a {shape_name(shape)}")


def _joint(robot: etree._Element, joint: Joint) -> None:
    element = etree.SubElement(robot, "joint", name=joint.name, type=joint.type)
    etree.SubElement(element, "parent", link=joint.parent)
    etree.SubElement(element, "child", link=joint.child)
    _origin(element, joint.T_parent_joint)
    if not joint.movable:
        return
    etree.SubElement(element, "axis", xyz=_texts(*joint.axis))
    limits = joint.limits
    given = {
        "lower": limits.lower, "upper": limits.upper, "velocity": limits.velocity, "effort": limits.effort,
    }  # fmt: skip
    etree.SubElement(element, "limit", **{k: _text(v) for k, v in given.items() if np.isfinite(v)})
    if joint.mimic is not None:
        m = joint.mimic
        etree.SubElement(
            element, "mimic", joint=m.joint, multiplier=_text(m.multiplier), offset=_text(m.offset)
        )
    etree.SubElement(element, "dynamics", damping=_text(joint.damping), friction=_text(joint.friction))


def _origin(element: etree._Element, T: SE3) -> None:
    etree.SubElement(element, "origin", xyz=_texts(*T.translation), rpy=_texts(*T.rotation.rpy))


def _text(value: float) -> str:
    return repr(float(value))


def _texts(*values: float) -> str:
    return " ".join(_text(v) for v in values)


FORMAT = 1

FIXED_TIMESTEP = 0.005  # [s] keeps grasp contacts in PhysX; with Unity's default of 0.02 they slip

SOLVER_ITERATIONS, VELOCITY_ITERATIONS = 40, 20

FINGER_STIFFNESS, FINGER_DAMPING = 5000.0, 200.0  # [N/m, N s/m]

PACKAGE = "com.armcell.unity"

MESSAGES = "Messages"  # folder of the generated classes in the package


def scene_json(cell: Cell, seed: int | None, folder: Path, urdf: str) -> tuple[dict[str, Any], list[str]]:
    """Return the scene of a cell as JSON data for Unity,
    together with the names of objects that were left out.

    Point clouds and octrees are omitted.

    Args:
        cell: the cell.
        seed: seed of the cell's randomized values; None selects the nominal values.
        folder: folder below which the meshes of the objects are written.
        urdf: path of the robot's URDF, relative to `folder`.
    """
    scene = cell.scene(seed)
    objects = [item for item in scene.objects.values() if not item.has_cloud]
    movable = [item.name for item in objects if item.movable]
    data = {
        "format": FORMAT,
        "name": cell.name,
        "robot": {
            "urdf": urdf,
            "start": dict(zip(scene.model.joint_names, scene.positions.tolist(), strict=True)),
            "grippers": [  # the Unity package moves jaws; it has no vacuum
                _gripper(g, len(scene.model.grippers)) for g in scene.model.grippers.values() if g.joint_name
            ],
            "drives": _drives(scene.model, cell.physics),
            "may_touch": sorted(sorted(pair) for pair in scene.model.disabled_collisions if len(pair) == 2),
        },
        "objects": [_object(item, folder, len(movable) == 1) for item in objects],
        "physics": {
            "fixed_timestep": FIXED_TIMESTEP,
            "solver_iterations": SOLVER_ITERATIONS,
            "solver_velocity_iterations": VELOCITY_ITERATIONS,
            "gravity": list(cell.physics.gravity),
            "grip_mode": cell.physics.grip_mode,
            "finger_speed": cell.physics.finger_speed,
            "weld_force": cell.physics.weld_force,
            "hybrid_slip": cell.physics.hybrid_slip,
            "hybrid_turn": cell.physics.hybrid_turn,
        },
        "execution": asdict(ExecutionSettings()),
        "rate": RATE,
    }
    return data, [item.name for item in scene.objects.values() if item.has_cloud]


def _gripper(gripper: Gripper, count: int) -> dict[str, Any]:
    data = asdict(gripper)
    data["topic"] = GRIPPER if count == 1 else f"/{gripper.name}{GRIPPER}"
    return data


def _drives(model: RobotModel, physics: PhysicsSettings) -> dict[str, dict[str, float]]:
    """Return the drive parameters of all movable joints for the scene file of Unity, by joint name.

    The parameters are stiffness, damping and maximum force or torque. Arm joints use the gains of armcell's
    simulation, because its control law equals the law of Unity's drives.
    """
    fingers = {name: g for g in model.grippers.values() for name in g.joint_names}
    drives = {}
    for joint in model.joints.values():
        if not joint.movable:
            continue
        source = joint.mimic.joint if joint.mimic else joint.name
        effort = joint.limits.effort
        gripper = fingers.get(source)
        if gripper is not None:
            stiffness, damping = FINGER_STIFFNESS, FINGER_DAMPING
            effort = gripper.max_force * abs(gripper.width_per_joint) / 2
        else:
            drive = effective_gains(joint, physics)
            stiffness, damping = drive.kp, drive.kv
        drives[joint.name] = {"stiffness": stiffness, "damping": damping}
        if math.isfinite(effort):
            drives[joint.name]["force_limit"] = effort
    return drives


def _pose(T: SE3) -> dict[str, list[float]]:
    return {"position": T.translation.tolist(), "quat_xyzw": T.quat_xyzw.tolist()}


def _object(item: CollisionObject, folder: Path, only: bool) -> dict[str, Any]:
    data: dict[str, Any] = {
        "name": item.name,
        "pose": _pose(item.T_world_object),
        "movable": item.movable,
        "color": list(item.color),
        "friction": item.material.friction,
        "dynamic_friction": item.material.sliding,
        "shapes": [
            {**shape, "pose": _pose(T)}
            for i, (solid, T) in enumerate(item.shapes)
            for shape in _shapes(solid, f"{file_name(item.name)}_{i}", folder)
        ],
    }
    if item.movable:
        data["mass"] = item.mass_kg
        data["topic"] = "/object_pose" if only else f"/object_pose/{ros_name(item.name)}"
    return data


def _shapes(shape: Shape, name: str, folder: Path) -> list[dict[str, Any]]:
    """Return a shape as JSON data for the scene file of Unity.

    For a mesh, write STL files of the mesh and of its convex pieces, and return their paths.
    """
    kind = shape_kind(shape, Format.UNITY)
    if kind is not None:
        return [{"type": shape_name(shape), **kind.named(shape)}]
    if not isinstance(shape, Mesh):
        raise ValueError(f"a {shape_name(shape)} is not a solid")
    path = folder / "meshes" / "objects"
    path.mkdir(parents=True, exist_ok=True)
    write_stl(shape, path / f"{name}.stl")
    pieces = []
    for i, piece in enumerate(convex_pieces(shape)):
        write_stl(small_hull(piece)[0], path / f"{name}_hull{i}.stl")
        pieces.append(f"meshes/objects/{name}_hull{i}.stl")
    return [{"type": "mesh", "visual": f"meshes/objects/{name}.stl", "hulls": pieces}]


SCENE, URDF = "scene.json", "robot.urdf"


@dataclass(frozen=True)
class UnityExport:
    """Result of exporting a cell for Unity: the folders that were written and the objects that were omitted.

    Attributes:
        package: folder of the C# package.
        cell: folder of the cell's robot, meshes and scene.
        left_out: names of objects without colliders in Unity (point clouds and octrees).
    """

    package: Path
    cell: Path
    left_out: tuple[str, ...]
    is_project: bool  # the folder is a Unity project


def package_source() -> Path:
    """Return the folder of the C# package for Unity. In a source checkout, this is a link to `unity/`.

    Raises:
        InputError: the folder contains no package.
    """
    folder = Path(__file__).parent / "package"
    if not os.path.isfile(folder / "package.json"):
        raise InputError("is missing, armcell is not installed whole", file=folder, hint="install it again")
    return folder


def export_unity(
    cell: Cell, folder: Path, seed: int | None = None, types: Schema | None = None
) -> UnityExport:
    """Write a Unity package and the assets of a cell into a folder, e.g. a Unity project.

    The folders are `Packages/com.armcell.unity` and `Assets/Armcell/<cell>`. The export replaces the files of
    an earlier export and leaves other files unchanged.

    Raises:
        InputError: a file cannot be written.
    """
    package, target = folder / "Packages" / PACKAGE, folder / "Assets" / "Armcell" / file_name(cell.name)
    try:
        is_project = os.path.isdir(folder / "ProjectSettings")
        copy_package(package, types)
        target.mkdir(parents=True, exist_ok=True)
        write_urdf(cell.model, target, URDF)
        data, left_out = scene_json(cell, seed, target, URDF)
        (target / SCENE).write_text(json.dumps(data, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    except OSError as error:
        raise InputError(f"cannot write there ({error.strerror})", file=error.filename) from None
    return UnityExport(package, target, tuple(left_out), is_project)


def copy_package(target: Path, types: Schema | None = None) -> None:
    """Copy the C# package for Unity and add generated C# classes of moveit_msgs and control_msgs."""
    shutil.copytree(package_source(), target, dirs_exist_ok=True)
    write(generate_csharp(types or schema()), target / MESSAGES)
