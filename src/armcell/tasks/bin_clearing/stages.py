"""Stages and steps of bin clearing: grasp a piece of the heap, release it over the tray.

The held object is unknown, so the steps use only the gripper's readings.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from armcell.core import SE3, SO3, Box, ErrorCode, Outcome, PlanResult, Shape
from armcell.drivers import GripperReading
from armcell.grasping import Grasp, HeapGrasp
from armcell.model import Gripper
from armcell.scene import CollisionObject, PlanningScene
from armcell.tasks.context import StageReport, TaskContext
from armcell.tasks.search import PartialSolution, SearchState, stage_types
from armcell.tasks.settings import Speed
from armcell.tasks.stages.fingers import finger_collision
from armcell.tasks.stages.grasp import APPROACH, approaches, finger_state
from armcell.tasks.stages.moves import plan_straight, shifted, with_contacts
from armcell.tasks.stages.place import DESCENT, descents
from armcell.tasks.steps import DONE, CommandGripper, not_held, staged
from armcell.tasks.task import holding_condition

HEAP = "heap"
"""Name of the camera's points in the bin, in the planning scene."""
FREE = 0.008  # [m] opening beyond the held width at which an object has left the fingers
LOOSE = 0.002  # [m] opening beyond the held width at which no finger presses on an object any more
WEDGED = 0.3  # [s] without a motion after which the fingers are stuck inside an object
MOVES = 3e-4  # [m] by which fingers that move open within `STOPPED`
STOPPED = 0.1  # [s]
WIDEST = 0.09  # [m] largest assumed half length of a held object


@stage_types.register("choose_from_heap")
@dataclass(frozen=True, eq=False)
class ChooseFromHeap:
    """Stage of bin clearing that proposes reachable grasps of objects in a heap,
    each with a straight descent.

    The order of the given grasps is kept.
    """

    grasps: Sequence[Grasp]
    gripper: Gripper
    speed: Speed
    distance: float  # [m] of the approach
    name: str = "grasp"
    provides = APPROACH

    def propose(self, solution: PartialSolution, planning: SearchState) -> Iterator[PartialSolution]:
        for grasp in self.grasps:
            yield from approaches(solution, planning, self.name, HEAP, self.gripper, grasp, self._back)

    def _back(self, at_grasp: PlanningScene, T_world_tcp: SE3) -> PlanResult:
        up = shifted(T_world_tcp, (0.0, 0.0, -self.distance), in_own_frame=True)
        return plan_straight(at_grasp, self.gripper.arm_group, self.gripper.tcp_link, up, self.speed)


@stage_types.register("close_on_heap")
@dataclass(frozen=True, eq=False)
class CloseOnHeap:
    """Stage of bin clearing that closes the hand on an object in the heap and attaches this object to the
    hand.
    """

    gripper: Gripper
    floor: float  # [m, world z] of the bin, lower bound of the object
    settle: float
    thinnest: float
    name: str = "close"
    requires = ("grasp",)

    @property
    def provides(self) -> tuple[str, ...]:
        return (holding_condition(held_object(self.gripper)),)

    def propose(self, solution: PartialSolution, planning: SearchState) -> Iterator[PartialSolution]:
        grasp: HeapGrasp = solution.data["grasp"]
        closing = CommandGripper(self.name, self.gripper, 0.0, grasp.force)
        # an object that leans over a wall hides this wall from the camera
        open_hand = with_contacts(solution.scene, ((HEAP, self.gripper.hand_links),))
        if reason := finger_collision(open_hand, [closing]):
            planning.reject(self.name, solution.data.get("candidate", ""), reason)
            return
        held = held_object(self.gripper)
        bottom = self.floor + 0.002
        T_tcp_box = _upright_between_fingers(grasp.T_object_tcp, (grasp.top + bottom) / 2)
        half = min(grasp.reach, WIDEST)
        box = Box(2 * half, max(grasp.width, 0.004), max(grasp.top - bottom, 0.004))
        scene = solution.scene.with_state(finger_state(self.gripper, grasp.width))
        item = CollisionObject.single(
            held, box, scene.frame_pose(self.gripper.tcp_link) @ T_tcp_box, movable=True
        )
        scene = scene.with_object(item).with_attached(held, self.gripper.tcp_link, self.gripper.hand_links)
        yield solution.then(
            GripUntilForce(self.gripper, grasp.force, self.settle, self.thinnest, box, T_tcp_box), scene=scene
        )


def _upright_between_fingers(T_world_tcp: SE3, z: float) -> SE3:
    """Return the pose in the TCP frame of an upright box between the fingers at a bin-clearing grasp, whose
    middle is at the world height `z` [m] and whose y axis is along the closing direction.
    """
    at, y = T_world_tcp.translation, T_world_tcp.rotation.matrix[:, 1]
    upright = SE3(SO3.exp((0.0, 0.0, float(np.arctan2(-y[0], y[1])))), np.array([at[0], at[1], z]))
    return T_world_tcp.inverse() @ upright


@stage_types.register("choose_release_point")
@dataclass(frozen=True, eq=False)
class ChooseReleasePoint:
    """Stage of bin clearing that proposes the given release points over the tray, in the given order.

    A release point consists of x, y and the height of the tray's content below it.
    """

    spots: Sequence[tuple[float, float, float]]  # [m, world]
    hang: float  # [m] extent of the held object below the TCP
    gripper: Gripper
    speed: Speed
    distance: float  # [m] length of the descent
    turns: int = 8
    name: str = "spot"
    provides = DESCENT

    def propose(self, solution: PartialSolution, planning: SearchState) -> Iterator[PartialSolution]:
        gripper = self.gripper
        now = solution.scene.frame_pose(gripper.tcp_link).rotation
        for x, y, under in self.spots:
            for k in range(self.turns):
                R = SO3.exp((0.0, 0.0, 2 * np.pi * k / self.turns)) @ now
                T = SE3(R, np.array([x, y, under + self.hang]))
                name = f"({x:.2f}, {y:.2f}) at {360 // self.turns * k} deg"
                up = partial(self._up, T)
                yield from descents(solution, planning, solution.scene, gripper, T, self.name, name, up)

    def _up(self, T_world_tcp: SE3, at_spot: PlanningScene) -> PlanResult:
        above = T_world_tcp.shifted(z=self.distance)
        return plan_straight(at_spot, self.gripper.arm_group, self.gripper.tcp_link, above, self.speed)


@stage_types.register("open_above")
@dataclass(frozen=True, eq=False)
class ReleaseAboveTray:
    """Stage of bin clearing that opens the hand above the tray and so releases the held object."""

    gripper: Gripper
    margin: float  # [m] wider than now
    settle: float
    name: str = "open"

    @property
    def requires(self) -> tuple[str, ...]:
        return (holding_condition(held_object(self.gripper)),)

    @property
    def consumes(self) -> tuple[str, ...]:
        return self.requires

    def propose(self, solution: PartialSolution, planning: SearchState) -> Iterator[PartialSolution]:
        held = held_object(self.gripper)
        width = min(self.gripper.width_in(solution.scene.state) + self.margin, self.gripper.max_width)
        scene = with_contacts(
            solution.scene.with_detached(held).without_object(held), ((HEAP, self.gripper.hand_links),)
        )
        grip = CommandGripper("open", self.gripper, width, self.gripper.max_force, self.settle)
        if reason := finger_collision(scene, [grip], padded=True):
            planning.reject(self.name, solution.data.get("candidate", ""), reason)
            return
        yield solution.then(
            CheckObjectInFingers(self.gripper),
            Drop(grip),
            scene=scene.with_state(finger_state(self.gripper, width)),
        )


# --- steps ---
@dataclass(frozen=True, eq=False)
class GripUntilForce:
    """Step of bin clearing that closes the fingers until they press with a given force [N] or meet.

    The step adds the gripped object to the planning scene.
    """

    gripper: Gripper
    force: float
    settle: float
    thinnest: float  # [m] width at which the fingers have met
    shape: Shape  # assumed shape between the fingers
    T_tcp_shape: SE3
    name: str = "close"

    def perform(self, ctx: TaskContext) -> Outcome:
        return staged(ctx, StageReport(self.name), lambda: self._close(ctx))

    def _close(self, ctx: TaskContext) -> Outcome:
        driver, name = ctx.driver, self.gripper.name
        driver.command_gripper(name, 0.0, self.force)
        end = driver.now + ctx.settings.gripper_timeout
        while driver.now < end and not ctx.cancel.is_set():
            ctx.advance(0.02)
            reading = driver.gripper(name)
            if reading.force_per_finger >= 0.8 * self.force or reading.width <= self.thinnest:
                break
        if ctx.cancel.is_set():
            return Outcome(ErrorCode.PREEMPTED, "cancelled")
        ctx.advance(self.settle)
        reading = driver.gripper(name)
        if not holds(reading):
            return Outcome(ErrorCode.CONTROL_FAILED, f"closed on nothing ({reading.width * 1000:.1f} mm)")
        ctx.change_scene(self._held)
        width, force = reading.width * 1000, reading.force_per_finger
        ctx.emit("grasp", f"holds something {width:.0f} mm wide with {force:.0f} N per finger")
        return DONE

    def _held(self, scene: PlanningScene) -> PlanningScene:
        held, T = held_object(self.gripper), scene.frame_pose(self.gripper.tcp_link) @ self.T_tcp_shape
        item = CollisionObject.single(held, self.shape, T, movable=True)
        return scene.with_object(item).with_attached(held, self.gripper.tcp_link, self.gripper.hand_links)


@dataclass(frozen=True, eq=False)
class CheckObjectInFingers:
    """Step of bin clearing that checks whether an object is still between the fingers."""

    gripper: Gripper

    def perform(self, ctx: TaskContext) -> Outcome:
        reading = ctx.driver.gripper(self.gripper.name)
        if holds(reading):
            return DONE
        return not_held(ctx, f"lost it: the fingers are {reading.width * 1000:.1f} mm apart and feel nothing")


@dataclass(frozen=True, eq=False)
class Drop:
    """Step of bin clearing that opens the fingers and removes the dropped object from the scene.

    A wall or piece that stops the fingers after the object is free does no harm. A finger inside a channel of
    sheet metal meets its other side: then the fingers close half of the way that they have opened.
    """

    grip: CommandGripper

    def perform(self, ctx: TaskContext) -> Outcome:
        outcome = staged(ctx, StageReport(self.grip.name), lambda: self._open(ctx))
        detach_held(ctx, self.grip.gripper)
        return outcome

    def _open(self, ctx: TaskContext) -> Outcome:
        driver, name = ctx.driver, self.grip.gripper.name
        held = driver.gripper(name).width
        self.grip.start(ctx)
        end = driver.now + ctx.settings.gripper_timeout
        widest, since = 0.0, driver.now
        while abs((width := driver.gripper(name).width) - self.grip.width) >= 1e-3:
            if ctx.cancel.is_set():
                return Outcome(ErrorCode.PREEMPTED, "cancelled")
            if width > widest + MOVES:
                widest, since = width, driver.now
            if width >= held + FREE and driver.now - since > STOPPED:
                break
            if width >= held + LOOSE and driver.now - since > WEDGED:
                driver.command_gripper(name, (held + width) / 2, self.grip.force)
                break
            if driver.now >= end:
                text = f"gripper stands at {1000 * width:.1f} mm, wanted {1000 * self.grip.width:.1f} mm"
                return Outcome(ErrorCode.CONTROL_FAILED, text)
            ctx.advance(0.02)
        ctx.advance(self.grip.settle)
        return DONE


def holds(reading: GripperReading) -> bool:
    """Return whether a gripper in bin clearing counts as holding an object: its fingers press.

    The width does not show sheet metal of 1 mm, which is as thin as the reading's error.
    """
    return reading.force_per_finger > 1.0


def held_object(gripper: Gripper) -> str:
    """Return the name that bin clearing gives to the unknown object in a hand, in the planning scene."""
    return f"object in {gripper.name}"


def detach_held(ctx: TaskContext, gripper: Gripper) -> None:
    """Detach the object that the hand holds in bin clearing, and remove it from the planning scene."""
    held = held_object(gripper)

    def without_held(scene: PlanningScene) -> PlanningScene:
        scene = scene.with_detached(held) if held in scene.attached else scene
        return scene.without_object(held) if held in scene.objects else scene

    ctx.change_scene(without_held)
