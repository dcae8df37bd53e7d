"""Conversions between armcell's types and ROS messages, and detection of numbers in the wrong unit.

Quaternions are in xyzw order. Wrong units are degrees for radians, or millimeters for meters.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from armcell.core import SE3, InputError, JointState, JointTrajectory, Pinhole, UnknownNameError
from armcell.model import RobotModel
from armcell.ros.schema import Schema
from armcell.timing import with_start_state

TURN = 2 * np.pi + 0.1  # [rad] a larger angle is suspicious
MANY = 5.0  # a prismatic joint's value beyond this multiple of its limit is suspicious
FAR = 100.0  # [m] maximum distance from the origin: no work cell is larger
TIME_GAP = 1e-9  # [s] points less than a nanosecond apart count as simultaneous


def unit_fault(model: RobotModel, names: Iterable[str], positions: Sequence[float]) -> str | None:
    """Return a hint if the joint positions in a ROS message seem to be in degrees or millimeters: they exceed
    the limits, but would be valid after conversion to rad or m.

    Args:
        model: the robot, for joint types and limits.
        names: joint names, in the order of `positions`.
        positions: one value for each joint [rad or m].
    """
    turning, sliding = [], []
    for name, value in zip(names, positions, strict=True):
        joint = model.joint(name)
        (sliding if joint.type == "prismatic" else turning).append((value, joint.limits))
    if any(abs(v) > TURN and not x.lower <= v <= x.upper for v, x in turning) and all(
        x.lower <= np.deg2rad(v) <= x.upper for v, x in turning
    ):
        return "these look like degrees: ROS has radians"
    if any(abs(v) > MANY * max(abs(x.lower), abs(x.upper)) for v, x in sliding) and all(
        x.lower <= v / 1000 <= x.upper for v, x in sliding
    ):
        return "these look like millimeters: ROS has meters"
    return None


def check_in_meters(T: SE3) -> None:
    """Check that a pose converted from a ROS message is in meters. A pose more than 100 m from the origin is
    probably in millimeters.

    Raises:
        InputError: the translation is longer than 100 m.
    """
    distance = float(np.linalg.norm(T.translation))
    if distance > FAR:
        raise InputError(f"it is {distance:.4g} m away", hint="in millimeters? ROS has meters")


def joint_state_message(schema: Schema, header: Any, state: JointState) -> Any:
    """Convert a joint state of armcell to a sensor_msgs/JointState message.

    Unknown velocities and efforts become empty arrays.
    """
    empty = np.zeros(0)
    return schema.new(
        "sensor_msgs/JointState",
        header,
        list(state.joint_names),
        state.positions,
        empty if state.velocities is None else state.velocities,
        empty if state.efforts is None else state.efforts,
    )


def pose_message(schema: Schema, T: SE3) -> Any:
    """Convert an SE3 pose to a geometry_msgs/Pose message."""
    point = schema.new("geometry_msgs/Point", *T.translation.tolist())
    return schema.new("geometry_msgs/Pose", point, schema.new("geometry_msgs/Quaternion", *_xyzw(T)))


def pose_from_message(pose: Any) -> SE3:
    """Convert a geometry_msgs/Pose or geometry_msgs/Transform message to an SE3 pose.

    An all-zero quaternion, the default in a new message, counts as the identity rotation.

    Raises:
        InputError: a number is not finite, or the quaternion's length differs from 1 by more than 0.1.
    """
    if hasattr(pose, "orientation"):
        p, r = pose.position, pose.orientation
    else:
        p, r = pose.translation, pose.rotation
    xyz, xyzw = np.array([p.x, p.y, p.z], dtype=float), np.array([r.x, r.y, r.z, r.w], dtype=float)
    length = math.sqrt(xyzw.dot(xyzw))
    if length == 0.0:
        xyzw, length = np.array([0.0, 0.0, 0.0, 1.0]), 1.0
    if not math.isfinite(sum(xyz.tolist(), length)):
        raise InputError("a pose has a number that is not finite")
    if abs(length - 1.0) > 0.1:
        raise InputError(f"quaternion {xyzw.round(4).tolist()} has length {length:.3f}", hint="normalize it")
    return SE3.from_quat_xyzw(xyz, xyzw / length)


def transform_message(schema: Schema, header: Any, child: str, T: SE3) -> Any:
    """Convert an SE3 pose to a geometry_msgs/TransformStamped message:
    the pose of the frame `child` in the frame of the header.
    """
    vector = schema.new("geometry_msgs/Vector3", *T.translation.tolist())
    rotation = schema.new("geometry_msgs/Quaternion", *_xyzw(T))
    return schema.new(
        "geometry_msgs/TransformStamped",
        header,
        child,
        schema.new("geometry_msgs/Transform", vector, rotation),
    )


def image_message(schema: Schema, header: Any, picture: np.ndarray) -> Any:
    """Convert a camera image (array) to a sensor_msgs/Image message.

    Args:
        schema: the message types.
        header: std_msgs/Header with the camera frame.
        picture: color (h, w, 3) uint8, encoded as rgb8, or depth (h, w) float32 [m], encoded as 32FC1.
    """
    rows = np.ascontiguousarray(picture)
    encoding = "rgb8" if rows.ndim == 3 else "32FC1"
    height, width = rows.shape[:2]
    data = np.frombuffer(rows.tobytes(), np.uint8)
    return schema.new("sensor_msgs/Image", header, height, width, encoding, 0, rows.strides[0], data)


def camera_info_message(schema: Schema, header: Any, pinhole: Pinhole) -> Any:
    """Convert the parameters of a pinhole camera, including any distortion, to a sensor_msgs/CameraInfo
    message.
    """
    p, K = pinhole, pinhole.matrix
    d = np.zeros(5)
    d[: len(p.distortion)] = p.distortion
    P = np.column_stack([K, np.zeros(3)])
    fields = {"height": p.height, "width": p.width, "distortion_model": "plumb_bob"}
    message = schema.message("sensor_msgs/CameraInfo")(header=header, **fields)
    for name, value in (("D", d), ("K", K.ravel()), ("R", np.eye(3).ravel()), ("P", P.ravel())):
        setattr(message, name, value)
    return message


def cloud_message(schema: Schema, header: Any, points: np.ndarray, rgb: np.ndarray | None = None) -> Any:
    """Convert an array of points (n, 3) to a sensor_msgs/PointCloud2 message.

    Args:
        schema: the message types.
        header: std_msgs/Header with the frame of the points.
        points: (h, w, 3) float32 [m]; NaN where the camera measured nothing.
        rgb: optional colors (h, w, 3) uint8; packed as in PCL, 0x00rrggbb in the bits of a float.
    """
    height, width = points.shape[:2]
    names = ["x", "y", "z"] + (["rgb"] if rgb is not None else [])
    table = np.zeros((height, width, len(names)), "<f4")
    table[..., :3] = points
    if rgb is not None:
        packed = rgb.astype(np.uint32) @ np.array([1 << 16, 1 << 8, 1], np.uint32)
        table[..., 3] = packed.astype("<u4").view("<f4")
    FLOAT32 = 7
    fields = [schema.new("sensor_msgs/PointField", n, 4 * i, FLOAT32, 1) for i, n in enumerate(names)]
    step = 4 * len(names)
    dense = bool(np.isfinite(points).all())
    data = np.frombuffer(table.tobytes(), np.uint8)
    return schema.new(
        "sensor_msgs/PointCloud2", header, height, width, fields, False, step, step * width, data, dense
    )


def _xyzw(T: SE3) -> list[float]:
    return T.quat_xyzw.tolist()


def trajectory_from_message(message: Any, model: RobotModel, now: JointState) -> JointTrajectory:
    """Validate a trajectory_msgs/JointTrajectory message and convert it to a trajectory of armcell.

    If the first point is later than 0 s, the trajectory begins with the robot's current state, as in ROS's
    joint_trajectory_controller. A message without points is an empty trajectory, which means stop.

    Args:
        message: the JointTrajectory message.
        model: the robot, for joint names and limits.
        now: current joint state.
    Raises:
        InputError: a joint is unknown or repeated, array lengths differ, a number is not finite, times do not
            increase, or a position exceeds its limits. The error names the joint and the point.
    """
    names = tuple(message.joint_names)
    _check_names(names, model)
    n, points = len(names), message.points
    if not points:
        return JointTrajectory(names, np.zeros(0), np.zeros((0, n)))
    times = np.array([p.time_from_start.to_sec() for p in points])
    if times[0] < 0 or np.any(np.diff(times) < TIME_GAP):
        i = 0 if times[0] < 0 else int(np.argmax(np.diff(times) < TIME_GAP)) + 1
        raise InputError(f"point {i} is at {times[i]:g} s: time must begin at 0 or later, and increase")
    positions = _rows(points, "positions", n)
    if positions is None:
        raise InputError("the points have no positions")
    velocities, accelerations = _rows(points, "velocities", n), _rows(points, "accelerations", n)
    for i, row in enumerate(positions):
        try:
            model.check_positions(row, names, margin=1e-4)
        except InputError as error:
            hint = unit_fault(model, names, row) or error.hint
            raise InputError(f"point {i}: {error.reason}", hint=hint) from None
    if velocities is None:
        accelerations = None  # interpolation cannot use accelerations without velocities
    trajectory = JointTrajectory(names, times, positions, velocities, accelerations)
    if times[0] > TIME_GAP:
        return with_start_state(now, trajectory)
    return trajectory


def _check_names(names: Sequence[str], model: RobotModel) -> None:
    for name in names:
        if name not in model.joint_names:
            raise UnknownNameError("joint", name, model.joint_names)
    if len(set(names)) < len(names):
        twice = next(name for name in names if list(names).count(name) > 1)
        raise InputError(f"joint {twice!r} is named twice")


def _rows(points: Sequence[Any], field: str, n: int) -> np.ndarray | None:
    """Convert one field, such as the velocities, of all points in a trajectory_msgs/JointTrajectory message
    to an array (points, n).

    Returns:
        The array, or None if no point sets the field.
    Raises:
        InputError: a point has the wrong number of values, or a value is not finite.
    """
    rows = [np.asarray(getattr(point, field), dtype=float) for point in points]
    if not any(row.size for row in rows):
        return None
    for i, row in enumerate(rows):
        if row.shape != (n,):
            raise InputError(f"point {i} has {row.size} {field} for {n} joints")
        if not np.all(np.isfinite(row)):
            raise InputError(f"point {i}: {field} has a value that is not finite")
    return np.array(rows)


def joint_state_from_message(message: Any, model: RobotModel) -> JointState | None:
    """Convert a sensor_msgs/JointState message to a joint state of armcell, without the mimic joints.

    Returns:
        The joint state, or None if the message names no actuated joint.
    Raises:
        UnknownNameError: a joint does not exist.
        InputError: a joint is repeated, the number of positions differs from the number of names, or a value
            is not finite.
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


def trajectory_message(schema: Schema, header: Any, trajectory: JointTrajectory) -> Any:
    """Convert a trajectory of armcell to a trajectory_msgs/JointTrajectory message.

    Velocities and accelerations are included if the trajectory has them.
    """
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
