"""Export of a cell for Unity: the C# package with message classes, the robot and the JSON scene file.

The scene file contains the parts of a cell that its robot's URDF does not describe. Frames and units
follow ROS (forward-left-up, m, rad, quaternions xyzw); the C# package converts them.
"""

from __future__ import annotations

import json
import math
import os
import shutil
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from armcell.cell import Cell
from armcell.collision.convex_decomposition import convex_pieces
from armcell.core import SE3, Format, InputError, Mesh, Shape, shape_kind, shape_name
from armcell.execution import ExecutionSettings
from armcell.model import Gripper, RobotModel
from armcell.records.mcap_writer import ros_name
from armcell.ros.message_generators import generate_csharp, write
from armcell.ros.nodes.gripper_node import TOPIC as GRIPPER
from armcell.ros.nodes.state_publisher import RATE
from armcell.ros.schema import Schema, schema
from armcell.ros.unity.urdf import file_name, small_hull, write_stl, write_urdf
from armcell.scene import CollisionObject
from armcell.sim import PhysicsSettings
from armcell.sim.joint_gains import effective_gains

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
