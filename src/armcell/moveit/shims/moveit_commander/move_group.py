"""Shim of moveit_commander.MoveGroupCommander."""

from __future__ import annotations

from typing import Any

import numpy as np

from armcell.core import ArmcellError, ErrorCode, JointState
from armcell.kinematics import kinematic_tree
from armcell.model import Gripper
from armcell.moveit.commander_calls import (
    SUCCESS,
    measured_scene,
    send,
    wait_for_result,
)
from armcell.moveit.script_hints import METHODS, closed_on_nothing, unreached_pose
from armcell.moveit.shims.moveit_commander.exception import MoveItCommanderException
from armcell.moveit.shims.moveit_commander.group_info import POSE, TIMING, kind_of
from armcell.moveit.shims.moveit_commander.group_settings import GroupSettings
from armcell.ros.moveit_convert import robot_state_from_message, robot_trajectory_message
from armcell.ros.moveit_convert.objects import REMOVE
from armcell.scene import WORLD
from armcell.timing import BlendedPath, parameterize

UNREACHED = {
    ErrorCode.FAILURE, ErrorCode.PLANNING_FAILED, ErrorCode.TIMED_OUT, ErrorCode.NO_IK_SOLUTION,
    ErrorCode.GOAL_IN_COLLISION, ErrorCode.GOAL_STATE_INVALID, ErrorCode.INVALID_GOAL_CONSTRAINTS,
}  # fmt: skip


class MoveGroupCommander(GroupSettings):
    """Commander of one planning group, with the defaults, exceptions and return values of
    moveit_commander.MoveGroupCommander.

    Raises:
        RuntimeError: the group does not exist.
    """

    # --- planning and moving ---
    def _take_target(self, joints: Any) -> None:
        """Set the target of the MoveGroupCommander from the argument of `go` or `plan`.

        The argument may be a JointState, a Pose, the name of a remembered state, or joint values.
        """
        if joints is None:
            return
        if kind_of(joints) == "JointState":
            self.set_joint_value_target(joints)
        elif kind_of(joints) == "Pose":
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
        result = wait_for_result(self._session, sent)
        self._keep_plan(result)
        code = result.error_code.val
        self._hint_at_target(code)
        for gripper in self._grippers():
            if code == SUCCESS and gripper.group == self._name:
                self._hint_at_grip(gripper)
        return bool(code == SUCCESS)

    def _hint_at_target(self, code: int) -> None:
        """Log a hint for users of MoveGroupCommander if a pose is unreachable
        because the tool direction or the tip link is wrong.
        """
        if code not in UNREACHED or self._active != POSE:
            return
        scene = measured_scene()
        for link, poses in self._poses.items():
            try:
                why = unreached_pose(scene, self._name, link or self._eef, self._in_world(scene, poses[0]))
            except ArmcellError:
                continue
            if why:
                self._session.hint(f"target {why.split(':')[0]}", why)

    def _hint_at_grip(self, gripper: Gripper) -> None:
        """Log a hint that explains to users of MoveGroupCommander why a
        gripper that has just closed holds no object.
        """
        scene, cell = measured_scene(), self._session.served.cell
        closed = gripper.width_in(scene.state) < 0.5 * gripper.max_width
        if closed and cell.held_object(gripper) is None and (why := closed_on_nothing(scene, gripper)):
            self._session.hint(f"nothing in {gripper.name}", why)

    def plan(self, joints: Any = None) -> tuple[bool, Any, float, Any]:
        """Plan a motion to the target without executing it, like MoveGroupCommander.plan.

        Returns:
            (success, RobotTrajectory, planning time [s], MoveItErrorCodes).
        """
        self._take_target(joints)
        result = wait_for_result(self._session, self._send("move_group", self._goal(plan_only=True)))
        self._keep_plan(result)
        code = result.error_code
        self._hint_at_target(code.val)
        return code.val == SUCCESS, result.planned_trajectory, result.planning_time, code

    def _keep_plan(self, result: Any) -> None:
        self._last_plan = self._new(
            "MotionPlanResponse", trajectory_start=result.trajectory_start, group_name=self._name,
            trajectory=result.planned_trajectory, planning_time=result.planning_time,
            error_code=result.error_code,
        )  # fmt: skip

    def get_last_planning_result(self) -> Any:
        """Return the MotionPlanResponse of the last `plan()` or `go()` of the MoveGroupCommander.

        Tutorials call this method, which MoveIt does not have.

        Raises:
            MoveItCommanderException: no plan() or go() came before.
        """
        name = "get_last_planning_result"
        self._session.hint(name, f"MoveIt has no {name}; {METHODS[name]}")
        if self._last_plan is None:
            raise MoveItCommanderException(f"{name}: no plan() or go() of {self._name} came before")
        if not self._last_plan.trajectory.joint_trajectory.points:
            code = ErrorCode(self._last_plan.error_code.val).name
            self._session.hint(f"{name} {code}", f"{name}: the last plan is empty ({code}), it has no points")
        return self._last_plan

    def compute_cartesian_path(
        self, waypoints: Any, eef_step: float, avoid_collisions: Any = None, path_constraints: Any = None,
        *more: Any, jump_threshold: float | None = None,
    ) -> tuple[Any, float]:  # fmt: skip
        """Plan a path for the end effector that is straight between waypoints, like
        MoveGroupCommander.compute_cartesian_path.

        Args:
            waypoints: poses of the end-effector link.
            eef_step: largest step [m] between two points of the path.
            avoid_collisions: whether to check for collisions (default True). A number is taken as
                `jump_threshold`, which was the third argument up to MoveIt 1.1.14.
            path_constraints: a Constraints message; None uses those of the group.
        Returns:
            (RobotTrajectory, fraction of the path that was planned).
        """
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
        if constraints is not None and kind_of(constraints) != "Constraints":
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
        if found.fraction < 1.0:
            self._partial.append((found.solution, found.fraction))
        return found.solution, found.fraction

    def execute(self, plan_msg: Any, wait: bool = True) -> bool:
        """Execute a RobotTrajectory, like MoveGroupCommander.execute, and return whether it succeeded.

        The complete result of plan() is accepted as well: if the plan succeeded, its trajectory is executed.
        """
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
        if kind_of(plan_msg) == "JointTrajectory":
            plan_msg = self._new("RobotTrajectory", joint_trajectory=plan_msg)
        if kind_of(plan_msg) != "RobotTrajectory":
            raise MoveItCommanderException(f"execute wants a RobotTrajectory, not {type(plan_msg).__name__}")
        if why := self._incomplete(plan_msg):
            self._session.hint(f"incomplete {why}", f"execute: {why}; nothing is executed")
            return False
        sent = self._send("execute_trajectory", self._new("ExecuteTrajectoryGoal", plan_msg))
        if not wait:
            return True
        return bool(wait_for_result(self._session, sent).error_code.val == SUCCESS)

    def _incomplete(self, plan: Any) -> str:
        """Return the reason why a plan of the MoveGroupCommander is incomplete, or an empty string if the
        plan is complete.
        """
        fraction = next((f for p, f in self._partial if p is plan), 1.0)
        if fraction <= 0:
            return "the straight line could not begin, its fraction is 0; the reason is in the line above"
        if fraction < 1:
            return (
                f"the straight line ends after {fraction:.0%} of its length; test the fraction, or call "
                "execute(plan.joint_trajectory) to move as far as it leads"
            )
        if not plan.joint_trajectory.points and not plan.multi_dof_joint_trajectory.points:
            return "the plan is empty: planning has failed, or there was nothing to plan"
        return ""

    # --- objects ---
    def attach_object(self, object_name: str, link_name: str = "", touch_links: Any = ()) -> bool:
        """Attach an object to a link, like MoveGroupCommander.attach_object.
        Return True if the request was sent.

        Without a link name, the link is the end effector's, or the first of the group.
        """
        link = link_name or self._eef or next(iter(self._group.link_names), "")
        if not link:
            return False
        touch = list(touch_links) or [link, *(n for g in self._grippers() for n in g.hand_links if n != link)]
        item = self._new("CollisionObject", id=object_name)
        attached = self._new("AttachedCollisionObject", link_name=link, object=item, touch_links=touch)
        self._apply([attached])
        return True

    def _grippers(self) -> list[Gripper]:
        """Return the grippers that the MoveGroupCommander's group carries.
        If the group is itself a gripper, return that gripper.
        """
        every = self._session.model.grippers.values()
        return [g for g in every if self._name in (g.arm_group, g.group)]

    def detach_object(self, name: str = "") -> bool:
        """Detach objects from the robot, like MoveGroupCommander.detach_object.
        The result True only means that the request was sent.

        Args:
            name: an object, or a link whose objects are detached; without a name, all objects of the group.
        """
        link = name if name in self._session.model.links else ""
        bodies = measured_scene().attached
        links = {self._eef, *self._group.link_names}
        for gripper in self._grippers():
            links |= {gripper.tcp_link, *gripper.hand_links}
        mine = [
            n
            for n, b in bodies.items()
            if n == name or (b.link == link if link else not name and b.link in links)
        ]
        self._apply([
            self._new("AttachedCollisionObject", object=self._new("CollisionObject", id=n, operation=REMOVE))
            for n in mine
        ])  # fmt: skip
        return True

    def _apply(self, attached: list[Any]) -> None:
        scene = self._new("PlanningScene", is_diff=True)
        scene.robot_state.is_diff = True
        scene.robot_state.attached_collision_objects = attached
        request = self._new("ApplyPlanningSceneRequest", scene)
        if not self._session.call(self._server("apply_planning_scene"), request).success:
            names = ", ".join(a.object.id for a in attached)
            self._session.say(
                "WARN", f"the planning scene did not take {names}; the reason is in the line above"
            )

    def pick(self, object_name: str, grasp: Any = (), plan_only: bool = False) -> int:
        """Pick an object, like MoveGroupCommander.pick.
        Return the numeric value of the MoveItErrorCodes in the result.

        Without grasps, armcell generates them. In given grasps it fills in a missing approach, lift or force.
        """
        grasps = [grasp] if kind_of(grasp) == "Grasp" else list(grasp)
        goal = self._new(
            "PickupGoal", target_name=object_name, group_name=self._name, possible_grasps=grasps,
            support_surface_name=self._support, allowed_planning_time=self._time, planner_id=self._planner,
        )  # fmt: skip
        return self._picked_or_placed("pickup", goal, plan_only)

    def place(self, object_name: str, location: Any = None, plan_only: bool = False) -> bool:
        """Place a held object, like MoveGroupCommander.place.
        Return True on success; `pick`, in contrast, returns an error code.

        Args:
            location: pose of the placed object (Pose, PoseStamped or PlaceLocation), or a list of them; None
                chooses a place on the surface that `set_support_surface_name` names.
        """
        goal = self._new(
            "PlaceGoal", group_name=self._name, attached_object_name=object_name,
            place_locations=self._locations(location), support_surface_name=self._support,
            allowed_planning_time=self._time, planner_id=self._planner,
        )  # fmt: skip
        return self._picked_or_placed("place", goal, plan_only) == SUCCESS

    def _locations(self, location: Any) -> list[Any]:
        if location is None:
            return []
        kinds = ("Pose", "PoseStamped", "PlaceLocation")
        items = [location] if kind_of(location) in kinds else list(location)
        found = []
        for item in items:
            if kind_of(item) not in kinds:
                raise MoveItCommanderException(
                    "Parameter location must be a Pose, PoseStamped, PlaceLocation, list of PoseStamped or "
                    "list of PlaceLocation object"
                )
            if kind_of(item) == "PlaceLocation":
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
        result = wait_for_result(self._session, self._send(action, goal))
        return int(result.error_code.val)

    def set_support_surface_name(self, value: str) -> None:
        self._support = value

    # --- trajectories and kinematics ---
    def retime_trajectory(
        self, ref_state_in: Any, traj_in: Any, velocity_scaling_factor: float = 1.0,
        acceleration_scaling_factor: float = 1.0, algorithm: str = TIMING[0],
    ) -> Any:  # fmt: skip
        """Compute new times for the points of a trajectory, like MoveGroupCommander.retime_trajectory. The
        motion is as fast as the scaled limits allow.

        All algorithm names of MoveIt are accepted and give the same result.
        """
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
        """Return the (6, n) Jacobian in the base frame, like MoveGroupCommander.
        The three linear rows come before the angular rows.

        Args:
            joint_values: positions of the group's joints [rad or m].
            reference_point: point (3,) in the tip link's frame [m]; None is the frame's origin.
        """
        values = [float(v) for v in joint_values]
        scene = measured_scene().with_state(JointState.from_mapping(self._by_name(values)))
        point = np.zeros(3) if reference_point is None else np.asarray(reference_point, dtype=float)
        tree = kinematic_tree(scene.model)
        link = self._link("", "get the Jacobian of")
        J = tree.jacobian(scene.positions, link, self._group.joint_names, point)
        R = scene.frame_pose(self._group.base_link or scene.model.root_link).rotation.matrix.T
        return np.vstack([R @ J[:3], R @ J[3:]])

    def enforce_bounds(self, robot_state_msg: Any) -> Any:
        """Return the robot state with every joint clamped to its limits, like
        MoveGroupCommander.enforce_bounds.
        """
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
