"""Conversion of robot states and trajectories: moveit_msgs/RobotState and RobotTrajectory."""

from __future__ import annotations

from typing import Any

import numpy as np

from armcell.core import InputError, JointState, JointTrajectory
from armcell.kinematics import kinematic_tree
from armcell.ros.convert import joint_state_from_message, trajectory_message
from armcell.ros.moveit_convert.objects import object_message
from armcell.ros.schema import Schema
from armcell.scene import AttachedBody, PlanningScene


def robot_state_from_message(message: Any, scene: PlanningScene) -> JointState | None:
    """Convert a moveit_msgs/RobotState message to a joint state. The result is None if the message names no
    joints.

    Joints that the message does not name keep the scene's positions, with or without `is_diff`.

    Raises:
        UnknownNameError: a joint does not exist.
        InputError: the message contains multi-DOF joints, or its joint state is invalid (see
            `joint_state_from_message`).
    """
    if message.multi_dof_joint_state.joint_names:
        raise InputError("multi-DOF joints are not planned for", hint="leave multi_dof_joint_state empty")
    return joint_state_from_message(message.joint_state, scene.model)


def robot_state_message(schema: Schema, header: Any, scene: PlanningScene, attached: bool = True) -> Any:
    """Convert the robot state of a scene to a moveit_msgs/RobotState message with all movable and mimic
    joints.

    Args:
        schema: the message types.
        header: header of the message.
        scene: the planning scene.
        attached: if True, the message also contains the attached objects.
    """
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
    """Convert an attached body in the robot state, as part of a moveit_msgs/RobotState, to an
    AttachedCollisionObject message in the frame of its link.
    """
    own = schema.new("std_msgs/Header", stamp=header.stamp, frame_id=body.link)
    return schema.new(
        "moveit_msgs/AttachedCollisionObject",
        link_name=body.link,
        object=object_message(schema, own, body.object.at(body.T_link_object)),
        touch_links=sorted(body.touch_links),
    )


def robot_trajectory_message(schema: Schema, header: Any, trajectory: JointTrajectory | None) -> Any:
    """Convert a trajectory of robot states to a moveit_msgs/RobotTrajectory message. None gives an empty
    message.
    """
    if trajectory is None:
        return schema.new("moveit_msgs/RobotTrajectory")
    message = trajectory_message(schema, header, trajectory)
    return schema.new("moveit_msgs/RobotTrajectory", joint_trajectory=message)
