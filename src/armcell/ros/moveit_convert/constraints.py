"""Conversion of constraints and goals from and to moveit_msgs/Constraints."""

from __future__ import annotations

from typing import Any

import numpy as np

from armcell.core import (
    SE3,
    Box,
    ConstraintGoal,
    Constraints,
    Goal,
    InputError,
    JointConstraint,
    JointGoal,
    JointState,
    OrientationConstraint,
    PoseGoal,
    PositionConstraint,
    Sphere,
    VisibilityConstraint,
)
from armcell.ros.convert import pose_from_message, pose_message
from armcell.ros.moveit_convert.objects import frame_of, shapes_from_message
from armcell.ros.moveit_convert.shapes import ShapeMessages
from armcell.ros.schema import Schema
from armcell.scene import PlanningScene

XYZ_EULER_ANGLES, ROTATION_VECTOR = 0, 1  # moveit_msgs/OrientationConstraint
PARAMETERIZATIONS = {XYZ_EULER_ANGLES: "xyz_euler", ROTATION_VECTOR: "rotation_vector"}
VIEW_AXES = {0: "z", 1: "y", 2: "x"}  # moveit_msgs/VisibilityConstraint


def constraints_from_message(message: Any) -> Constraints:
    """Convert a moveit_msgs/Constraints message to `Constraints` of armcell.

    This function does not check whether the constraints are consistent; the planner does.

    Raises:
        InputError: an unknown orientation parameterization or sensor view direction, or an invalid pose.
    """
    return Constraints(
        joints=tuple(
            JointConstraint(
                c.joint_name, float(c.position), float(c.tolerance_above), float(c.tolerance_below)
            )
            for c in message.joint_constraints
        ),
        positions=tuple(_position(c) for c in message.position_constraints),
        orientations=tuple(_orientation(c) for c in message.orientation_constraints),
        name=message.name,
        visibilities=tuple(_visibility(c) for c in message.visibility_constraints),
    )


def _position(c: Any) -> PositionConstraint:
    offset = c.target_point_offset
    return PositionConstraint(
        shapes_from_message(c.constraint_region),
        c.link_name or None,
        (offset.x, offset.y, offset.z),
        frame_of(c.header),
    )


def _orientation(c: Any) -> OrientationConstraint:
    if int(c.parameterization) not in PARAMETERIZATIONS:
        raise InputError(
            f"orientation parameterization {c.parameterization}", hint="0 Euler, 1 rotation vector"
        )
    q = c.orientation
    length = float(np.linalg.norm([q.x, q.y, q.z, q.w]))
    if not np.isfinite(length) or length < 1e-6:
        raise InputError(
            f"an orientation constraint leaves open: {', '.join(_unset(c))}",
            hint="orientation.w = 1.0 is no rotation; link_name is usually the group's tip",
        )
    rotation = SE3.from_quat_xyzw((0, 0, 0), np.array([q.x, q.y, q.z, q.w]) / length).rotation
    tolerance = (c.absolute_x_axis_tolerance, c.absolute_y_axis_tolerance, c.absolute_z_axis_tolerance)
    return OrientationConstraint(
        rotation, tuple(float(t) for t in tolerance), c.link_name or None, frame_of(c.header),  # type: ignore[arg-type]
        PARAMETERIZATIONS[int(c.parameterization)],
    )  # fmt: skip


def _unset(c: Any) -> list[str]:
    """List the fields of a moveit_msgs/OrientationConstraint message that still have their default values."""
    tolerances = (c.absolute_x_axis_tolerance, c.absolute_y_axis_tolerance, c.absolute_z_axis_tolerance)
    return [
        *([] if c.link_name else ["link_name (empty)"]),
        "orientation (all zeros)",
        *([] if any(tolerances) else ["absolute_x/y/z_axis_tolerance (0)"]),
    ]


def _visibility(c: Any) -> VisibilityConstraint:
    axis = VIEW_AXES.get(int(c.sensor_view_direction), "")
    if axis not in ("z", "x"):
        raise InputError("a sensor that looks along its y axis is not known", hint="SENSOR_Z or SENSOR_X")
    return VisibilityConstraint(
        sensor=frame_of(c.sensor_pose.header),
        T_frame_target=pose_from_message(c.target_pose.pose),
        target_radius=float(c.target_radius),
        frame=frame_of(c.target_pose.header),
        T_link_sensor=pose_from_message(c.sensor_pose.pose),
        view_axis=axis,
        max_view_angle=float(c.max_view_angle) or None,  # 0 means no limit, as in MoveIt
        max_range_angle=float(c.max_range_angle) or None,
        cone_sides=int(c.cone_sides),
    )


def goal_from_message(message: Any, scene: PlanningScene) -> Goal:
    """Convert the goal in a moveit_msgs/Constraints message to a `JointGoal`, `PoseGoal` or `ConstraintGoal`.

    Joint constraints become a `JointGoal`, a position with an orientation of one link becomes a `PoseGoal`,
    and any other combination becomes a `ConstraintGoal`.

    Raises:
        InputError: the message contains no constraints, or names an unknown frame.
    """
    wanted = constraints_from_message(message)
    if not wanted:
        raise InputError(
            "the goal has no constraints", hint="set a joint, pose, position or orientation target"
        )
    kinds = [len(x) for x in (wanted.joints, wanted.positions, wanted.orientations, wanted.visibilities)]
    if kinds[1:] == [0, 0, 0]:
        return _joint_goal(wanted)
    if kinds == [0, 1, 1, 0]:
        return _pose_goal(wanted, scene) or ConstraintGoal(wanted)
    return ConstraintGoal(wanted)


def _joint_goal(wanted: Constraints) -> Goal:
    """Convert joint constraints to a `JointGoal`, or to a `ConstraintGoal` if their tolerances differ."""
    tolerances = {t for c in wanted.joints for t in (c.tolerance_above, c.tolerance_below)}
    names = [c.joint for c in wanted.joints]
    if len(tolerances) > 1 or len(set(names)) < len(names):
        return ConstraintGoal(wanted)
    state = JointState(tuple(names), np.array([c.position for c in wanted.joints]))
    return JointGoal(state, tolerance=tolerances.pop())


def _pose_goal(wanted: Constraints, scene: PlanningScene) -> PoseGoal | None:
    """Convert a position constraint (sphere or cube) and an orientation constraint to one `PoseGoal`.

    Returns None if the constraints have another form.
    """
    position, orientation = wanted.positions[0], wanted.orientations[0]
    if position.link != orientation.link or any(position.point) or len(position.region) != 1:
        return None
    if orientation.parameterization != "rotation_vector" and len(set(orientation.tolerance)) > 1:
        return None
    shape, T_frame_shape = position.region[0]
    if isinstance(shape, Sphere):
        tolerance = shape.radius
    elif isinstance(shape, Box) and shape.x == shape.y == shape.z:
        tolerance = shape.x / 2  # radius of the inscribed sphere
    else:
        return None
    center = scene.frame_pose(position.frame) @ T_frame_shape
    turned = scene.frame_pose(orientation.frame).rotation @ orientation.rotation
    x, y, z = orientation.tolerance
    return PoseGoal(
        SE3(turned, center.translation), position.link, tolerance, x if x == y == z else (x, y, z)
    )


def constraints_message(schema: Schema, wanted: Constraints) -> Any:
    """Convert `Constraints` of armcell to a moveit_msgs/Constraints message in which every weight is 1."""
    header = lambda frame: schema.new("std_msgs/Header", frame_id=frame)  # noqa: E731
    joints = [
        schema.new(
            "moveit_msgs/JointConstraint", c.joint, c.position, c.tolerance_above, c.tolerance_below, 1.0
        )
        for c in wanted.joints
    ]
    positions = [
        schema.new(
            "moveit_msgs/PositionConstraint", header(c.frame), c.link or "",
            schema.new("geometry_msgs/Vector3", *c.point), _volume(schema, c), 1.0,
        )
        for c in wanted.positions
    ]  # fmt: skip
    orientations = []
    for c in wanted.orientations:
        kind = next(k for k, name in PARAMETERIZATIONS.items() if name == c.parameterization)
        quaternion = schema.new("geometry_msgs/Quaternion", *SE3(c.rotation, np.zeros(3)).quat_xyzw.tolist())
        orientations.append(
            schema.new(
                "moveit_msgs/OrientationConstraint", header(c.frame), quaternion, c.link or "", *c.tolerance,
                parameterization=kind, weight=1.0,
            )
        )  # fmt: skip
    visibilities = [_visibility_message(schema, c) for c in wanted.visibilities]
    return schema.new("moveit_msgs/Constraints", wanted.name, joints, positions, orientations, visibilities)


def _volume(schema: Schema, c: PositionConstraint) -> Any:
    lists = ShapeMessages(schema)
    for shape, T in c.region:
        lists.add(shape, T)
    return schema.new(
        "moveit_msgs/BoundingVolume",
        [m for m, _ in lists.primitives], [pose_message(schema, T) for _, T in lists.primitives],
        [m for m, _ in lists.meshes], [pose_message(schema, T) for _, T in lists.meshes],
    )  # fmt: skip


def _visibility_message(schema: Schema, c: VisibilityConstraint) -> Any:
    def stamped(frame: str, T: SE3) -> Any:
        return schema.new(
            "geometry_msgs/PoseStamped",
            schema.new("std_msgs/Header", frame_id=frame),
            pose_message(schema, T),
        )

    return schema.new(
        "moveit_msgs/VisibilityConstraint",
        target_radius=c.target_radius,
        target_pose=stamped(c.frame, c.T_frame_target),
        cone_sides=c.cone_sides,
        sensor_pose=stamped(c.sensor, c.T_link_sensor),
        max_view_angle=c.max_view_angle or 0.0,
        max_range_angle=c.max_range_angle or 0.0,
        sensor_view_direction=next(k for k, axis in VIEW_AXES.items() if axis == c.view_axis),
        weight=1.0,
    )
