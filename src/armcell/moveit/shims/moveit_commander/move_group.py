"""moveit_commander.MoveGroupCommander."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from armcell.core import ArmcellError, InputError, JointState
from armcell.kinematics import kinematic_tree
from armcell.moveit.calls import (
    SUCCESS,
    finished,
    joint_constraints,
    measured_scene,
    pose_constraints,
    send,
)
from armcell.moveit.session import current_session
from armcell.moveit.shims.moveit_commander.conversions import list_to_pose, list_to_pose_stamped, pose_to_list
from armcell.moveit.shims.moveit_commander.exception import MoveItCommanderException
from armcell.moveit.shims.transformations import euler_from_quaternion, quaternion_from_euler
from armcell.planning import solve_ik
from armcell.ros.moveit_convert import robot_state_from_message, robot_state_message, robot_trajectory_message
from armcell.ros.moveit_convert.objects import REMOVE, frame_of
from armcell.scene import WORLD
from armcell.timing import BlendedPath, parameterize

JOINT, POSE, POSITION, ORIENTATION = "joint", "pose", "position", "orientation"
TIMING = (
    "iterative_time_parameterization",
    "iterative_spline_parameterization",
    "time_optimal_trajectory_generation",
)
PICK, PLACE = "moveit_msgs/Pickup", "moveit_msgs/Place"


def _kind(value: Any) -> str:
    """A message's type without its package, or an empty text."""
    return getattr(value, "_type", "").split("/")[-1]


class MoveGroupCommander:
    """One planning group. Defaults, exceptions and return values are moveit_commander's.

    Raises:
        RuntimeError: no such group.
    """

    def __init__(
        self,
        name: str,
        robot_description: str = "robot_description",
        ns: str = "",
        wait_for_servers: float = 5.0,
    ):
        self._session = current_session()
        model = self._session.model
        if name not in model.groups:
            known = ", ".join(model.groups)
            raise RuntimeError(f"Group '{name}' was not found. This robot has: {known}")
        self._name, self._group, self._ns = name, model.group(name), ns.strip("/")
        self._eef = self._group.tip_link or ""
        self._frame = WORLD
        self._active = JOINT
        self._joint_target: dict[str, float] = {}
        self._poses: dict[str, list[Any]] = {}  # PoseStamped by link
        self._remembered: dict[str, list[float]] = {}
        self._start: Any = None
        self._joint_tolerance, self._position_tolerance, self._orientation_tolerance = 1e-4, 1e-4, 1e-3
        self._time, self._attempts, self._planner, self._pipeline = 5.0, 1, "", ""
        self._velocity = self._acceleration = 0.1
        self._scaled = False
        self._speed, self._speed_link = 0.0, ""
        self._path_constraints: Any = None
        self._trajectory_constraints: Any = None
        self._workspace = [0.0] * 6
        self._looking = self._replanning = False
        self._support = ""

    def _new(self, name: str, /, *values: Any, **fields: Any) -> Any:
        return self._session.new(f"moveit_msgs/{name}", *values, **fields)

    def _server(self, name: str) -> str:
        return f"/{self._ns}/{name}" if self._ns else f"/{name}"

    # --- about the group ---
    def get_name(self) -> str:
        return self._name

    def stop(self) -> None:
        """End what moves, also other groups: as MoveIt's trajectory_execution_event."""
        bus = self._session.bus
        with bus.advertise("/trajectory_execution_event", "std_msgs/String") as publisher:
            publisher.publish(bus.schema.new("std_msgs/String", "stop"))
        self._session.served.cell.stop()

    def get_active_joints(self) -> list[str]:
        return list(self._group.joint_names)

    def get_joints(self) -> list[str]:
        links = set(self._group.link_names)
        return [
            j.name for j in self._session.model.joints.values()
            if j.child in links or j.name in self._group.joint_names
        ]  # fmt: skip

    def _variables(self) -> list[str]:
        """Joints that move, those that mimic others too."""
        mine = set(self._group.joint_names)
        return [
            j.name for j in self._session.model.joints.values()
            if j.name in mine or (j.mimic is not None and j.mimic.joint in mine)
        ]  # fmt: skip

    def get_variable_count(self) -> int:
        return len(self._variables())

    def has_end_effector_link(self) -> bool:
        return bool(self._eef)

    def get_end_effector_link(self) -> str:
        return self._eef

    def set_end_effector_link(self, link_name: str) -> None:
        if link_name not in self._session.model.links:
            raise MoveItCommanderException("Unable to set end effector link")
        self._eef = link_name

    def get_interface_description(self) -> Any:
        found = self._session.call(
            self._server("query_planner_interface"), self._new("QueryPlannerInterfacesRequest")
        )
        return found.planner_interfaces[0]

    def get_pose_reference_frame(self) -> str:
        return self._frame

    def set_pose_reference_frame(self, reference_frame: str) -> None:
        self._frame = reference_frame or WORLD

    def get_planning_frame(self) -> str:
        return WORLD

    # --- state ---
    def get_current_joint_values(self) -> list[float]:
        scene = measured_scene()
        values = kinematic_tree(scene.model).full_positions(scene.positions)
        return [values[n] for n in self._variables()]

    def _link(self, end_effector_link: str, what: str) -> str:
        link = end_effector_link or self._eef
        if not link:
            raise MoveItCommanderException(f"There is no end effector to {what}")
        return link

    def get_current_pose(self, end_effector_link: str = "") -> Any:
        link = self._link(end_effector_link, "get the pose of")
        T = measured_scene().frame_pose(link)
        return list_to_pose_stamped([*T.translation, *T.quat_xyzw], self.get_planning_frame())

    def get_current_rpy(self, end_effector_link: str = "") -> list[float]:
        link = self._link(end_effector_link, "get the rpy of")
        return measured_scene().frame_pose(link).rotation.rpy.tolist()

    def get_random_joint_values(self) -> list[float]:
        names = self._group.joint_names
        model = self._session.model
        low = np.maximum(model.limits(names, "lower"), -np.pi)
        high = np.minimum(model.limits(names, "upper"), np.pi)
        return self._session.rng.uniform(low, high).tolist()

    def get_random_pose(self, end_effector_link: str = "") -> Any:
        link = self._link(end_effector_link, "get the pose of")
        scene = measured_scene().with_state(
            JointState(self._group.joint_names, np.array(self.get_random_joint_values()))
        )
        T = scene.frame_pose(link)
        return list_to_pose_stamped([*T.translation, *T.quat_xyzw], self.get_planning_frame())

    def set_start_state_to_current_state(self) -> None:
        self._start = None

    def set_start_state(self, msg: Any) -> None:
        """A RobotState; joints that it does not name stay where they are."""
        self._start = self._session.messages.local(msg)

    def get_current_state_bounded(self) -> Any:
        scene = measured_scene()
        return self._state(scene.with_positions(scene.model.enforce_bounds(scene.positions)))

    def get_current_state(self) -> Any:
        return self._state(measured_scene())

    def _state(self, scene: Any) -> Any:
        schema, header = self._session.bus.schema, self._session.bus.header(WORLD)
        return self._session.messages.local(robot_state_message(schema, header, scene))

    # --- targets ---
    def get_joint_value_target(self) -> list[float]:
        now = dict(zip(self._variables(), self.get_current_joint_values()))
        values = {**now, **self._joint_target}
        return [values[n] for n in self._group.joint_names]

    def set_joint_value_target(self, arg1: Any, arg2: Any = None, arg3: Any = None) -> None:
        kind = _kind(arg1)
        if kind == "RobotState":
            self._set_joints(
                dict(zip(arg1.joint_state.name, arg1.joint_state.position)), "state", others=True
            )
        elif kind == "JointState":
            self._no_more(arg2, arg3)
            self._set_joints(dict(zip(arg1.name, arg1.position)))
        elif isinstance(arg1, str):
            if arg2 is None:
                raise MoveItCommanderException("Joint value expected when joint name specified")
            if arg3 is not None:
                raise MoveItCommanderException("Too many arguments specified")
            self._set_joints({arg1: arg2})
        elif kind in ("Pose", "PoseStamped"):
            self._set_joints_by_ik(arg1, arg2, arg3)
        elif isinstance(arg1, Mapping):
            self._no_more(arg2, arg3)
            self._set_joints(dict(arg1))
        elif isinstance(arg1, Iterable):
            self._no_more(arg2, arg3)
            self._set_joints(self._by_name(list(arg1)))
        else:
            raise MoveItCommanderException(f"Unsupported argument of type {type(arg1)}")

    @staticmethod
    def _no_more(*arguments: Any) -> None:
        if any(a is not None for a in arguments):
            raise MoveItCommanderException("Too many arguments specified")

    def _by_name(self, values: list[Any]) -> dict[str, float]:
        for names in (list(self._group.joint_names), self._variables()):
            if len(names) == len(values):
                return dict(zip(names, values))
        raise MoveItCommanderException(
            f"Error setting joint target. {len(values)} values given, group {self._name!r} has "
            f"{len(self._group.joint_names)} joints: {', '.join(self._group.joint_names)}"
        )

    def _set_joints(self, values: dict[str, Any], what: str = "joint", others: bool = False) -> None:
        model = self._session.model
        target: dict[str, float] = {}
        for name, value in values.items():
            if name not in model.joints:
                raise MoveItCommanderException(f"Error setting joint target. There is no joint {name!r}")
            if name not in self._group.joint_names:
                if others or model.joints[name].mimic is not None:
                    continue
                raise MoveItCommanderException(
                    f"Error setting joint target. Group {self._name!r} does not move joint {name!r}"
                )
            limits, number = model.joints[name].limits, float(value)
            out = not limits.lower - self._joint_tolerance <= number <= limits.upper + self._joint_tolerance
            if out or not np.isfinite(number):
                degrees = "; are these degrees?" if abs(number) > 2 * np.pi + 0.01 else ""
                raise MoveItCommanderException(
                    f"Error setting {what} target. Is the target within bounds? {name} = {number:g} is "
                    f"outside [{limits.lower:g}, {limits.upper:g}]{degrees}"
                )
            target[name] = number
        self._joint_target.update(target)
        self._active = JOINT

    def _set_joints_by_ik(self, pose: Any, arg2: Any, arg3: Any) -> None:
        link, approximate = "", False
        for argument in (arg2, arg3):
            if isinstance(argument, bool):
                approximate = argument
            elif isinstance(argument, str):
                link = argument
            elif argument is not None:
                raise MoveItCommanderException("Unexpected type")
        link = self._link(link, "set the pose for")
        scene = measured_scene()
        try:
            result = solve_ik(scene, self._name, self._in_world(scene, self._stamped(pose)), link)
        except ArmcellError as error:
            raise MoveItCommanderException(f"Error setting joint target. {error}") from None
        if result.positions is None or not (result.ok or approximate):
            raise MoveItCommanderException(
                f"Error setting joint target. Is the IK solver functional? {result.message}"
            )
        self._set_joints(dict(zip(self._group.joint_names, result.positions.tolist())))

    def _in_world(self, scene: Any, stamped: Any) -> Any:
        from armcell.ros.convert import pose_from_message

        return scene.frame_pose(frame_of(stamped.header)) @ pose_from_message(stamped.pose)

    def _stamped(self, pose: Any) -> Any:
        """Pose, PoseStamped or a list as the script's own PoseStamped: later changes of theirs are theirs."""
        local = self._session.messages.local
        if _kind(pose) == "PoseStamped":
            own = local(pose)
            own.header.frame_id = own.header.frame_id or self._frame
            return own
        if _kind(pose) == "Pose":
            own = self._session.new("geometry_msgs/PoseStamped", pose=local(pose))
        else:
            own = self._session.new("geometry_msgs/PoseStamped", pose=list_to_pose(pose))
        own.header.frame_id = self._frame
        return own

    def _target(self, end_effector_link: str, active: str, poses: list[Any]) -> None:
        link = self._link(end_effector_link, "set the pose for")
        self._poses[link] = poses
        self._active = active

    def set_rpy_target(self, rpy: Any, end_effector_link: str = "") -> None:
        if len(rpy) != 3:
            raise MoveItCommanderException("Expected [roll, pitch, yaw]")
        self.set_orientation_target(quaternion_from_euler(*map(float, rpy)).tolist(), end_effector_link)

    def set_orientation_target(self, q: Any, end_effector_link: str = "") -> None:
        link = self._link(end_effector_link, "set the pose for")
        if len(q) != 4:
            raise MoveItCommanderException("Expected [qx, qy, qz, qw]")
        before = self._last(link)
        self._target(link, ORIENTATION, [self._stamped([*before[:3], *q])])

    def set_position_target(self, xyz: Any, end_effector_link: str = "") -> None:
        link = self._link(end_effector_link, "set the pose for")
        if len(xyz) != 3:
            raise MoveItCommanderException("Unable to set position target")
        self._target(link, POSITION, [self._stamped([*map(float, xyz), *self._last(link)[3:]])])

    def _last(self, link: str) -> list[float]:
        """The last pose that was wanted of a link, else the present one."""
        if self._poses.get(link):
            return pose_to_list(self._poses[link][0].pose)
        return pose_to_list(self.get_current_pose(link).pose)

    def set_pose_target(self, pose: Any, end_effector_link: str = "") -> None:
        self._link(end_effector_link, "set the pose for")
        try:
            self._target(end_effector_link, POSE, [self._stamped(pose)])
        except (TypeError, ValueError, InputError):
            raise MoveItCommanderException("Unable to set target pose") from None

    def set_pose_targets(self, poses: Any, end_effector_link: str = "") -> None:
        """Any one of them."""
        self._link(end_effector_link, "set the pose for")
        try:
            self._target(end_effector_link, POSE, [self._stamped(p) for p in poses])
        except (TypeError, ValueError, InputError):
            raise MoveItCommanderException("Unable to set target poses") from None

    def shift_pose_target(self, axis: int, value: float, end_effector_link: str = "") -> None:
        """The present pose moved along x, y, z or turned by roll, pitch, yaw (0 to 5)."""
        link = self._link(end_effector_link, "set the pose for")
        if axis not in range(6):
            raise MoveItCommanderException(
                "An integer value between 0 and 5 expected as the axis of the shift"
            )
        pose = pose_to_list(self.get_current_pose(link).pose)
        if axis > 2:
            pose = [*pose[:3], *euler_from_quaternion(pose[3:])]
        pose[axis] += value
        self._frame_then(WORLD, lambda: self.set_pose_target(pose, link))

    def _frame_then(self, frame: str, act: Any) -> None:
        before, self._frame = self._frame, frame
        try:
            act()
        finally:
            self._frame = before

    def clear_pose_target(self, end_effector_link: str) -> None:
        self._poses.pop(end_effector_link or self._eef, None)

    def clear_pose_targets(self) -> None:
        self._poses.clear()

    def set_random_target(self) -> None:
        self._set_joints(dict(zip(self._group.joint_names, self.get_random_joint_values())))

    # --- named ---
    def get_named_targets(self) -> list[str]:
        return [*self._session.model.named_states.get(self._name, {}), *self._remembered]

    def set_named_target(self, name: str) -> None:
        try:
            self._set_joints(self.get_named_target_values(name))
        except MoveItCommanderException as error:
            known = ", ".join(self.get_named_targets())
            text = f"Unable to set target {name}. Is the target within bounds?"
            more = (
                f" It is not known; known: {known}" if name not in self.get_named_targets() else f" {error}"
            )
            raise MoveItCommanderException(text + more) from None

    def get_named_target_values(self, target: str) -> dict[str, float]:
        if target in self._remembered:
            return self._by_name(self._remembered[target])
        return dict(self._session.model.named_states.get(self._name, {}).get(target, {})) or self._nothing(
            target
        )

    @staticmethod
    def _nothing(target: str) -> dict[str, float]:
        raise MoveItCommanderException(f"Unable to set target {target}. Is the target within bounds?")

    def remember_joint_values(self, name: str, values: Any = None) -> None:
        self._remembered[name] = (
            self.get_current_joint_values() if values is None else [float(v) for v in values]
        )

    def get_remembered_joint_values(self) -> dict[str, list[float]]:
        return {name: list(values) for name, values in self._remembered.items()}

    def forget_joint_values(self, name: str) -> None:
        self._remembered.pop(name, None)

    # --- tolerances ---
    def get_goal_tolerance(self) -> tuple[float, float, float]:
        return self._joint_tolerance, self._position_tolerance, self._orientation_tolerance

    def get_goal_joint_tolerance(self) -> float:
        return self._joint_tolerance

    def get_goal_position_tolerance(self) -> float:
        return self._position_tolerance

    def get_goal_orientation_tolerance(self) -> float:
        return self._orientation_tolerance

    def set_goal_tolerance(self, value: float) -> None:
        self.set_goal_joint_tolerance(value)
        self.set_goal_position_tolerance(value)
        self.set_goal_orientation_tolerance(value)

    def set_goal_joint_tolerance(self, value: float) -> None:
        self._joint_tolerance = float(value)

    def set_goal_position_tolerance(self, value: float) -> None:
        self._position_tolerance = float(value)

    def set_goal_orientation_tolerance(self, value: float) -> None:
        self._orientation_tolerance = float(value)

    # --- constraints ---
    def allow_looking(self, value: bool) -> None:
        self._looking = bool(value)

    def allow_replanning(self, value: bool) -> None:
        self._replanning = bool(value)

    def get_known_constraints(self) -> list[str]:
        """Those of the constraints database: there is none."""
        return []

    def get_path_constraints(self) -> Any:
        return self._session.messages.local(self._path_constraints or self._new("Constraints"))

    def set_path_constraints(self, value: Any) -> None:
        if value is None:
            self.clear_path_constraints()
        elif _kind(value) == "Constraints":
            self._path_constraints = self._session.messages.local(value)
        else:
            raise MoveItCommanderException(f"Unable to set path constraints {value}")

    def clear_path_constraints(self) -> None:
        self._path_constraints = None

    def get_trajectory_constraints(self) -> Any:
        return self._session.messages.local(
            self._trajectory_constraints or self._new("TrajectoryConstraints")
        )

    def set_trajectory_constraints(self, value: Any) -> None:
        if value is None:
            self.clear_trajectory_constraints()
        elif _kind(value) == "TrajectoryConstraints":
            self._trajectory_constraints = self._session.messages.local(value)
        else:
            raise MoveItCommanderException(f"Unable to set trajectory constraints {value}")

    def clear_trajectory_constraints(self) -> None:
        self._trajectory_constraints = None

    def set_constraints_database(self, host: str, port: int) -> None:
        self._session.hint(
            "database", "there is no constraints database; set_path_constraints takes a message"
        )

    # --- planner ---
    def set_planning_time(self, seconds: float) -> None:
        self._time = float(seconds)

    def get_planning_time(self) -> float:
        return self._time

    def set_planning_pipeline_id(self, planning_pipeline: str) -> None:
        self._pipeline = planning_pipeline

    def get_planning_pipeline_id(self) -> str:
        return self._pipeline

    def set_planner_id(self, planner_id: str) -> None:
        self._planner = planner_id

    def get_planner_id(self) -> str:
        return self._planner

    def set_num_planning_attempts(self, num_planning_attempts: int) -> None:
        self._attempts = int(num_planning_attempts)

    def set_workspace(self, ws: Any) -> None:
        ws = list(ws)
        if len(ws) not in (0, 4, 6):
            raise MoveItCommanderException("Expected 0, 4 or 6 values in list specifying workspace")
        if len(ws) == 4:
            ws = [ws[0], ws[1], 0.0, ws[2], ws[3], 0.0]
        self._workspace = [float(v) for v in ws] or [0.0] * 6

    def set_max_velocity_scaling_factor(self, value: float) -> None:
        self._velocity, self._scaled = self._factor(value), True

    def set_max_acceleration_scaling_factor(self, value: float) -> None:
        self._acceleration, self._scaled = self._factor(value), True

    @staticmethod
    def _factor(value: float) -> float:
        if not 0 < value <= 1:
            raise MoveItCommanderException("Expected value in the range from 0 to 1 for scaling factor")
        return float(value)

    def limit_max_cartesian_link_speed(self, speed: float, link_name: str = "") -> None:
        self._speed, self._speed_link = float(speed), link_name

    def clear_max_cartesian_link_speed(self) -> None:
        self._speed, self._speed_link = 0.0, ""

    # --- planning and moving ---
    def construct_motion_plan_request(self) -> Any:
        local, low, high = self._session.messages.local, self._workspace[:3], self._workspace[3:]
        request = self._new(
            "MotionPlanRequest",
            goal_constraints=self._goals(),
            pipeline_id=self._pipeline,
            planner_id=self._planner,
            group_name=self._name,
            num_planning_attempts=self._attempts,
            allowed_planning_time=self._time,
            max_velocity_scaling_factor=self._velocity,
            max_acceleration_scaling_factor=self._acceleration,
            cartesian_speed_limited_link=self._speed_link,
            max_cartesian_speed=self._speed,
        )
        request.workspace_parameters.min_corner = self._session.new("geometry_msgs/Vector3", *low)
        request.workspace_parameters.max_corner = self._session.new("geometry_msgs/Vector3", *high)
        if self._start is None:
            request.start_state.is_diff = True
        else:
            request.start_state = local(self._start)
        if self._path_constraints is not None:
            request.path_constraints = local(self._path_constraints)
        if self._trajectory_constraints is not None:
            request.trajectory_constraints = local(self._trajectory_constraints)
        return request

    def _goals(self) -> list[Any]:
        if self._active == JOINT:
            values = dict(zip(self._group.joint_names, self.get_joint_value_target()))
            return [joint_constraints(self._session, values, self._joint_tolerance)]
        position = None if self._active == ORIENTATION else self._position_tolerance
        orientation = None if self._active == POSITION else self._orientation_tolerance
        merged: list[Any] = []
        for link, poses in self._poses.items():
            for i, pose in enumerate(poses):
                found = pose_constraints(self._session, link, pose, position, orientation)
                if i == len(merged):
                    merged.append(found)
                else:
                    merged[i].position_constraints += found.position_constraints
                    merged[i].orientation_constraints += found.orientation_constraints
        return merged

    def _take_target(self, joints: Any) -> None:
        """What `go` and `plan` accept: a JointState, Pose, remembered or named state, or values."""
        if joints is None:
            return
        if _kind(joints) == "JointState":
            self.set_joint_value_target(joints)
        elif _kind(joints) == "Pose":
            self.set_pose_target(joints)
        else:
            try:
                remembered = self._remembered[joints]
            except (KeyError, TypeError):
                self.set_joint_value_target(joints)
            else:
                self.set_joint_value_target(remembered)

    def _goal(self, plan_only: bool) -> Any:
        if not self._scaled:
            self._session.hint(
                f"scaling {self._name}",
                f"{self._name} moves at 0.1 of its limits, MoveIt's default; "
                "set_max_velocity_scaling_factor changes that",
            )
        goal = self._new("MoveGroupGoal", self.construct_motion_plan_request())
        options = goal.planning_options
        options.plan_only, options.look_around, options.replan = plan_only, self._looking, self._replanning
        options.replan_attempts = 3 if self._replanning else 0
        options.planning_scene_diff.is_diff = options.planning_scene_diff.robot_state.is_diff = True
        return goal

    def _send(self, action: str, goal: Any) -> Any:
        kind = {
            "move_group": "MoveGroup",
            "execute_trajectory": "ExecuteTrajectory",
            "pickup": "Pickup",
            "place": "Place",
        }
        return send(self._session, self._server(action), f"moveit_msgs/{kind[action]}", goal)

    def go(self, joints: Any = None, wait: bool = True) -> bool:
        if isinstance(joints, bool):
            wait, joints = joints, None
        self._take_target(joints)
        sent = self._send("move_group", self._goal(plan_only=False))
        if not wait:
            return True
        return bool(finished(self._session, sent).error_code.val == SUCCESS)

    def plan(self, joints: Any = None) -> tuple[bool, Any, float, Any]:
        """(success, RobotTrajectory, planning time [s], MoveItErrorCodes)."""
        self._take_target(joints)
        result = finished(self._session, self._send("move_group", self._goal(plan_only=True)))
        code = result.error_code
        return code.val == SUCCESS, result.planned_trajectory, result.planning_time, code

    def compute_cartesian_path(
        self, waypoints: Any, eef_step: float, avoid_collisions: Any = None, path_constraints: Any = None,
        *more: Any, jump_threshold: float | None = None,
    ) -> tuple[Any, float]:  # fmt: skip
        """(RobotTrajectory, fraction). The third argument may be a jump threshold, as it was up to 1.1.14."""
        third = avoid_collisions
        rest = [path_constraints, *more]
        if third is not None and not isinstance(third, bool | np.bool_):
            self._session.hint(
                "jump_threshold",
                f"compute_cartesian_path's third argument {third!r} is taken as jump_threshold; since MoveIt "
                "1.1.15 it is avoid_collisions, where 0.0 would switch collision checks off",
            )
            jump_threshold, third = float(third), None
            if rest and isinstance(rest[0], bool | np.bool_):
                third = rest.pop(0)
        constraints = next((c for c in rest if c is not None), None)
        if constraints is not None and _kind(constraints) != "Constraints":
            raise MoveItCommanderException(
                "Unable to set path constraints, unknown constraint type " + str(type(constraints))
            )
        request = self._new(
            "GetCartesianPathRequest",
            group_name=self._name,
            link_name=self._eef,
            waypoints=[self._session.messages.local(getattr(p, "pose", p)) for p in waypoints],
            max_step=float(eef_step),
            jump_threshold=float(jump_threshold or 0.0),
            avoid_collisions=True if third is None else bool(third),
            cartesian_speed_limited_link=self._speed_link,
            max_cartesian_speed=self._speed,
        )
        request.header.frame_id = self._frame
        if self._start is None:
            request.start_state.is_diff = True
        else:
            request.start_state = self._session.messages.local(self._start)
        wanted = constraints if constraints is not None else self._path_constraints
        if wanted is not None:
            request.path_constraints = self._session.messages.local(wanted)
        found = self._session.call(self._server("compute_cartesian_path"), request)
        return found.solution, found.fraction

    def execute(self, plan_msg: Any, wait: bool = True) -> bool:
        """A RobotTrajectory. What plan() returned is taken, too: its trajectory, unless the plan failed."""
        if isinstance(plan_msg, tuple | list) and len(plan_msg) == 4:
            self._session.hint(
                "plan tuple",
                "plan() returns (success, trajectory, time, error_code): `if plan:` is always true, and "
                "execute() wants plan[1]; the trajectory was taken out",
            )
            success, plan_msg = plan_msg[0], plan_msg[1]
            if not success:
                self._session.say(
                    "WARN", f"execute: the plan for {self._name} had failed; nothing is executed"
                )
                return False
        if _kind(plan_msg) == "JointTrajectory":
            plan_msg = self._new("RobotTrajectory", joint_trajectory=plan_msg)
        if _kind(plan_msg) != "RobotTrajectory":
            raise MoveItCommanderException(f"execute wants a RobotTrajectory, not {type(plan_msg).__name__}")
        sent = self._send("execute_trajectory", self._new("ExecuteTrajectoryGoal", plan_msg))
        if not wait:
            return True
        return bool(finished(self._session, sent).error_code.val == SUCCESS)

    # --- objects ---
    def attach_object(self, object_name: str, link_name: str = "", touch_links: Any = ()) -> bool:
        link = link_name or self._eef
        if not link:
            return False
        model = self._session.model
        touch = list(touch_links) or [
            n for g in model.grippers.values() if self._name in (g.arm_group, g.group) for n in g.hand_links
        ]
        item = self._new("CollisionObject", id=object_name)
        attached = self._new("AttachedCollisionObject", link_name=link, object=item, touch_links=touch)
        return self._apply([attached])

    def detach_object(self, name: str = "") -> bool:
        """An object by its name, what a link carries, or all that the group carries."""
        link = name if name in self._session.model.links else ""
        bodies = measured_scene().attached
        links = {self._eef, *self._group.link_names}
        for gripper in self._session.model.grippers.values():
            if self._name in (gripper.arm_group, gripper.group):
                links |= {gripper.tcp_link, *gripper.hand_links}
        mine = [
            n
            for n, b in bodies.items()
            if n == name or (b.link == link if link else not name and b.link in links)
        ]
        if not mine:
            return False
        return self._apply([
            self._new("AttachedCollisionObject", object=self._new("CollisionObject", id=n, operation=REMOVE))
            for n in mine
        ])  # fmt: skip

    def _apply(self, attached: list[Any]) -> bool:
        scene = self._new("PlanningScene", is_diff=True)
        scene.robot_state.is_diff = True
        scene.robot_state.attached_collision_objects = attached
        request = self._new("ApplyPlanningSceneRequest", scene)
        return bool(self._session.call(self._server("apply_planning_scene"), request).success)

    def pick(self, object_name: str, grasp: Any = (), plan_only: bool = False) -> int:
        """The error code. Without grasps they are found; approach, lift and force where they are missing."""
        grasps = [grasp] if _kind(grasp) == "Grasp" else list(grasp)
        goal = self._new(
            "PickupGoal", target_name=object_name, group_name=self._name, possible_grasps=grasps,
            support_surface_name=self._support, allowed_planning_time=self._time, planner_id=self._planner,
        )  # fmt: skip
        return self._picked_or_placed("pickup", goal, plan_only)

    def place(self, object_name: str, location: Any = None, plan_only: bool = False) -> int:
        """The error code. A location is where the object is to be."""
        goal = self._new(
            "PlaceGoal", group_name=self._name, attached_object_name=object_name,
            place_locations=self._locations(location), support_surface_name=self._support,
            allowed_planning_time=self._time, planner_id=self._planner,
        )  # fmt: skip
        return self._picked_or_placed("place", goal, plan_only)

    def _locations(self, location: Any) -> list[Any]:
        if location is None:
            return []
        kinds = ("Pose", "PoseStamped", "PlaceLocation")
        items = [location] if _kind(location) in kinds else list(location)
        found = []
        for item in items:
            if _kind(item) not in kinds:
                raise MoveItCommanderException(
                    "Parameter location must be a Pose, PoseStamped, PlaceLocation, list of PoseStamped or "
                    "list of PlaceLocation object"
                )
            if _kind(item) == "PlaceLocation":
                found.append(item)
            else:
                found.append(self._new("PlaceLocation", place_pose=self._stamped(item)))
        return found

    def _picked_or_placed(self, action: str, goal: Any, plan_only: bool) -> int:
        options = goal.planning_options
        options.plan_only = plan_only
        options.planning_scene_diff.is_diff = options.planning_scene_diff.robot_state.is_diff = True
        if self._path_constraints is not None:
            goal.path_constraints = self._session.messages.local(self._path_constraints)
        result = finished(self._session, self._send(action, goal))
        return int(result.error_code.val)

    def set_support_surface_name(self, value: str) -> None:
        self._support = value

    # --- trajectories and kinematics ---
    def retime_trajectory(
        self, ref_state_in: Any, traj_in: Any, velocity_scaling_factor: float = 1.0,
        acceleration_scaling_factor: float = 1.0, algorithm: str = TIMING[0],
    ) -> Any:  # fmt: skip
        """The same way with new times: as fast as the scaled limits allow, whichever algorithm is named."""
        if algorithm not in TIMING:
            self._session.say("ERROR", f"Unknown time parameterization algorithm: {algorithm}")
            return self._new("RobotTrajectory")
        points, names = traj_in.joint_trajectory.points, tuple(traj_in.joint_trajectory.joint_names)
        if not points:
            return self._new("RobotTrajectory")
        model = self._session.model
        velocity = model.limits(names, "velocity") * self._factor(velocity_scaling_factor)
        acceleration = model.limits(names, "acceleration") * self._factor(acceleration_scaling_factor)
        path = BlendedPath(np.array([p.positions for p in points], dtype=float), 2e-3)
        trajectory = parameterize(path, names, velocity, acceleration)
        message = robot_trajectory_message(
            self._session.bus.schema, self._session.bus.header(WORLD), trajectory
        )
        return self._session.messages.local(message)

    def get_jacobian_matrix(self, joint_values: Any, reference_point: Any = None) -> Any:
        """(6, n), linear over angular, in the frame of the group's base; of a point in the tip's frame."""
        values = [float(v) for v in joint_values]
        scene = measured_scene().with_state(JointState.from_mapping(self._by_name(values)))
        point = np.zeros(3) if reference_point is None else np.asarray(reference_point, dtype=float)
        tree = kinematic_tree(scene.model)
        link = self._link("", "get the Jacobian of")
        J = tree.jacobian(scene.positions, link, self._group.joint_names, point)
        R = scene.frame_pose(self._group.base_link or scene.model.root_link).rotation.matrix.T
        return np.vstack([R @ J[:3], R @ J[3:]])

    def enforce_bounds(self, robot_state_msg: Any) -> Any:
        """The state with every joint within its limits."""
        scene = measured_scene()
        state = robot_state_from_message(robot_state_msg, scene)
        bounded = self._session.messages.local(robot_state_msg)
        if state is None:
            return bounded
        inside = dict(
            zip(state.joint_names, scene.model.enforce_bounds(state.positions, state.joint_names).tolist())
        )
        names = bounded.joint_state.name
        bounded.joint_state.position = tuple(
            inside.get(n, p) for n, p in zip(names, bounded.joint_state.position)
        )
        return bounded


__all__ = ["MoveGroupCommander", "measured_scene"]
