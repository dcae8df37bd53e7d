"""JSON scene file for Unity: the parts of a cell that its robot's URDF does not describe.

Frames and units follow ROS (forward-left-up, m, rad, quaternions xyzw); the C# package converts them.
"""

from __future__ import annotations

import math
from dataclasses import asdict
from pathlib import Path
from typing import Any

from armcell.cell import Cell
from armcell.collision.convex_decomposition import convex_pieces
from armcell.core import SE3, Format, Mesh, Shape, shape_kind, shape_name
from armcell.execution import ExecutionSettings
from armcell.model import Gripper, RobotModel
from armcell.records.mcap_writer import ros_name
from armcell.ros.nodes.gripper_node import TOPIC as GRIPPER
from armcell.ros.nodes.state_publisher import RATE
from armcell.ros.unity.meshes import small_hull, write_stl
from armcell.ros.unity.urdf import file_name
from armcell.scene import CollisionObject
from armcell.sim import PhysicsSettings
from armcell.sim.joint_gains import effective_gains

FORMAT = 1
FIXED_TIMESTEP = 0.005  # [s] keeps grasp contacts in PhysX; with Unity's default of 0.02 they slip
SOLVER_ITERATIONS, VELOCITY_ITERATIONS = 40, 20
FINGER_STIFFNESS, FINGER_DAMPING = 5000.0, 200.0  # [N/m, N s/m]


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
