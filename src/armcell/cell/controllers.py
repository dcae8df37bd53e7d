"""External trajectory controllers: ros2_control, ros_control or vendor drivers.

`serve --plan-only` sends its motions to these controllers. The keys follow MoveIt's
moveit_controllers.yaml.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from armcell.cell.schema import ControllerSpec
from armcell.core import InputError, UnknownNameError
from armcell.model import RobotModel

SUFFIXES = ("_controller", "_trajectory")
ENDINGS = {
    "FollowJointTrajectory": "follow_joint_trajectory",
    "JointTrajectory": "joint_trajectory",
    "GripperCommand": "gripper_cmd",
}
"""Action or topic name below the controller's name, by controller type."""


@dataclass(frozen=True)
class Controller:
    """External trajectory controller (from ros2_control or a vendor) that the cell file assigns to some of
    the robot's joints.

    Attributes:
        name: the name in the cell file.
        type: FollowJointTrajectory or GripperCommand (actions), or JointTrajectory (topic).
        topic: full name of the action or topic.
        joints: the joints that the controller moves; for a gripper, the driven joint.
        gives_width: True if the position of a GripperCommand is the width between the fingers [m] instead of
            the joint position.
    """

    name: str
    type: str
    topic: str
    joints: tuple[str, ...]
    gives_width: bool = False


def controllers_of(
    specs: Mapping[str, ControllerSpec], model: RobotModel, file: Path
) -> tuple[Controller, ...]:
    """Return the external trajectory controllers that the block `controllers` of a cell file defines, after
    checking their joints.

    Raises:
        UnknownNameError: a joint does not exist.
        InputError: two controllers move the same joint, or a controller needs explicit joints.
    """
    found: list[Controller] = []
    owner: dict[str, str] = {}
    for name, spec in specs.items():
        where: dict[str, Any] = {"file": file, "element": f"controllers/{name}"}
        joints = tuple(spec.joints) or _joints_of(name, spec, model, where)
        for joint in joints:
            if joint not in model.joints:
                raise UnknownNameError("joint", joint, model.joint_names, **where)
            if joint in owner:
                raise InputError(
                    f"{joint} also belongs to {owner[joint]}", hint="name each joint once", **where
                )
            owner[joint] = name
        driven = [name for g in model.grippers.values() for name in g.joint_names]
        if spec.type == "GripperCommand" and (len(joints) != 1 or joints[0] not in driven):
            raise InputError(
                f"a GripperCommand moves one gripper, not {', '.join(joints)}",
                **where,
                hint=f"joints: [{driven[0]}]" if driven else "this robot has no gripper",
            )
        ending = ENDINGS[spec.type] if spec.action_ns is None else spec.action_ns
        topic = "/" + "/".join(part for part in (name.strip("/"), ending.strip("/")) if part)
        found.append(Controller(name, spec.type, topic, joints, spec.position == "width"))
    return tuple(found)


def _joints_of(name: str, spec: ControllerSpec, model: RobotModel, where: dict[str, Any]) -> tuple[str, ...]:
    """Infer the joints of an external controller from the controller's name, if the cell file lists no joints
    for this controller.

    A group or gripper with the same name has priority; otherwise the joints of the only arm or gripper.

    Raises:
        InputError: the name matches no group, and the robot has several candidates.
    """
    stem = name.rstrip("/").rpartition("/")[2]
    for suffix in SUFFIXES:
        stem = stem.removesuffix(suffix)
    grippers = list(model.grippers.values())
    if spec.type == "GripperCommand":
        mine = [g for g in grippers if stem in (g.name, g.group)] or grippers
        if len(mine) == 1 and mine[0].joint_name:
            return (mine[0].joint_name,)
    else:
        fingers = {g.group for g in grippers}
        arms = [g for g in model.groups.values() if g.tip_link and g.name not in fingers]
        mine = [g for g in model.groups.values() if g.name == stem] or arms
        if len(mine) == 1:
            return tuple(mine[0].joint_names)
    raise InputError(
        "does not say which joints it moves",
        **where,
        hint="add joints: [...], or name it <group>_controller",
    )
