"""The pickup and place actions; armcell computes grasps and places that the caller omits."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from armcell.collision import neighbors
from armcell.core import SE3, ErrorCode, InputError, Outcome, UnknownNameError
from armcell.grasping import (
    Placement,
    grasp_candidates,
    grip_force,
    hand_of,
    place_candidates,
    pre_opening,
)
from armcell.model import Gripper
from armcell.ros.actions import ActionOutcome, ActionServer, Goal
from armcell.ros.convert import pose_from_message, trajectory_message
from armcell.ros.moveit_convert import robot_trajectory_message
from armcell.ros.moveit_convert.objects import frame_of
from armcell.ros.nodes.gripper_node import NEAR
from armcell.ros.nodes.move_group import MoveGroupNode
from armcell.ros.nodes.outcomes import goal_state, unknown_name_code, wait_for_outcome
from armcell.scene import CollisionObject, PlanningScene
from armcell.tasks import Pick, TaskSettings, grasp_stages
from armcell.tasks.pick import is_near, retreats
from armcell.tasks.search import PartialSolution, SearchState, Stage, search
from armcell.tasks.stages import (
    AppendPlannedMotion,
    Close,
    Connect,
    ExplicitGrasp,
    ExplicitPlacement,
    GripperTranslation,
    Lift,
    OpenHand,
    Retreat,
    UseGrasps,
    UsePlacements,
)
from armcell.tasks.steps import EMPTY, CheckStillHeld, CommandGripper, ConfirmGrasp, ExpectContact, Motion

logger = logging.getLogger(__name__)


class PickPlaceNode:
    """Node with the actions /pickup and /place of MoveIt.

    Unlike MoveIt, armcell fills in fields that the message leaves empty:

    - grasps: armcell computes them
    - approach and retreat: straight motions with the lengths in the task settings
    - postures: the gripper opens as wide as the object requires and closes with the force that its mass
      requires
    - support surface: the objects on which the target rests

    A grasp pose is the pose of the group's tip link.
    """

    def __init__(self, move_group: MoveGroupNode, settings: TaskSettings = TaskSettings()):
        self._node, self.cell, self.settings = move_group, move_group.cell, settings
        bus = move_group.bus
        self._members = [
            ActionServer(bus, "/pickup", "moveit_msgs/Pickup", self._pickup),
            ActionServer(bus, "/place", "moveit_msgs/Place", self._place),
        ]

    def close(self) -> None:
        for member in self._members:
            member.close()

    def _answer(self, goal: Goal, action: str, act: Callable[..., Outcome], what: str) -> ActionOutcome:
        result = self._node.new(f"{action}Result")
        try:
            outcome = act(goal, goal.message, result)
        except InputError as error:
            outcome = Outcome(unknown_name_code(error, ErrorCode.FAILURE), str(error))
        result.error_code = self._node.outcome_code(outcome)
        self._node.feedback(goal, action, "IDLE")
        if not outcome.ok:
            logger.warning("%s failed: %s: %s", what, outcome.code.name, outcome.message)
        return goal_state(outcome, result)

    # --- pickup ---
    def _pickup(self, goal: Goal) -> ActionOutcome:
        return self._answer(goal, "Pickup", self._picked, f"pick {goal.message.target_name}")

    def _picked(self, goal: Goal, asked: Any, result: Any) -> Outcome:
        self._node.wait_until_idle(asked.group_name, goal.cancel)
        scene = self.cell.scene()
        if asked.target_name not in scene.objects:
            known = [n for n, o in scene.objects.items() if o.movable]
            raise UnknownNameError("object", asked.target_name, known)
        gripper = self._gripper(asked.group_name, asked.end_effector)
        return _BusPick(self, goal, gripper, self._grasps(scene, asked, gripper), result).run()

    def _gripper(self, group: str, end_effector: str) -> Gripper:
        """Return the gripper for a pickup or place goal,
        which names either an end effector or the group of an arm.

        Raises:
            UnknownNameError: the end effector or group does not exist.
            InputError: the arm carries no gripper.
        """
        model = self.cell.model
        if group:
            model.group(group)
        if end_effector and end_effector in model.end_effectors:
            of = model.end_effectors[end_effector].group
            found = [g for g in model.grippers.values() if g.group == of]
            if found:
                return found[0]
        if end_effector and end_effector in model.grippers:
            return model.grippers[end_effector]
        return model.gripper(arm_group=group or None)

    def _grasps(self, scene: PlanningScene, asked: Any, gripper: Gripper) -> list[ExplicitGrasp]:
        """Return the grasps in a pickup goal, best first. If the goal contains no grasps, they are computed.

        Raises:
            InputError: the grasp poses refer to another link than the group's tip.
        """
        item = scene.objects[asked.target_name]
        lift = GripperTranslation((0.0, 0.0, self.settings.lift_distance))
        if not asked.possible_grasps:
            hand, error = hand_of(scene.model, gripper), self.settings.pose_error
            found, _ = grasp_candidates(item, hand, pose_error=error)
            grasps = []
            for g in found:
                axis = (item.T_world_object @ g.T_object_tcp).rotation.matrix[:, 2]
                x, y, z = (axis * self.settings.approach_distance).tolist()
                known = (g.name, g.T_object_tcp, g.width, g.opening, g.force, g.score)
                grasps.append(
                    ExplicitGrasp(
                        *known, pre_grasp_approach=GripperTranslation((x, y, z)), post_grasp_retreat=lift
                    )
                )
            return grasps
        _check_link(scene, asked.possible_grasps, gripper, item)
        order = sorted(enumerate(asked.possible_grasps), key=lambda kv: -float(kv[1].grasp_quality))
        return [self._grasp(scene, str(i), message, gripper, item.name) for i, message in order]

    def _grasp(
        self, scene: PlanningScene, name: str, message: Any, gripper: Gripper, item: str
    ) -> ExplicitGrasp:
        tip, T_world_tip = _tip(scene, gripper), _pose(scene, message.grasp_pose)
        T_world_tcp = T_world_tip @ scene.transform(tip, gripper.tcp_link)
        body = scene.objects[item]
        T_object_tcp = body.T_world_object.inverse() @ T_world_tcp
        width = body.extent(T_object_tcp.rotation.matrix[:, 1])
        opening = _posture(message.pre_grasp_posture, gripper)
        if opening is None:
            opening = pre_opening(width, gripper)
        force = grip_force(body, gripper)
        if message.max_contact_force > 0:
            force = min(force, float(message.max_contact_force))
        ahead = T_world_tcp.rotation.matrix[:, 2] * self.settings.approach_distance
        along = GripperTranslation(tuple(ahead.tolist()))
        up = GripperTranslation((0.0, 0.0, self.settings.lift_distance))
        translation = partial(_gripper_translation, scene, T_world_tip=T_world_tip, tip=tip)
        return ExplicitGrasp(
            name, T_object_tcp, width, opening, force, float(message.grasp_quality),
            pre_grasp_approach=translation(message.pre_grasp_approach) or along,
            post_grasp_retreat=translation(message.post_grasp_retreat) or up,
        )  # fmt: skip

    # --- place ---
    def _place(self, goal: Goal) -> ActionOutcome:
        return self._answer(goal, "Place", self._placed, f"place {goal.message.attached_object_name}")

    def _placed(self, goal: Goal, asked: Any, result: Any) -> Outcome:
        self._node.wait_until_idle(asked.group_name, goal.cancel)
        scene, began = self.cell.scene(), time.monotonic()
        item, gripper = self._held(scene, asked)
        places = self._places(scene, asked, item, gripper)
        s = self.settings
        stages: list[Stage] = [
            UsePlacements(item, gripper, tuple(places), s.near),
            Connect("move to pre-place", gripper.arm_group, s.carry, target="pre_place"),
            AppendPlannedMotion("lower", "after_lower"),
            OpenHand(item, "", gripper, s.release_margin, 0.0),
            Retreat(item, gripper, s.retreat_distance, s.near),
        ]
        solution, outcome = self.search(goal, "Place", stages, scene, asked.allowed_planning_time)
        if solution is None:
            return outcome
        self.report(result, scene, solution, time.monotonic() - began)
        place: ExplicitPlacement = solution.data["place"]
        if asked.place_locations:
            result.place_location = asked.place_locations[int(place.name)]
        if asked.planning_options.plan_only:
            return outcome
        return self.perform(goal, "Place", solution)

    def _held(self, scene: PlanningScene, asked: Any) -> tuple[str, Gripper]:
        grippers = [
            g for g in scene.model.grippers.values() if asked.group_name in ("", g.arm_group, g.group)
        ] or [self._gripper(asked.group_name, "")]
        for gripper in grippers:
            mine = [
                n
                for n, body in scene.attached.items()
                if body.link in (gripper.tcp_link, *gripper.hand_links)
            ]
            name = asked.attached_object_name or (mine[0] if mine else "")
            if name in mine:
                return name, gripper
        raise UnknownNameError("attached object", asked.attached_object_name, scene.attached)

    def _places(
        self, scene: PlanningScene, asked: Any, item: str, gripper: Gripper
    ) -> Sequence[ExplicitPlacement]:
        down = GripperTranslation((0.0, 0.0, -self.settings.lower_distance))
        if not asked.place_locations:
            if not asked.support_surface_name:
                raise InputError("no place is given", hint="give locations, or name the support surface")
            support = scene.object(asked.support_surface_name)
            found: Sequence[Placement] = place_candidates(scene.object(item), support, None)
            return [ExplicitPlacement(p.name, p.T_world_object, self._down_to(p)) for p in found]
        order = sorted(enumerate(asked.place_locations), key=lambda kv: -float(kv[1].quality))
        return [
            self._location(scene, str(i), message, item, gripper, bool(asked.place_eef), down)
            for i, message in order
        ]

    def _down_to(self, place: Placement) -> GripperTranslation:
        x, y, z = (-self.settings.lower_distance * n for n in place.normal)
        return GripperTranslation((x, y, z))

    def _location(
        self,
        scene: PlanningScene,
        name: str,
        message: Any,
        item: str,
        gripper: Gripper,
        of_tip: bool,
        down: GripperTranslation,
    ) -> ExplicitPlacement:
        tip, T = _tip(scene, gripper), _pose(scene, message.place_pose)
        T_tip_object = scene.transform(tip, item)
        T_world_tip = T if of_tip else T @ T_tip_object.inverse()
        T_world_object = T @ T_tip_object if of_tip else T
        translation = partial(_gripper_translation, scene, T_world_tip=T_world_tip, tip=tip)
        return ExplicitPlacement(
            name, T_world_object, translation(message.pre_place_approach) or down,
            translation(message.post_place_retreat),
        )  # fmt: skip

    # --- pickup and place ---
    def search(
        self, goal: Goal, action: str, stages: list[Stage], scene: PlanningScene, seconds: float
    ) -> tuple[PartialSolution | None, Outcome]:
        """Search for a plan that completes all stages of a pickup or place goal, and return the first one
        found.

        Returns:
            The plan with SUCCESS, or None with an outcome that summarizes why the candidates failed.
        """
        self._node.feedback(goal, action, "PLANNING")
        settings = self.settings
        if seconds > 0:
            settings = replace(settings, planning_budget=max(float(seconds), settings.planning_time))
        planning = SearchState(settings, cancel=goal.cancel)
        solution = search(stages, PartialSolution(scene), planning)
        if solution is not None:
            return solution, Outcome(ErrorCode.SUCCESS)
        if goal.cancel.is_set():
            return None, Outcome(ErrorCode.PREEMPTED, "cancelled")
        for _, candidate, reason in planning.rejections.details:
            logger.info("candidate %s: %s", candidate, reason)
        code = ErrorCode.PLANNING_FAILED
        if planning.failure is not None and planning.should_stop:
            code = planning.failure.code
        summary = planning.rejections.summary()
        self.cell.queue_event("error", f"{action}: {summary}", rejections=planning.rejections.details)
        return None, Outcome(code, summary)

    def perform(self, goal: Goal, action: str, solution: PartialSolution) -> Outcome:
        """Execute the steps of the plan for a pickup or place goal one after another."""
        self._node.feedback(goal, action, "MONITOR")
        with self._node.cancel_on_stop_event(goal.cancel):
            return self._steps(goal, solution)

    def _steps(self, goal: Goal, solution: PartialSolution) -> Outcome:
        cell, bus = self.cell, self._node.bus
        for step in solution.steps:
            if goal.cancel.is_set():
                return Outcome(ErrorCode.PREEMPTED, "cancelled")
            try:
                match step:
                    case Motion():
                        message = trajectory_message(bus.schema, self._node.header(), step.trajectory)
                        points = len(step.trajectory.times)
                        cell.queue_event(
                            "plan", step.name, points=points, duration_s=step.duration, **step.plan_metadata()
                        )
                        work = cell.queue_trajectory(message, planned_in=step.planned_in)
                        outcome = wait_for_outcome(work, goal.cancel)
                    case CommandGripper():
                        outcome = wait_for_outcome(
                            cell.drive(step.gripper, step.width, step.force), goal.cancel
                        )
                    case ConfirmGrasp() | CheckStillHeld():
                        outcome = self._holds(step.gripper, step.object)
                    case ExpectContact():
                        cell.expect_contact(step.body, step.others, step.expected)
                        continue
                    case _:
                        continue
            except InputError as error:
                outcome = Outcome(ErrorCode.CONTROL_FAILED, str(error))
            if not outcome.ok:
                name = getattr(step, "name", type(step).__name__)
                return replace(outcome, message=f"{name}: {outcome.message}")
        return Outcome(ErrorCode.SUCCESS)

    def _holds(self, gripper: Gripper, item: str) -> Outcome:
        held = self.cell.held_object(gripper)
        if held == item:
            return Outcome(ErrorCode.SUCCESS)
        text = f"{held} is between the fingers" if held else "nothing is between the fingers"
        return Outcome(ErrorCode.CONTROL_FAILED, text, {EMPTY: True})

    def report(self, result: Any, scene: PlanningScene, solution: PartialSolution, seconds: float) -> None:
        motions = [step for step in solution.steps if isinstance(step, Motion)]
        header = self._node.header()
        result.trajectory_start = self._node.state_message(scene)
        result.trajectory_stages = [
            robot_trajectory_message(self._node.bus.schema, header, m.trajectory) for m in motions
        ]
        result.trajectory_descriptions = [m.name for m in motions]
        result.planning_time = seconds


class _BusPick(Pick):
    """Pick task for a /pickup goal. It plans in the cell's scene and executes motions over the message bus.

    Args:
        node: searches, performs steps and reports.
        grasps: candidates, best first.
        result: the PickupResult; receives the planned motions and the grasp.
    """

    def __init__(
        self, node: PickPlaceNode, goal: Goal, gripper: Gripper, grasps: Sequence[ExplicitGrasp], result: Any
    ):
        super().__init__(f"pick {goal.message.target_name}", logger.warning, node.settings.attempts)
        self._node, self._cell, self._goal, self._gripper = node, node.cell, goal, gripper
        self._item, self._grasps, self._result = str(goal.message.target_name), grasps, result
        self._began = time.monotonic()

    def plan(self) -> tuple[PartialSolution | None, Outcome]:
        asked, scene, item, gripper = self._goal.message, self._cell.scene(), self._item, self._gripper
        s, surface = self._node.settings, asked.support_surface_name
        supports = tuple(neighbors(scene, item))
        supports += (surface,) if surface in scene.objects and surface not in supports else ()
        grasps = tuple(g for g in self._grasps if g.name not in self.excluded)
        stages = grasp_stages(
            UseGrasps(item, gripper, grasps, s.near), gripper, s,
            Close(item, gripper, supports, 0.0), Lift(item, gripper, supports, s.near),
        )  # fmt: skip
        solution, outcome = self._node.search(
            self._goal, "Pickup", stages, scene, asked.allowed_planning_time
        )
        if solution is not None:
            self._node.report(self._result, scene, solution, time.monotonic() - self._began)
            if asked.possible_grasps:
                self._result.grasp = asked.possible_grasps[int(solution.data["grasp"].name)]
        return solution, outcome

    def perform(self, solution: PartialSolution) -> Outcome:
        if self._goal.message.planning_options.plan_only:
            return Outcome(ErrorCode.SUCCESS)
        outcome = self._node.perform(self._goal, "Pickup", solution)
        if outcome.ok and not self.keeps_object():
            text = f"lost {self._item} while lifting it"
            return Outcome(ErrorCode.CONTROL_FAILED, text, {EMPTY: True})
        return outcome

    def keeps_object(self) -> bool:
        return self._cell.held_object(self._gripper) == self._item

    def open_hand(self) -> bool:
        held, gripper = self.keeps_object(), self._gripper
        wait_for_outcome(self._cell.drive(gripper, gripper.max_width, gripper.max_force), self._goal.cancel)
        return held

    def is_around_object(self) -> bool:
        scene = self._cell.scene()
        return self._item in scene.objects and is_near(scene, self._item, self._gripper, self._node.settings)

    def back_off(self) -> None:
        planning = SearchState(self._node.settings, cancel=self._goal.cancel)
        for solution in retreats(self._cell.scene(), self._item, self._gripper, planning):
            self._node.perform(self._goal, "Pickup", solution)


def _tip(scene: PlanningScene, gripper: Gripper) -> str:
    """Return the link that the poses in pickup and place goals describe:
    the tip of the group or, without a tip, the tcp.
    """
    return scene.model.group(gripper.arm_group).tip_link or gripper.tcp_link


def _pose(scene: PlanningScene, stamped: Any) -> SE3:
    return scene.frame_pose(frame_of(stamped.header)) @ pose_from_message(stamped.pose)


def _check_link(scene: PlanningScene, grasps: Sequence[Any], gripper: Gripper, item: CollisionObject) -> None:
    """Reject the grasp poses in a pickup goal if they evidently
    describe a link other than the tip of the group.

    MoveIt's grasp poses refer to the parent link of the end effector, which in many packages is also the tip
    of the group. Poses are rejected if no grasp puts the tcp into the object as a pose of the tip, but at
    least one does so as a pose of another link.

    Raises:
        InputError: the grasp poses refer to another link; the error names it, its distance from the tip, and
            the remedy.
    """
    tip = _tip(scene, gripper)
    Ts = [item.T_world_object.inverse() @ _pose(scene, grasp.grasp_pose) for grasp in grasps]
    low, high = item.bounds()

    def fit(link: str) -> int:
        """Count the grasps in a pickup goal that put the tcp inside the object,
        assuming that the goal contains poses of `link`.
        """
        points = [(T @ scene.transform(link, gripper.tcp_link)).translation for T in Ts]
        return sum(bool(np.all(p >= low - NEAR) and np.all(p <= high + NEAR)) for p in points)

    if fit(tip):
        return
    mounts = [
        e.parent_link for e in scene.model.end_effectors.values() if e.parent_group == gripper.arm_group
    ]
    chain = [joint.child for joint in scene.model.chain(scene.model.root_link, tip)]
    others = dict.fromkeys([*mounts, *gripper.hand_links, gripper.tcp_link, *reversed(chain)])
    best = max((link for link in others if link != tip), key=fit, default=tip)
    if not fit(best):
        return
    away = float(np.linalg.norm(scene.transform(best, tip).translation)) * 1000
    raise InputError(
        f"the grasps of {item.name} are poses of {best}, but the tip of group {gripper.arm_group!r} is "
        f"{tip}, {away:.0f} mm away: as poses of {tip} they leave the fingers beside {item.name}",
        hint=f"give grasp_pose for {tip}: multiply it on the right by the transform from {best} to {tip}",
    )


def _posture(message: Any, gripper: Gripper) -> float | None:
    """Return the gripper width [m] at the last point of a posture in a pickup goal, or None if the posture
    does not move the gripper.
    """
    if not message.points or gripper.joint_name not in list(message.joint_names):
        return None
    value = float(message.points[-1].positions[list(message.joint_names).index(gripper.joint_name)])
    return float(np.clip(gripper.width(value), 0.0, gripper.max_width))


def _gripper_translation(
    scene: PlanningScene, message: Any, T_world_tip: SE3, tip: str
) -> GripperTranslation | None:
    """Convert a moveit_msgs/GripperTranslation in a pickup or place goal to a translation in the world frame.

    A direction in the frame of the tip refers to the tip's pose at the grasp, not to its current pose.

    Returns:
        The translation, or None if the message has no direction or no length.
    """
    v = message.direction.vector
    direction = np.array([v.x, v.y, v.z], dtype=float)
    length = float(np.linalg.norm(direction))
    if not np.isfinite(length) or length < 1e-9 or not message.desired_distance > 0:
        return None
    frame = frame_of(message.direction.header)
    R = T_world_tip.rotation.matrix if frame == tip else scene.frame_pose(frame).rotation.matrix
    x, y, z = (R @ direction / length * float(message.desired_distance)).tolist()
    return GripperTranslation((x, y, z), float(message.min_distance))
