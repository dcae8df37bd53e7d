"""Shim of tf2_geometry_msgs: transforms stamped poses, points and vectors."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np

from armcell.moveit.session import current_session
from armcell.ros.convert import pose_from_message, pose_message


def do_transform_pose(pose: Any, transform: Any) -> Any:
    session = current_session()
    T = pose_from_message(transform.transform) @ pose_from_message(pose.pose)
    moved = session.messages.local(pose_message(session.bus.schema, T))
    return session.new("geometry_msgs/PoseStamped", copy.deepcopy(transform.header), moved)


def do_transform_point(point: Any, transform: Any) -> Any:
    p = point.point
    x, y, z = pose_from_message(transform.transform).apply(np.array([p.x, p.y, p.z])).tolist()
    session = current_session()
    return session.new(
        "geometry_msgs/PointStamped",
        copy.deepcopy(transform.header),
        session.new("geometry_msgs/Point", x, y, z),
    )


def do_transform_vector3(vector3: Any, transform: Any) -> Any:
    v = vector3.vector
    R = pose_from_message(transform.transform).rotation.matrix
    x, y, z = (R @ np.array([v.x, v.y, v.z])).tolist()
    session = current_session()
    vector = session.new("geometry_msgs/Vector3", x, y, z)
    return session.new("geometry_msgs/Vector3Stamped", copy.deepcopy(transform.header), vector)
