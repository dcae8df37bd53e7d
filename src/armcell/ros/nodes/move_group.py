"""move_group: MoveIt's planning services and actions, answered by armcell's planners.

Error codes, states and feedback match MoveIt's move_group where clients rely on them. If move_group would
silently do something else than the request says, armcell rejects the request with a reason.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np

from armcell.collision import ExactChecker
from armcell.core import ErrorCode, InputError, Outcome, PlanResult, UnknownNameError
from armcell.planning import constraint_errors, plan, plan_cartesian, solve_ik
from armcell.ros.actions import ActionOutcome, ActionServer, Goal
from armcell.ros.bus import Bus
from armcell.ros.convert import pose_from_message, pose_message
from armcell.ros.moveit_convert import (
    attached_changes,
    cartesian_request_from_message,
    constraints_from_message,
    diff_from_message,
    error_code_message,
    plan_request_from_message,
    robot_state_from_message,
    robot_state_message,
    robot_trajectory_message,
)
from armcell.ros.moveit_convert.objects import frame_of
from armcell.ros.nodes.cell_motions import CellMotions
from armcell.ros.nodes.gripper_node import with_finger_contacts
from armcell.ros.nodes.outcomes import goal_state, request_code, unknown_name_code, wait_for_outcome
from armcell.ros.nodes.planner_parameters import PlannerParameters
from armcell.ros.nodes.scene_node import SceneNode
from armcell.scene import WORLD, PlanningScene, SceneDiff

logger = logging.getLogger(__name__)
NAME = "/move_group"
DISPLAY = ("/move_group/display_planned_path", "/display_planned_path")
ROBOT_LINK, WORLD_OBJECT, ROBOT_ATTACHED = 0, 1, 2  # moveit_msgs/ContactInformation
MAX_CONTACTS = 100


class MoveGroupNode:
    """Node with the services and actions of MoveIt's move_group for a cell.

    Services: /plan_kinematic_path, /compute_cartesian_path, /compute_ik, /compute_fk, /check_state_validity,
    /query_planner_interface, /get_planner_params, /set_planner_params, and the services of `SceneNode`.
    Actions: /move_group, /execute_trajectory. Input topic: /trajectory_execution_event ("stop"). Output
    topic: /move_group/display_planned_path. `PickPlaceNode` serves pick and place.

    Args:
        cell: the cell.
        bus: the message bus.
        planner_configs: content of an ompl_planning.yaml; requests may name its planner configurations, and a
            request without a planner uses the group's default.
    """

    def __init__(self, cell: CellMotions, bus: Bus, planner_configs: Mapping[str, Any] | None = None):
        self.cell, self.bus = cell, bus
        self._planner_configs = planner_configs or {}
        self.scene_node = SceneNode(cell, bus)
        self._parameters = PlannerParameters(bus.schema)
        self._stop = threading.Event()
        self._executing: list[threading.Event] = []
        serve = lambda name, handler: bus.serve(f"/{name}", SERVICES[name], handler)  # noqa: E731
        self._display = [bus.advertise(n, "moveit_msgs/DisplayTrajectory", latch=True) for n in DISPLAY]
        self._members: list[Any] = [
            serve("plan_kinematic_path", self._plan_service),
            serve("compute_cartesian_path", self._cartesian_service),
            serve("compute_ik", self._ik_service),
            serve("compute_fk", self._fk_service),
            serve("check_state_validity", self._validity_service),
            serve("query_planner_interface", self._parameters.query),
            serve("get_planner_params", self._parameters.get),
            serve("set_planner_params", self._parameters.set),
            ActionServer(bus, NAME, "moveit_msgs/MoveGroup", self._move),
            # Arms can move at the same time: the joints of two goals decide which goal waits.
            ActionServer(
                bus, "/execute_trajectory", "moveit_msgs/ExecuteTrajectory", self._execute, concurrent=True
            ),
            bus.subscribe("/trajectory_execution_event", "std_msgs/String", self._on_event),
            *self._display,
            self.scene_node,
        ]

    def close(self) -> None:
        self._stop.set()
        for member in self._members:
            member.close()

    def __enter__(self) -> MoveGroupNode:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def new(self, name: str, /, *values: Any, **fields: Any) -> Any:
        return self.bus.schema.new(f"moveit_msgs/{name}", *values, **fields)

    def header(self, frame: str = WORLD) -> Any:
        return self.bus.header(frame)

    def error_code_message(self, code: ErrorCode, message: str = "") -> Any:
        return error_code_message(self.bus.schema, code, message)

    def outcome_code(self, outcome: Outcome) -> Any:
        """Return the error code and reason with which the move_group node reports the end of a motion, as a
        MoveItErrorCodes message.
        """
        return self.error_code_message(
            outcome.code, outcome.message or ("" if outcome.ok else outcome.code.name)
        )

    def state_message(self, scene: PlanningScene) -> Any:
        return robot_state_message(self.bus.schema, self.header(), scene)

    # --- planning ---
    def plan(self, request: Any, scene: PlanningScene, cancel: threading.Event | None = None) -> PlanResult:
        """Plan the motion that a client of the move_group node requests with a MotionPlanRequest message.

        Args:
            request: the MotionPlanRequest message.
            scene: the planning scene.
            cancel: event that ends the planning early.
        Returns:
            The plan, or an error code with the cause; an invalid request does not raise an exception.
        """
        try:
            scene = with_finger_contacts(scene, request.group_name)
            wanted = plan_request_from_message(request, scene, self._parameters.of(request))
            if wanted.pipeline_id in ("", "ompl", "native"):
                wanted = replace(wanted, planner_configs=self._planner_configs)
            result = plan(scene, wanted, cancel)
        except InputError as error:
            logger.warning("planning request refused: %s", error)
            self.cell.queue_event("error", f"a client's request for {request.group_name} is refused: {error}")
            return PlanResult(request_code(request, error), str(error))
        repaired = result.evidence.get("start_repaired")
        if result.ok and repaired and repaired["begins_at"] != "actual start":
            contacts = "; ".join(c.describe() for c in repaired["contacts"][:3])
            text = f"start in collision: {contacts}; no way out was found"
            result = PlanResult(ErrorCode.START_STATE_IN_COLLISION, text, {"contacts": repaired["contacts"]})
        if not result.ok:
            logger.warning(
                "planning for %s failed: %s: %s", request.group_name, result.code.name, result.message
            )
        self._tell(request.group_name, result, {"seed": wanted.seed, "attempts": wanted.attempts})
        return result

    def _tell(self, group: str, result: PlanResult, asked: dict[str, Any]) -> None:
        """Report a planning result of the move_group node to the cell's observers, even if the plan is not
        executed.
        """
        if result.trajectory is None:
            text = f"planning for {group} failed: {result.code.name}: {result.message}"
            self.cell.queue_event("error", text, evidence={**asked, **result.evidence})
            return
        self.cell.queue_event(
            "plan", f"for a client, {group}", planner=result.planner_id, planning_time_s=result.planning_time,
            points=len(result.trajectory.times), duration_s=result.trajectory.duration,
            evidence={**asked, **result.evidence},
        )  # fmt: skip

    def wait_until_idle(self, group: str, cancel: threading.Event | None = None) -> None:
        """Wait until the planning group that a request to the move_group node names has ended all of its
        motions.

        A plan that starts from a moving state would be invalid when it is executed.
        """
        if group not in self.cell.model.groups:
            return
        model = self.cell.model
        joints = set(model.groups[group].joint_names)
        for gripper in model.grippers.values():
            if gripper.arm_group == group:
                joints.update(gripper.joint_names)
        while not self._stop.is_set() and not (cancel is not None and cancel.is_set()):
            works = self.cell.motions(joints)
            if not works:
                return
            works[0].wait(0.05)

    def start_scene(self, request: Any, cancel: threading.Event | None = None) -> PlanningScene:
        """Return the measured scene in which the move_group node starts a requested motion.

        If the request gives no start state, wait until the group has come to rest.
        """
        if not request.start_state.joint_state.name:
            self.wait_until_idle(request.group_name, cancel)
        return self.cell.scene()

    def plan_response(self, request: Any, scene: PlanningScene, result: PlanResult) -> Any:
        """Create a MotionPlanResponse of the move_group node and publish its motion on the topic
        display_planned_path.
        """
        # If the start state is invalid, the result already states the fault.
        state = self.state_message(_started(scene, request.start_state) if result.ok else scene)
        trajectory = robot_trajectory_message(self.bus.schema, self.header(), result.trajectory)
        if result.trajectory is not None:
            shown = self.new("DisplayTrajectory", scene.model.name, [trajectory], state)
            for publisher in self._display:
                publisher.publish(shown)
        return self.new(
            "MotionPlanResponse",
            state,
            request.group_name,
            trajectory,
            result.planning_time,
            self.outcome_code(result),
        )

    def _plan_service(self, request: Any) -> Any:
        asked = request.motion_plan_request
        scene = self.start_scene(asked)
        return self.new("GetMotionPlanResponse", self.plan_response(asked, scene, self.plan(asked, scene)))

    def _cartesian_service(self, request: Any) -> Any:
        scene = self.start_scene(request)
        try:
            scene.model.group(request.group_name)
            result = plan_cartesian(scene, cartesian_request_from_message(request, scene))
        except InputError as error:
            logger.warning("Cartesian request refused: %s", error)
            self.cell.queue_event("error", f"a client's line for {request.group_name} is refused: {error}")
            return self.new(
                "GetCartesianPathResponse",
                self.state_message(scene),
                fraction=-1.0,
                error_code=self.error_code_message(unknown_name_code(error, ErrorCode.FAILURE), str(error)),
            )
        if result.fraction < 1.0:
            logger.warning("the line is followed for %.0f %%: %s", result.fraction * 100, result.message)
        self._tell(request.group_name, result, {"fraction": result.fraction})
        # As in move_group, a partial path counts as success with a fraction below 1.
        return self.new(
            "GetCartesianPathResponse",
            self.state_message(_started(scene, request.start_state)),
            robot_trajectory_message(self.bus.schema, self.header(), result.trajectory),
            float(result.fraction),
            self.error_code_message(
                ErrorCode.SUCCESS if result.fraction > 0 or result.ok else result.code, result.message
            ),
        )

    # --- kinematics and validity ---
    def _ik_service(self, request: Any) -> Any:
        asked = request.ik_request
        scene = self.cell.scene()

        def answer(code: ErrorCode, why: str = "", solution: PlanningScene | None = None) -> Any:
            state = self.new("RobotState") if solution is None else self.state_message(solution)
            return self.new("GetPositionIKResponse", state, self.error_code_message(code, why))

        try:
            scene.model.group(asked.group_name)
            scene = _started(scene, asked.robot_state)
            link, stamped = asked.ik_link_name, asked.pose_stamped
            if asked.pose_stamped_vector:
                if len(asked.pose_stamped_vector) > 1:
                    raise InputError("poses of several links at once", hint="ask for each arm's group")
                link, stamped = (list(asked.ik_link_names) or [""])[0], asked.pose_stamped_vector[0]
            T = scene.frame_pose(frame_of(stamped.header)) @ pose_from_message(stamped.pose)
            result = solve_ik(scene, asked.group_name, T, link or None, bool(asked.avoid_collisions))
            if not result.ok or result.positions is None:
                logger.info("inverse kinematics: %s", result.message)
                return answer(result.code, result.message or result.code.name)
            names = scene.model.group(asked.group_name).joint_names
            q = scene.positions.copy()
            q[scene.model.columns(names)] = result.positions
            found = scene.with_positions(q)
            wanted = constraints_from_message(asked.constraints)
            if wanted and not all(
                e.ok for e in constraint_errors(found, asked.group_name, wanted, result.positions)
            ):
                return answer(ErrorCode.NO_IK_SOLUTION, "the solution violates the request's constraints")
        except InputError as error:
            logger.warning("inverse kinematics refused: %s", error)
            return answer(unknown_name_code(error, ErrorCode.FAILURE), str(error))
        return answer(ErrorCode.SUCCESS, solution=found)

    def _fk_service(self, request: Any) -> Any:
        scene = self.cell.scene()
        try:
            scene = _started(scene, request.robot_state)
            names = list(request.fk_link_names) or [""]
            if unknown := [n for n in names if n not in scene.frame_names]:
                raise UnknownNameError("link", unknown[0], scene.frame_names)
            frame = frame_of(request.header)
            into = scene.frame_pose(frame).inverse()
        except InputError as error:
            logger.warning("forward kinematics refused: %s", error)
            code = self.error_code_message(unknown_name_code(error, ErrorCode.FAILURE), str(error))
            return self.new("GetPositionFKResponse", error_code=code)
        poses = [
            self.bus.schema.new(
                "geometry_msgs/PoseStamped", self.header(frame),
                pose_message(self.bus.schema, into @ scene.frame_pose(n)),
            )
            for n in names
        ]  # fmt: skip
        return self.new("GetPositionFKResponse", poses, names, self.error_code_message(ErrorCode.SUCCESS))

    def _validity_service(self, request: Any) -> Any:
        def answer(valid: bool, **more: Any) -> Any:
            return self.new("GetStateValidityResponse", valid, **more)

        scene = self.cell.scene()
        try:
            scene = _started(scene, request.robot_state)
            names = scene.model.group(request.group_name).joint_names if request.group_name else None
            checker = ExactChecker(scene, names)
            q = scene.positions[checker.columns]
            contacts = [
                self._contact(scene, c) for c in checker.contacts(q) if not names or _moves(checker, c)
            ]  # fmt: skip
            wanted = constraints_from_message(request.constraints)
            errors = constraint_errors(scene, request.group_name, wanted, q) if wanted and names else ()
        except InputError as error:
            logger.warning("state refused: %s", error)
            return answer(False)
        results = [self.new("ConstraintEvalResult", e.ok, float(np.linalg.norm(e.error))) for e in errors]
        valid = not contacts and all(e.ok for e in errors)
        return answer(valid, contacts=contacts[:MAX_CONTACTS], constraint_result=results)

    def _contact(self, scene: PlanningScene, contact: Any) -> Any:
        def kind(body: str) -> int:
            return ROBOT_LINK if body in scene.model.links else (
                ROBOT_ATTACHED if body in scene.attached else WORLD_OBJECT
            )  # fmt: skip

        return self.new(
            "ContactInformation",
            header=self.header(),
            position=self.bus.schema.new("geometry_msgs/Point", *map(float, contact.position)),
            depth=max(-float(contact.distance), 0.0),
            contact_body_1=contact.body_a,
            body_type_1=kind(contact.body_a),
            contact_body_2=contact.body_b,
            body_type_2=kind(contact.body_b),
        )

    # --- the move_group action ---
    def _move(self, goal: Goal) -> ActionOutcome:
        """Plan a motion for a MoveGroup goal and execute it unless `plan_only` is set.

        With `replan`, plan and execute again if the execution fails.
        """
        request, options = goal.message.request, goal.message.planning_options
        attempts = 1 + (
            max(int(options.replan_attempts), 0) if options.replan and not options.plan_only else 0
        )
        result, outcome = self.new("MoveGroupResult"), Outcome(ErrorCode.FAILURE)
        for _ in range(attempts):
            self.feedback(goal, "MoveGroup", "PLANNING")
            try:
                measured = self.start_scene(request, goal.cancel)
                scene = measured.apply(diff_from_message(options.planning_scene_diff, measured))
            except InputError as error:
                outcome = Outcome(ErrorCode.FAILURE, str(error))
                break
            if goal.cancel.is_set():
                outcome = Outcome(ErrorCode.PREEMPTED, "cancelled")
                break
            found = self.plan(request, scene, goal.cancel)
            response = self.plan_response(request, scene, found)
            result.trajectory_start, result.planned_trajectory = (
                response.trajectory_start,
                response.trajectory,
            )
            result.planning_time, outcome = response.planning_time, found
            if not found.ok or options.plan_only:
                break
            self.feedback(goal, "MoveGroup", "MONITOR")
            allowed = {**measured.allowed_pairs, **scene.allowed_pairs}
            planned_in = replace(measured, allowed_pairs=allowed)
            outcome = self.execute_trajectory(response.trajectory, goal.cancel, planned_in)
            result.executed_trajectory = response.trajectory
            if outcome.ok or outcome.code is ErrorCode.PREEMPTED:
                break
        self.feedback(goal, "MoveGroup", "IDLE")
        result.error_code = self.outcome_code(outcome)
        return goal_state(outcome, result)

    def _execute(self, goal: Goal) -> ActionOutcome:
        self.feedback(goal, "ExecuteTrajectory", "MONITOR")
        names = tuple(goal.message.controller_names)
        outcome = self.execute_trajectory(goal.message.trajectory, goal.cancel, controllers=names)
        self.feedback(goal, "ExecuteTrajectory", "IDLE")
        return goal_state(outcome, self.new("ExecuteTrajectoryResult", self.outcome_code(outcome)))

    def execute_trajectory(
        self, trajectory: Any, cancel: threading.Event, planned_in: PlanningScene | None = None,
        controllers: Sequence[str] = (),
    ) -> Outcome:  # fmt: skip
        """Execute a moveit_msgs/RobotTrajectory for a client of the move_group node and return the outcome.

        The execution also stops if a change of the scene obstructs the rest of the path.

        Args:
            trajectory: the RobotTrajectory message.
            cancel: event that stops the motion.
            planned_in: the scene in which the motion was planned; default: the current scene.
            controllers: names of the controllers to use; empty means all controllers of the joints.
        """
        if trajectory.multi_dof_joint_trajectory.points:
            return Outcome(ErrorCode.FAILURE, "multi-DOF trajectories are not executed")
        if not trajectory.joint_trajectory.points:
            return Outcome(ErrorCode.SUCCESS, "empty trajectory")
        with self.cancel_on_stop_event(cancel):
            try:
                work = self.cell.queue_trajectory(
                    trajectory.joint_trajectory, planned_in=planned_in, controllers=controllers
                )
                return wait_for_outcome(work, cancel)
            except InputError as error:
                logger.warning("trajectory refused: %s", error)
                return Outcome(ErrorCode.CONTROL_FAILED, str(error))

    @contextmanager
    def cancel_on_stop_event(self, cancel: threading.Event) -> Iterator[None]:
        """Let a "stop" event cancel the goal of an action of the move_group node during a `with` block.

        The event also cancels the goal before its motion has started.
        """
        self._executing.append(cancel)
        try:
            yield
        finally:
            self._executing.remove(cancel)

    def feedback(self, goal: Goal, action: str, state: str) -> None:
        goal.feedback(self.new(f"{action}Feedback", state))

    def _on_event(self, message: Any) -> None:
        if message.data == "stop":
            for cancel in list(self._executing):
                cancel.set()
            self.cell.stop()


SERVICES = {
    "plan_kinematic_path": "moveit_msgs/GetMotionPlan",
    "compute_cartesian_path": "moveit_msgs/GetCartesianPath",
    "compute_ik": "moveit_msgs/GetPositionIK",
    "compute_fk": "moveit_msgs/GetPositionFK",
    "check_state_validity": "moveit_msgs/GetStateValidity",
    "query_planner_interface": "moveit_msgs/QueryPlannerInterfaces",
    "get_planner_params": "moveit_msgs/GetPlannerParams",
    "set_planner_params": "moveit_msgs/SetPlannerParams",
}


def _started(scene: PlanningScene, message: Any) -> PlanningScene:
    """Return the start scene of a request to the move_group node, which includes the request's RobotState."""
    state = robot_state_from_message(message, scene)
    if state is not None:
        scene = replace(scene, positions=scene.state.updated(state).positions)
    for attached in message.attached_collision_objects:
        if attached.object.id not in scene.attached:
            scene = scene.apply(SceneDiff(tuple(attached_changes(attached, scene))))
    return scene


def _moves(checker: ExactChecker, contact: Any) -> bool:
    """Return whether the joints in a request to the move_group node can move one of the bodies in contact."""
    moved = {checker.geometries[i].body for pair in checker.pairs for i in pair}
    return contact.body_a in moved or contact.body_b in moved
