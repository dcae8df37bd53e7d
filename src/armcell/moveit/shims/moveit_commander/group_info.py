"""Joints, links and current state of a planning group."""

from __future__ import annotations

from typing import Any

import numpy as np

from armcell.core import JointState
from armcell.kinematics import kinematic_tree
from armcell.moveit.commander_calls import measured_scene
from armcell.moveit.session import current_session
from armcell.moveit.shims.moveit_commander.conversions import list_to_pose_stamped
from armcell.moveit.shims.moveit_commander.exception import MoveItCommanderException
from armcell.ros.moveit_convert import robot_state_message
from armcell.scene import WORLD

JOINT, POSE, POSITION, ORIENTATION = "joint", "pose", "position", "orientation"
TIMING = (
    "iterative_time_parameterization",
    "iterative_spline_parameterization",
    "time_optimal_trajectory_generation",
)
PICK, PLACE = "moveit_msgs/Pickup", "moveit_msgs/Place"


def kind_of(value: Any) -> str:
    """Return the type name, e.g. "PoseStamped", of a ROS message that is passed to a moveit_commander group,
    or an empty string if the value is not a message.
    """
    return getattr(value, "_type", "").split("/")[-1]


class GroupInfo:
    """Methods of a moveit_commander group that return its joints, its links and its current state.

    Raises:
        RuntimeError: the group does not exist.
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
        self._poses: dict[str, list[Any]] = {}  # link -> PoseStamped targets
        self._remembered: dict[str, list[float]] = {}
        self._partial: list[tuple[Any, float]] = []  # incomplete Cartesian paths with their fractions
        self._start: Any = None
        self._last_plan: Any = None  # MotionPlanResponse
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
        """Stop all motions, those of this moveit_commander group and of other groups. The reason is that
        MoveIt's stop event ends every motion.
        """
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
        """Return the names of the movable joints in a moveit_commander group, including mimic joints."""
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
        return self._every_value({})

    def _every_value(self, positions: dict[str, float]) -> list[float]:
        """Return the values of the movable joints in a moveit_commander group, including mimic joints.

        Args:
            positions: joint name -> position; joints that it does not contain keep their current positions.
        """
        scene = measured_scene()
        q = scene.positions.copy()
        q[scene.model.columns(positions)] = list(positions.values())
        values = kinematic_tree(scene.model).full_positions(q)
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
        return self._every_value(self._random_positions())

    def _random_positions(self) -> dict[str, float]:
        names = self._group.joint_names
        model = self._session.model
        low = np.maximum(model.limits(names, "lower"), -np.pi)
        high = np.minimum(model.limits(names, "upper"), np.pi)
        return dict(zip(names, self._session.rng.uniform(low, high).tolist()))

    def get_random_pose(self, end_effector_link: str = "") -> Any:
        link = self._link(end_effector_link, "get the pose of")
        scene = measured_scene().with_state(JointState.from_mapping(self._random_positions()))
        T = scene.frame_pose(link)
        return list_to_pose_stamped([*T.translation, *T.quat_xyzw], self.get_planning_frame())

    def set_start_state_to_current_state(self) -> None:
        self._start = None

    def set_start_state(self, msg: Any) -> None:
        """Set the start state for planning with a moveit_commander group, given as a RobotState message.

        Joints that the message does not name keep their current positions.
        """
        self._start = self._session.messages.local(msg)

    def get_current_state_bounded(self) -> Any:
        scene = measured_scene()
        return self._state(scene.with_positions(scene.model.enforce_bounds(scene.positions)))

    def get_current_state(self) -> Any:
        return self._state(measured_scene())

    def _state(self, scene: Any) -> Any:
        schema, header = self._session.bus.schema, self._session.bus.header(WORLD)
        return self._session.messages.local(robot_state_message(schema, header, scene))
