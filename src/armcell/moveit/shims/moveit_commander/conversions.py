"""Shim of moveit_commander.conversions: poses and transforms as lists, messages as bytes."""

from __future__ import annotations

from typing import Any

from armcell.moveit.message_classes import classes
from armcell.moveit.session import current_session
from armcell.moveit.shims.moveit_commander.exception import MoveItCommanderException
from armcell.moveit.shims.transformations import quaternion_from_euler
from armcell.ros.codec import ros1_codec


def msg_to_string(msg: Any) -> bytes:
    """Convert a message to bytes in the ROS 1 format, like moveit_commander.conversions."""
    return bytes(ros1_codec().encode(msg))


def msg_from_string(msg: Any, data: bytes) -> None:
    """Convert bytes in the ROS 1 format to a message, like moveit_commander.conversions."""
    found = classes().local(ros1_codec().decode(msg._type, data))
    for name in msg._fields:
        setattr(msg, name, getattr(found, name))


def pose_to_list(pose_msg: Any) -> list[float]:
    p, q = pose_msg.position, pose_msg.orientation
    return [p.x, p.y, p.z, q.x, q.y, q.z, q.w]


def list_to_pose(pose_list: Any) -> Any:
    """Convert a list to a Pose, like moveit_commander. The list contains x, y, z and either a quaternion (7
    numbers) or roll, pitch and yaw (6 numbers).
    """
    values = [float(v) for v in pose_list]
    if len(values) == 6:
        values = [*values[:3], *quaternion_from_euler(*values[3:]).tolist()]
    if len(values) != 7:
        raise MoveItCommanderException(
            "Expected either 6 or 7 elements in list: (x,y,z,r,p,y) or (x,y,z,qx,qy,qz,qw)"
        )
    new = current_session().new
    return new(
        "geometry_msgs/Pose",
        new("geometry_msgs/Point", *values[:3]),
        new("geometry_msgs/Quaternion", *values[3:]),
    )


def list_to_pose_stamped(pose_list: Any, target_frame: str) -> Any:
    session = current_session()
    header = session.messages.local(session.bus.header(target_frame))
    return session.new("geometry_msgs/PoseStamped", header, list_to_pose(pose_list))


def transform_to_list(trf_msg: Any) -> list[float]:
    t, q = trf_msg.translation, trf_msg.rotation
    return [t.x, t.y, t.z, q.x, q.y, q.z, q.w]


def list_to_transform(trf_list: Any) -> Any:
    values = [float(v) for v in trf_list]
    new = current_session().new
    return new(
        "geometry_msgs/Transform",
        new("geometry_msgs/Vector3", *values[:3]),
        new("geometry_msgs/Quaternion", *values[3:]),
    )
