"""Steps with an unknown object in the hand, based on the gripper's readings only."""

from __future__ import annotations

from dataclasses import dataclass

from armcell.core import SE3, ErrorCode, Outcome, Shape
from armcell.drivers import GripperReading
from armcell.model import Gripper
from armcell.scene import CollisionObject, PlanningScene
from armcell.tasks.context import StageReport, TaskContext
from armcell.tasks.steps import DONE, Grip, not_held, staged

HELD = "held thing"
"""Name of the held object in the planning scene."""


@dataclass(frozen=True, eq=False)
class GripUntilForce:
    """Step that closes until the fingers press with a force [N] or meet.

    It adds the object to the planning scene.
    """

    gripper: Gripper
    force: float
    settle: float
    thinnest: float  # [m]
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
        if not holds(reading, self.thinnest):
            return Outcome(ErrorCode.CONTROL_FAILED, f"closed on nothing ({reading.width * 1000:.1f} mm)")
        ctx.change_scene(self._held)
        width, force = reading.width * 1000, reading.force_per_finger
        ctx.emit("grasp", f"holds something {width:.0f} mm wide with {force:.0f} N per finger")
        return DONE

    def _held(self, scene: PlanningScene) -> PlanningScene:
        T = scene.frame_pose(self.gripper.tcp_link) @ self.T_tcp_shape
        item = CollisionObject.single(HELD, self.shape, T, movable=True)
        return scene.with_object(item).with_attached(HELD, self.gripper.tcp_link, self.gripper.hand_links)


@dataclass(frozen=True, eq=False)
class StillThere:
    """Step that checks whether an object is still between the fingers."""

    gripper: Gripper
    thinnest: float  # [m]

    def perform(self, ctx: TaskContext) -> Outcome:
        reading = ctx.driver.gripper(self.gripper.name)
        if holds(reading, self.thinnest):
            return DONE
        return not_held(ctx, f"lost it: the fingers are {reading.width * 1000:.1f} mm apart and feel nothing")


@dataclass(frozen=True, eq=False)
class Drop:
    """Step that opens to a width [m] and removes the held object from the scene."""

    gripper: Gripper
    width: float
    settle: float

    def perform(self, ctx: TaskContext) -> Outcome:
        outcome = Grip("open", self.gripper, self.width, self.gripper.max_force, self.settle).perform(ctx)
        empty_handed(ctx)
        return outcome


def holds(reading: GripperReading, thinnest: float) -> bool:
    """Return whether an object keeps a closing gripper open."""
    return reading.width > thinnest and reading.force_per_finger > 1.0


def empty_handed(ctx: TaskContext) -> None:
    """Remove the held object from the planning scene."""

    def empty(scene: PlanningScene) -> PlanningScene:
        scene = scene.with_detached(HELD) if HELD in scene.attached else scene
        return scene.without_object(HELD) if HELD in scene.objects else scene

    ctx.change_scene(empty)
