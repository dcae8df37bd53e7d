"""Approach to a grasp that stops at a contact, and what the contact says about the object's pose.

An object may be beside its believed pose: then a finger or the palm touches it before the hand is at the
grasp. A driver that measures forces shows this contact and its point on the hand.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armcell.core import ErrorCode, JointTrajectory, Outcome
from armcell.drivers import Capability
from armcell.grasping import Grasp, hand_of, surface_of
from armcell.model import Gripper, SuctionGripper
from armcell.scene import PlanningScene
from armcell.tasks.context import TaskContext
from armcell.tasks.steps import DONE, EMPTY, DropMonitor, Motion

Array = NDArray[np.float64]

CONTACT = "contact"  # evidence key of approaches that a contact stopped
FORCE_CHECK_PERIOD = 0.008  # [s] between two readings of the force on the hand
SAME_POINT = 0.006  # [m] from the measured point of a contact to the surface that explains it
DIRECTIONS = 16  # of these displacements
SHIFT_STEP = 0.0005  # [m] between two displacements of the object that could explain a contact
FARTHEST = 0.02  # [m] largest displacement that a contact shows


@dataclass(frozen=True)
class HandContact:
    """Contact of the hand with an object during the approach, as the driver measures it.

    Attributes:
        force: [N] on the hand.
        at: (2,) [m] point of the contact along x and y (the closing axis) of the tcp, from the grip center.
        is_on_finger: whether this point is on a finger. Otherwise, the object touches the palm.
        remaining: [m] distance from the hand to the grasp.
    """

    force: float
    at: Array
    is_on_finger: bool
    remaining: float


@dataclass(frozen=True, eq=False)
class Approach(Motion):
    """Step of a pick that moves the open hand straight to a grasp. A force on the hand stops the motion.

    If the object touches the palm just before the grasp, it is between the fingers, and the pick continues.
    """

    object: str = ""
    gripper: Gripper | None = None  # None: no force stops the motion, as in a heap, where the hand may touch
    grasp: Grasp | None = None

    def monitor(self, ctx: TaskContext, trajectory: JointTrajectory) -> DropMonitor:
        feels = Capability.MEASURE_FORCE in ctx.driver.capabilities
        if feels and self.gripper is not None and not isinstance(self.gripper, SuctionGripper):
            return ContactMonitor(ctx, trajectory, self.planned_in, self.gripper)
        return super().monitor(ctx, trajectory)

    def outcome(self, ctx: TaskContext, watch: DropMonitor, result: Outcome) -> Outcome:
        wrench = watch.wrench if isinstance(watch, ContactMonitor) else None
        stopped = result.code in (ErrorCode.CONTROL_FAILED, ErrorCode.PREEMPTED) and not ctx.cancel.is_set()
        if self.gripper is None or self.grasp is None or not stopped:
            return result
        contact = self._contact(ctx, self.gripper, self.grasp, wrench)
        near = contact.remaining <= 2 * ctx.settings.pose_error
        if wrench is not None and near and not contact.is_on_finger:
            ctx.emit("note", f"{self.object} touches the palm {self._measured(contact)}")
            return DONE
        if wrench is not None:
            text = f"the hand touched something {self._measured(contact)}"
        else:
            text = f"the arm stopped {contact.remaining * 1000:.0f} mm before the grasp: {result.message}"
        text = f"approach to {self.object} failed: {text}; {ctx.belief(self.object, self.grasp.width)}"
        ctx.emit("grasp", text)
        evidence = {**result.evidence, EMPTY: True, CONTACT: contact}
        return Outcome(ErrorCode.CONTROL_FAILED, text, evidence)

    def _measured(self, contact: HandContact) -> str:
        aside = f", {contact.at[1] * 1000:+.0f} mm from its center" if contact.is_on_finger else ""
        return (
            f"{contact.remaining * 1000:.0f} mm before the grasp "
            f"(measured: {contact.force:.0f} N on the hand{aside})"
        )

    def _contact(self, ctx: TaskContext, gripper: Gripper, grasp: Grasp, wrench: Array | None) -> HandContact:
        scene = ctx.scene()
        T_world_tcp = scene.frame_pose(gripper.tcp_link)
        T_tcp_grasp = T_world_tcp.inverse() @ scene.object(self.object).T_world_object @ grasp.T_object_tcp
        remaining = float(np.linalg.norm(T_tcp_grasp.translation))
        if wrench is None:
            return HandContact(0.0, np.zeros(2), False, remaining)
        R = T_world_tcp.rotation.matrix
        force, torque = R.T @ wrench[:3], R.T @ wrench[3:]
        center = gripper.grip_center(grasp.width, grasp.opening).translation[:2]
        at = np.zeros(2)
        if abs(force[2]) > abs(force[:2]).max():  # against the approach, at the tips of the fingers
            tip = float(hand_of(scene.model, gripper).left[:, 5].max())
            # torque = point x force
            at = np.array([tip * force[0] - torque[1], tip * force[1] + torque[0]]) / force[2] - center
        on_finger = bool(abs(at[1]) > grasp.opening / 2)
        return HandContact(float(np.linalg.norm(force)), at, on_finger, remaining)


def shift_shown(scene: PlanningScene, item: str, gripper: Gripper, contact: HandContact) -> Array:
    """Return the smallest shift (3,) [m, world frame] of an object, across the approach, that explains a
    contact: the shifted object touches the finger at the contact point. The result is zero if no shift does.

    With this displacement, the object does not touch the other finger.

    Args:
        scene: with the hand where the contact stopped it.
    """
    none = np.zeros(3)
    if not contact.is_on_finger:
        return none
    hand, known, side = hand_of(scene.model, gripper), scene.object(item), float(np.sign(contact.at[1]))
    T_world_tcp, width = scene.frame_pose(gripper.tcp_link), gripper.width_in(scene.state)
    T_center_object = gripper.center(width).inverse() @ T_world_tcp.inverse() @ known.T_world_object
    points = T_center_object.apply(surface_of(known).points)
    touching, other = (hand.left, hand.right) if side > 0 else (hand.right, hand.left)
    away = np.array([0.0, side * width / 2, 0.0] * 2)
    angles = np.arange(DIRECTIONS) * 2 * np.pi / DIRECTIONS
    for size in np.arange(0.0, FARTHEST, SHIFT_STEP):
        for angle in angles if size else angles[:1]:
            shift = size * np.array([np.cos(angle), np.sin(angle), 0.0])
            at = points + shift
            touched = at[_inside(at, touching + away)]
            if not len(touched) or _inside(at, other - away).any():
                continue
            if np.linalg.norm(touched[:, :2] - contact.at, axis=1).min() < SAME_POINT:
                return T_world_tcp.rotation.matrix @ shift
    return none


def _inside(points: Array, boxes: Array) -> NDArray[np.bool_]:
    """Return which points (n, 3) are inside one of the boxes (k, 6) of the approaching hand."""
    at = points[:, None]
    return np.all((at > boxes[:, :3]) & (at < boxes[:, 3:]), axis=2).any(1)


class ContactMonitor(DropMonitor):
    """Guarded motion of an approach, which stops as soon as the force on the hand exceeds the limit.

    Args:
        most_force: [N] the limit; None: `contact_force` of the task's settings.
    Attributes:
        wrench: (6,) [N, Nm] change of the wrench on the hand since the start; None without contact.
    """

    def __init__(
        self, ctx: TaskContext, trajectory: JointTrajectory, planned_in: PlanningScene | None,
        gripper: Gripper, most_force: float | None = None,
    ):  # fmt: skip
        super().__init__(ctx, trajectory, planned_in)
        self._gripper = gripper
        self._most_force = ctx.settings.contact_force if most_force is None else most_force
        self._zero = ctx.driver.wrench(gripper.name)
        self._next_force = ctx.driver.now
        self.wrench: Array | None = None

    def is_set(self) -> bool:
        driver = self._ctx.driver
        if self.wrench is None and driver.now >= self._next_force:
            self._next_force = driver.now + FORCE_CHECK_PERIOD
            wrench = driver.wrench(self._gripper.name) - self._zero
            if np.linalg.norm(wrench[:3]) > self._most_force:
                self.wrench = wrench
        return self.wrench is not None or super().is_set()
