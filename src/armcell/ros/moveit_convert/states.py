"""Robot states and trajectories: moveit_msgs/RobotState and RobotTrajectory."""

from __future__ import annotations

from typing import Any

import numpy as np

from armcell.core import InputError, JointState, JointTrajectory, UnknownNameError
from armcell.kinematics import kinematic_tree
from armcell.model import RobotModel
from armcell.ros.moveit_convert.objects import object_message
from armcell.ros.schema import Schema
from armcell.scene import AttachedBody, PlanningScene


def joint_state_from_message(message: Any, model: RobotModel) -> JointState | None:
    """The joints of a sensor_msgs/JointState, without those that mimic others; None where it names none.

    Raises:
        UnknownNameError: no such joint.
        InputError: a joint named twice, another number of positions, a value that is not finite.
    """
    names, values = list(message.name), [float(v) for v in message.position]
    if len(names) != len(values):
        raise InputError(f"a joint state has {len(names)} names and {len(values)} positions")
    found: dict[str, float] = {}
    for name, value in zip(names, values):
        if name not in model.joints:
            raise UnknownNameError("joint", name, model.joints)
        if name in found:
            raise InputError(f"joint {name!r} is named twice")
        if model.joints[name].actuated:
            found[name] = value
    return JointState.from_mapping(found) if found else None


def robot_state_from_message(message: Any, scene: PlanningScene) -> JointState | None:
    """The joints of a moveit_msgs/RobotState; None where it leaves them as they are.

    Joints that it does not name keep the scene's positions, whether it says `is_diff` or not.

    Raises:
        UnknownNameError, InputError: see `joint_state_from_message`.
    """
    if message.multi_dof_joint_state.joint_names:
        raise InputError("multi-DOF joints are not planned for", cure="leave multi_dof_joint_state empty")
    return joint_state_from_message(message.joint_state, scene.model)


def robot_state_message(schema: Schema, header: Any, scene: PlanningScene, attached: bool = True) -> Any:
    """The RobotState of a scene: every movable joint, mimic joints too, and what is attached."""
    positions = kinematic_tree(scene.model).full_positions(scene.positions)
    names = list(scene.model.movable_joint_names)
    state = schema.new(
        "sensor_msgs/JointState",
        header,
        names,
        np.array([positions[n] for n in names]),
        np.zeros(0),
        np.zeros(0),
    )
    multi = schema.new("sensor_msgs/MultiDOFJointState", header=header)
    bodies = [attached_message(schema, header, body) for body in scene.attached.values()] if attached else []
    return schema.new("moveit_msgs/RobotState", state, multi, bodies, False)


def attached_message(schema: Schema, header: Any, body: AttachedBody) -> Any:
    """The AttachedCollisionObject of an attached body, placed in its link's frame."""
    own = schema.new("std_msgs/Header", stamp=header.stamp, frame_id=body.link)
    return schema.new(
        "moveit_msgs/AttachedCollisionObject",
        link_name=body.link,
        object=object_message(schema, own, body.object.at(body.T_link_object)),
        touch_links=sorted(body.touch_links),
    )


def trajectory_message(schema: Schema, header: Any, trajectory: JointTrajectory) -> Any:
    """A trajectory_msgs/JointTrajectory with the velocities and accelerations that are known."""
    Point = schema.message("trajectory_msgs/JointTrajectoryPoint")
    duration = schema.message("builtin_interfaces/Duration")
    empty = np.zeros(0)
    v, a = trajectory.velocities, trajectory.accelerations
    points = [
        Point(
            trajectory.positions[i],
            empty if v is None else v[i],
            empty if a is None else a[i],
            empty,
            duration.from_sec(float(t)),
        )
        for i, t in enumerate(trajectory.times)
    ]
    return schema.new("trajectory_msgs/JointTrajectory", header, list(trajectory.joint_names), points)


def robot_trajectory_message(schema: Schema, header: Any, trajectory: JointTrajectory | None) -> Any:
    """A RobotTrajectory; an empty one where there is no trajectory."""
    if trajectory is None:
        return schema.new("moveit_msgs/RobotTrajectory")
    message = trajectory_message(schema, header, trajectory)
    return schema.new("moveit_msgs/RobotTrajectory", joint_trajectory=message)
