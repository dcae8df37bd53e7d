"""Conversion of planning requests, goals, constraints: MotionPlanRequest, GetCartesianPath, Constraints."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from armcell.core import (
    ADAPTERS,
    SE3,
    Box,
    CartesianRequest,
    ConstraintGoal,
    Constraints,
    ErrorCode,
    Goal,
    InputError,
    JointConstraint,
    JointGoal,
    JointState,
    OrientationConstraint,
    PlanRequest,
    PoseGoal,
    PositionConstraint,
    Sphere,
    VisibilityConstraint,
)
from armcell.core.requests import Corner
from armcell.ros.convert import pose_from_message, pose_message
from armcell.ros.faults import ERROR_CODES, SOURCE
from armcell.ros.moveit_convert.objects import ShapeMessages, frame_of, shapes_from_message
from armcell.ros.moveit_convert.states import robot_state_from_message
from armcell.ros.schema import Schema
from armcell.scene import PlanningScene

XYZ_EULER_ANGLES, ROTATION_VECTOR = 0, 1  # moveit_msgs/OrientationConstraint
PARAMETERIZATIONS = {XYZ_EULER_ANGLES: "xyz_euler", ROTATION_VECTOR: "rotation_vector"}
VIEW_AXES = {0: "z", 1: "y", 2: "x"}  # moveit_msgs/VisibilityConstraint
DEFAULT_TIME = 5.0  # [s] if a request gives no planning time
MOVE_GROUP_ADAPTERS = (ADAPTERS[0], "fix_start_state_collision", *ADAPTERS[1:])
"""Request adapters of MoveIt's default chain.

It includes FixStartStateCollision, because a grasped object still touches its support at the start.
"""


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
    """List the fields of a moveit_msgs/OrientationConstraint message in a request that still have their
    default values.
    """
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
    """Convert the joint constraints in a MoveIt planning request to a `JointGoal`, or to a `ConstraintGoal`
    if their tolerances differ.
    """
    tolerances = {t for c in wanted.joints for t in (c.tolerance_above, c.tolerance_below)}
    names = [c.joint for c in wanted.joints]
    if len(tolerances) > 1 or len(set(names)) < len(names):
        return ConstraintGoal(wanted)
    state = JointState(tuple(names), np.array([c.position for c in wanted.joints]))
    return JointGoal(state, tolerance=tolerances.pop())


def _pose_goal(wanted: Constraints, scene: PlanningScene) -> PoseGoal | None:
    """Convert the position constraint (sphere or cube) and the orientation constraint in a MoveIt planning
    request to one `PoseGoal`.

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


def error_code_message(schema: Schema, code: ErrorCode | int, message: str = "") -> Any:
    """Create the moveit_msgs/MoveItErrorCodes message in the answer to a MoveIt request, from an error code
    and a text.

    Only MoveIt 2 clients receive the text and its source.
    """
    return schema.new(ERROR_CODES, int(code), message, SOURCE if message else "")


def plan_request_from_message(
    message: Any, scene: PlanningScene, parameters: Mapping[str, Any] | None = None
) -> PlanRequest:
    """Convert a moveit_msgs/MotionPlanRequest message to a `PlanRequest`.
    Empty fields get the defaults of MoveIt's move_group node.

    An empty pipeline or planner selects the default, a scaling factor outside (0, 1] becomes 1, a missing
    planning time becomes 5 s, and less than one attempt becomes one. The workspace applies only if its frame
    is empty, as `set_workspace` in armcell's scripts sends it: RViz and MoveIt's clients set a frame, and
    their workspace is meant for mobile bases.

    Args:
        message: the MotionPlanRequest message.
        scene: planning scene for looking up frames.
        parameters: planner parameters that a client set with set_planner_params.
    Raises:
        InputError: a joint or frame is unknown, or a constraint is invalid.
    """
    if message.trajectory_constraints.constraints:
        raise InputError("trajectory constraints are not planned for", hint="use path constraints")
    goals = tuple(goal_from_message(c, scene) for c in message.goal_constraints)
    if not goals:
        raise InputError("the request has no goal", hint="set a target first")
    return PlanRequest(
        message.group_name,
        goals,
        start=robot_state_from_message(message.start_state, scene),
        planner_id=message.planner_id,
        pipeline_id=message.pipeline_id,
        planning_time=float(message.allowed_planning_time)
        if message.allowed_planning_time > 0
        else DEFAULT_TIME,
        attempts=max(int(message.num_planning_attempts), 1),
        velocity_scaling=_scaling(message.max_velocity_scaling_factor),
        acceleration_scaling=_scaling(message.max_acceleration_scaling_factor),
        path_constraints=constraints_from_message(message.path_constraints),
        parameters=parameters or {},
        workspace=_workspace(message.workspace_parameters),
        max_cartesian_speed=float(message.max_cartesian_speed) or None,
        speed_link=message.cartesian_speed_limited_link
        or message.cartesian_speed_end_effector_link  # Humble's name
        or None,
        adapters=MOVE_GROUP_ADAPTERS,
    )


def _scaling(value: float) -> float:
    return float(value) if 0 < value <= 1 else 1.0


def _workspace(message: Any) -> tuple[Corner, Corner] | None:
    low = (message.min_corner.x, message.min_corner.y, message.min_corner.z)
    high = (message.max_corner.x, message.max_corner.y, message.max_corner.z)
    if message.header.frame_id or not (any(low) or any(high)):
        return None
    if low[2] == high[2] == 0.0:  # set_workspace with four values does not limit the height
        low, high = (low[0], low[1], -np.inf), (high[0], high[1], np.inf)
    return low, high


def cartesian_request_from_message(message: Any, scene: PlanningScene) -> CartesianRequest:
    """Convert the request of a moveit_msgs/GetCartesianPath service to a `CartesianRequest`.

    Waypoints are in the header's frame. A jump threshold of 0 allows any jump, as in MoveIt. If a request
    sets no threshold at all, armcell's defaults apply (0.2 rad and 0.05 m), because a path with jumps is not
    a straight line.

    Args:
        message: the GetCartesianPath request.
        scene: planning scene for looking up frames.
    Raises:
        InputError: the request has no waypoints, a step that is not positive, or an unknown joint or frame.
    """
    if not len(message.waypoints):
        raise InputError("no waypoints")
    if not message.max_step > 0:
        raise InputError(f"the step is {message.max_step:g} m", hint="give one above 0, such as 0.01")
    start = robot_state_from_message(message.start_state, scene)
    placed = scene if start is None else scene.with_state(start)
    T = placed.frame_pose(frame_of(message.header))
    values: dict[str, float] = {}
    given = (message.jump_threshold, message.revolute_jump_threshold, message.prismatic_jump_threshold)
    if any(v > 0 for v in given):
        values = {
            "relative_jump_threshold": max(float(given[0]), 0.0),
            "jump_threshold": max(float(given[1]), 0.0),
            "prismatic_jump_threshold": max(float(given[2]), 0.0),
        }
    return CartesianRequest(
        message.group_name,
        tuple(T @ pose_from_message(p) for p in message.waypoints),
        message.link_name or None,
        start,
        max_step=float(message.max_step),
        avoid_collisions=bool(message.avoid_collisions),
        path_constraints=constraints_from_message(message.path_constraints),
        velocity_scaling=_scaling(message.max_velocity_scaling_factor),  # field exists only in ROS 2
        acceleration_scaling=_scaling(message.max_acceleration_scaling_factor),
        max_cartesian_speed=float(message.max_cartesian_speed) or None,
        **values,
    )
