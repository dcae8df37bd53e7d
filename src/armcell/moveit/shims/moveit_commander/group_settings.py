"""Planning settings of a group: tolerances, constraints, planner and speed."""

from __future__ import annotations

from typing import Any

from armcell.moveit.commander_calls import joint_constraints, pose_constraints
from armcell.moveit.shims.moveit_commander.exception import MoveItCommanderException
from armcell.moveit.shims.moveit_commander.group_info import JOINT, ORIENTATION, POSITION, kind_of
from armcell.moveit.shims.moveit_commander.group_targets import GroupTargets


class GroupSettings(GroupTargets):
    """Methods of a moveit_commander group for its planning settings: tolerances,
    planner, speed and constraints.
    """

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
        """Return the names of the stored constraints of a moveit_commander group. The list is empty, because
        armcell has no constraint database.
        """
        return []

    def get_path_constraints(self) -> Any:
        return self._session.messages.local(self._path_constraints or self._new("Constraints"))

    def set_path_constraints(self, value: Any = None, *, constraints: Any = None) -> None:
        """Set the path constraints of a moveit_commander group from a Constraints message; None clears them.

        Tutorials also pass the argument as `constraints`.
        """
        value = constraints if value is None else value
        if value is None:
            self.clear_path_constraints()
        elif kind_of(value) == "Constraints":
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
        elif kind_of(value) == "TrajectoryConstraints":
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
        """Set the planning time [s] of a moveit_commander group. As in MoveIt, a value that is not positive
        is ignored.
        """
        if seconds > 0:
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

    # --- the request ---
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
            every = dict(zip(self._variables(), self.get_joint_value_target()))
            values = {n: every[n] for n in self._group.joint_names}
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
