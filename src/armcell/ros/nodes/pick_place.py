"""The pickup and place actions: grasps and places from the caller, found and tried in physics by us."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from armcell.collision import neighbours
from armcell.control import CHANGED
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
from armcell.ros.actions import ActionServer, Done, Goal
from armcell.ros.convert import pose_from_message
from armcell.ros.moveit_convert import robot_trajectory_message
from armcell.ros.moveit_convert.objects import frame_of
from armcell.ros.moveit_convert.states import trajectory_message
from armcell.ros.nodes.move_group import MoveGroupNode, code_of, done, waited
from armcell.scene import PlanningScene
from armcell.tasks import TaskSettings
from armcell.tasks.search import Draft, Planning, Stage, search
from armcell.tasks.stages import (
    ChooseGivenGrasp,
    ChooseGivenPlace,
    Close,
    Connect,
    GivenGrasp,
    GivenPlace,
    Leave,
    Lift,
    Open,
    Planned,
    Way,
)
from armcell.tasks.steps import Expect, Grip, Hold, Motion, StillHeld

logger = logging.getLogger(__name__)


class PickPlaceNode:
    """Actions /pickup and /place.

    Where a message leaves something open, we fill it in, which MoveIt does not: no grasps (they are found),
    no approach or retreat (straight ways of the settings' lengths), no postures (opened as wide as the object
    needs, closed with the force that its mass needs), no support (what the object stands on). A grasp's pose
    is that of the group's tip.
    """

    def __init__(self, move_group: MoveGroupNode, settings: TaskSettings = TaskSettings()):
        self._node, self._cell, self._settings = move_group, move_group.cell, settings
        bus = move_group.bus
        self._members = [
            ActionServer(bus, "/pickup", "moveit_msgs/Pickup", self._pickup),
            ActionServer(bus, "/place", "moveit_msgs/Place", self._place),
        ]

    def close(self) -> None:
        for member in self._members:
            member.close()

    def _answer(self, goal: Goal, action: str, act: Callable[..., Outcome], what: str) -> Done:
        result = self._node.new(f"{action}Result")
        try:
            outcome = act(goal, goal.message, result)
        except InputError as error:
            outcome = Outcome(code_of(error, ErrorCode.FAILURE), str(error))
        result.error_code = self._node.code(outcome.code)
        self._node.feedback(goal, action, "IDLE")
        if not outcome.ok:
            logger.warning("%s failed: %s: %s", what, outcome.code.name, outcome.message)
        return done(outcome, result)

    # --- pickup ---
    def _pickup(self, goal: Goal) -> Done:
        return self._answer(goal, "Pickup", self._picked, f"pick {goal.message.target_name}")

    def _picked(self, goal: Goal, asked: Any, result: Any) -> Outcome:
        self._node.settled(asked.group_name, goal.cancel)
        scene = self._cell.scene()
        if asked.target_name not in scene.objects:
            known = [n for n, o in scene.objects.items() if o.movable]
            raise UnknownNameError("object", asked.target_name, known)
        gripper = self._gripper(asked.group_name, asked.end_effector)
        grasps = self._grasps(scene, asked, gripper)
        outcome = Outcome(ErrorCode.PLANNING_FAILED, "no grasp was given or found")
        began = time.monotonic()
        for _ in range(self._settings.attempts):
            scene = self._cell.scene()
            supports = tuple(neighbours(scene, asked.target_name))
            supports += tuple(
                n for n in (asked.support_surface_name,) if n in scene.objects and n not in supports
            )
            s, item = self._settings, asked.target_name
            stages: list[Stage] = [
                ChooseGivenGrasp(item, gripper, tuple(grasps), s.near),
                Connect("move to pre-grasp", gripper.arm_group, s.free, target="pre_grasp"),
                Planned("approach", "after_approach"),
                Close(item, gripper, supports, 0.0),
                Lift(item, gripper, supports, s.near),
            ]
            draft, outcome = self._searched(goal, "Pickup", stages, scene, asked.allowed_planning_time)
            if draft is None:
                return outcome
            self._report(result, scene, draft, time.monotonic() - began)
            grasp: GivenGrasp = draft.data["grasp"]
            if asked.possible_grasps:
                result.grasp = asked.possible_grasps[int(grasp.name)]
            if asked.planning_options.plan_only:
                return outcome
            outcome = self._perform(goal, "Pickup", draft)
            if outcome.ok and self._cell.held(gripper) != item:
                outcome = Outcome(ErrorCode.CONTROL_FAILED, f"lost {item} while lifting it")
            if outcome.ok or outcome.code is ErrorCode.PREEMPTED:
                return outcome
            if outcome.code is CHANGED:  # the grasp is as good as it was; what is held stays so
                if self._cell.held(gripper) == item:
                    return outcome
                logger.warning("pick %s: %s", item, outcome.message)
                continue
            logger.warning(
                "pick %s with grasp %s: %s; trying the next one", item, grasp.name, outcome.message
            )
            grasps = [g for g in grasps if g.name != grasp.name]
            waited(self._cell.drive(gripper, gripper.max_width, gripper.max_force), goal.cancel)
        return outcome

    def _gripper(self, group: str, end_effector: str) -> Gripper:
        """The gripper of an end effector, or of an arm's group.

        Raises:
            UnknownNameError: no such end effector or group. InputError: it carries no gripper.
        """
        model = self._cell.model
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

    def _grasps(self, scene: PlanningScene, asked: Any, gripper: Gripper) -> list[GivenGrasp]:
        """The given grasps, best first; found ones where none is given."""
        item = scene.objects[asked.target_name]
        lift = Way((0.0, 0.0, self._settings.lift_distance))
        if not asked.possible_grasps:
            found, _ = grasp_candidates(item, hand_of(scene.model, gripper))
            grasps = []
            for g in found:
                axis = (item.T_world_object @ g.T_object_tcp).rotation.matrix[:, 2]
                x, y, z = (axis * self._settings.approach_distance).tolist()
                known = (g.name, g.T_object_tcp, g.width, g.opening, g.force, g.score)
                grasps.append(GivenGrasp(*known, way_in=Way((x, y, z)), way_out=lift))
            return grasps
        order = sorted(enumerate(asked.possible_grasps), key=lambda kv: -float(kv[1].grasp_quality))
        return [self._grasp(scene, str(i), message, gripper, item.name) for i, message in order]

    def _grasp(
        self, scene: PlanningScene, name: str, message: Any, gripper: Gripper, item: str
    ) -> GivenGrasp:
        tip = scene.model.group(gripper.arm_group).tip_link or gripper.tcp_link
        stamped = message.grasp_pose
        T_world_tip = scene.frame_pose(frame_of(stamped.header)) @ pose_from_message(stamped.pose)
        T_world_tcp = T_world_tip @ scene.transform(tip, gripper.tcp_link)
        body = scene.objects[item]
        T_object_tcp = body.T_world_object.inv() @ T_world_tcp
        width = body.extent(T_object_tcp.rotation.matrix[:, 1])
        opening = _posture(message.pre_grasp_posture, gripper)
        if opening is None:
            opening = pre_opening(width, gripper)
        force = grip_force(body, gripper)
        if message.max_contact_force > 0:
            force = min(force, float(message.max_contact_force))
        ahead = T_world_tcp.rotation.matrix[:, 2] * self._settings.approach_distance
        up = np.array([0.0, 0.0, self._settings.lift_distance])
        return GivenGrasp(
            name, T_object_tcp, width, opening, force, float(message.grasp_quality),
            way_in=_way(scene, message.pre_grasp_approach, T_world_tip, tip) or Way(tuple(ahead.tolist())),
            way_out=_way(scene, message.post_grasp_retreat, T_world_tip, tip) or Way(tuple(up.tolist())),
        )  # fmt: skip

    # --- place ---
    def _place(self, goal: Goal) -> Done:
        return self._answer(goal, "Place", self._placed, f"place {goal.message.attached_object_name}")

    def _placed(self, goal: Goal, asked: Any, result: Any) -> Outcome:
        self._node.settled(asked.group_name, goal.cancel)
        scene, began = self._cell.scene(), time.monotonic()
        item, gripper = self._held(scene, asked)
        places = self._places(scene, asked, item, gripper)
        s = self._settings
        stages: list[Stage] = [
            ChooseGivenPlace(item, gripper, tuple(places), s.near),
            Connect("move to pre-place", gripper.arm_group, s.carry, target="pre_place"),
            Planned("lower", "after_lower"),
            Open(item, "", gripper, s.release_margin, 0.0),
            Leave(item, gripper, s.retreat_distance, s.near),
        ]
        draft, outcome = self._searched(goal, "Place", stages, scene, asked.allowed_planning_time)
        if draft is None:
            return outcome
        self._report(result, scene, draft, time.monotonic() - began)
        place: GivenPlace = draft.data["place"]
        if asked.place_locations:
            result.place_location = asked.place_locations[int(place.name)]
        if asked.planning_options.plan_only:
            return outcome
        return self._perform(goal, "Place", draft)

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

    def _places(self, scene: PlanningScene, asked: Any, item: str, gripper: Gripper) -> Sequence[GivenPlace]:
        down = Way((0.0, 0.0, -self._settings.lower_distance))
        if not asked.place_locations:
            if not asked.support_surface_name:
                raise InputError("no place is given", cure="give locations, or name the support surface")
            support = scene.object(asked.support_surface_name)
            found: Sequence[Placement] = place_candidates(scene.object(item), support, None)
            return [GivenPlace(p.name, p.T_world_object, self._down_to(p)) for p in found]
        order = sorted(enumerate(asked.place_locations), key=lambda kv: -float(kv[1].quality))
        return [
            self._location(scene, str(i), message, item, gripper, bool(asked.place_eef), down)
            for i, message in order
        ]

    def _down_to(self, place: Placement) -> Way:
        x, y, z = (-self._settings.lower_distance * n for n in place.normal)
        return Way((x, y, z))

    def _location(
        self,
        scene: PlanningScene,
        name: str,
        message: Any,
        item: str,
        gripper: Gripper,
        of_tip: bool,
        down: Way,
    ) -> GivenPlace:
        tip = scene.model.group(gripper.arm_group).tip_link or gripper.tcp_link
        stamped = message.place_pose
        T = scene.frame_pose(frame_of(stamped.header)) @ pose_from_message(stamped.pose)
        T_tip_object = scene.transform(tip, item)
        T_world_tip = T if of_tip else T @ T_tip_object.inv()
        T_world_object = T @ T_tip_object if of_tip else T
        return GivenPlace(
            name, T_world_object, _way(scene, message.pre_place_approach, T_world_tip, tip) or down,
            _way(scene, message.post_place_retreat, T_world_tip, tip),
        )  # fmt: skip

    # --- both ---
    def _searched(
        self, goal: Goal, action: str, stages: list[Stage], scene: PlanningScene, seconds: float
    ) -> tuple[Draft | None, Outcome]:
        """The first complete plan, or why there is none, candidate by candidate."""
        self._node.feedback(goal, action, "PLANNING")
        settings = self._settings
        if seconds > 0:
            settings = replace(settings, planning_budget=max(float(seconds), settings.planning_time))
        planning = Planning(settings, cancel=goal.cancel)
        draft = search(stages, Draft(scene), planning)
        if draft is not None:
            return draft, Outcome(ErrorCode.SUCCESS)
        if goal.cancel.is_set():
            return None, Outcome(ErrorCode.PREEMPTED, "cancelled")
        for _, candidate, reason in planning.rejections.details:
            logger.info("candidate %s: %s", candidate, reason)
        code = ErrorCode.PLANNING_FAILED
        if planning.failure is not None and planning.hopeless:
            code = planning.failure.code
        summary = planning.rejections.summary()
        self._cell.tell("error", f"{action}: {summary}", rejections=planning.rejections.details)
        return None, Outcome(code, summary)

    def _perform(self, goal: Goal, action: str, draft: Draft) -> Outcome:
        """Do what was planned, step by step."""
        self._node.feedback(goal, action, "MONITOR")
        with self._node.stoppable(goal.cancel):
            return self._steps(goal, draft)

    def _steps(self, goal: Goal, draft: Draft) -> Outcome:
        cell, bus = self._cell, self._node.bus
        for step in draft.steps:
            if goal.cancel.is_set():
                return Outcome(ErrorCode.PREEMPTED, "cancelled")
            try:
                match step:
                    case Motion():
                        message = trajectory_message(bus.schema, self._node.header(), step.trajectory)
                        points = len(step.trajectory.times)
                        cell.tell("plan", step.name, points=points, duration_s=step.duration, **step.told())
                        work = cell.play(message, planned_in=step.planned_in)
                        outcome = waited(work, goal.cancel)
                    case Grip():
                        outcome = waited(cell.drive(step.gripper, step.width, step.force), goal.cancel)
                    case Hold() | StillHeld():
                        outcome = self._holds(step.gripper, step.object)
                    case Expect():
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
        held = self._cell.held(gripper)
        if held == item:
            return Outcome(ErrorCode.SUCCESS)
        text = f"{held} is between the fingers" if held else "nothing is between the fingers"
        return Outcome(ErrorCode.CONTROL_FAILED, text)

    def _report(self, result: Any, scene: PlanningScene, draft: Draft, seconds: float) -> None:
        motions = [step for step in draft.steps if isinstance(step, Motion)]
        header = self._node.header()
        result.trajectory_start = self._node.state_message(scene)
        result.trajectory_stages = [
            robot_trajectory_message(self._node.bus.schema, header, m.trajectory) for m in motions
        ]
        result.trajectory_descriptions = [m.name for m in motions]
        result.planning_time = seconds


def _posture(message: Any, gripper: Gripper) -> float | None:
    """The width [m] that a posture's last point asks of the gripper; None where it says nothing of it."""
    if not message.points or gripper.joint_name not in list(message.joint_names):
        return None
    value = float(message.points[-1].positions[list(message.joint_names).index(gripper.joint_name)])
    return float(np.clip(gripper.width(value), 0.0, gripper.max_width))


def _way(scene: PlanningScene, message: Any, T_world_tip: SE3, tip: str) -> Way | None:
    """A GripperTranslation as a way in the world; None where it has no direction or length.

    A direction in the frame of the tip is meant as the tip is at the grasp, not as it is now.
    """
    v = message.direction.vector
    direction = np.array([v.x, v.y, v.z], dtype=float)
    length = float(np.linalg.norm(direction))
    if not np.isfinite(length) or length < 1e-9 or not message.desired_distance > 0:
        return None
    frame = frame_of(message.direction.header)
    R = T_world_tip.rotation.matrix if frame == tip else scene.frame_pose(frame).rotation.matrix
    x, y, z = (R @ direction / length * float(message.desired_distance)).tolist()
    return Way((x, y, z), float(message.min_distance))
