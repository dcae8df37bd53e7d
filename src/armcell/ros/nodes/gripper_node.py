"""Grippers on the bus: a command topic and an action for each, and automatic closing.

Source of the action: control_msgs/GripperCommand. As in ROS drivers of parallel grippers, `position` is the
width between the pads [m] and `max_effort` is the force per finger [N].
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

import numpy as np

from armcell.cell import LiveCell
from armcell.core import ErrorCode, ExecutionResult, InputError, JointTrajectory
from armcell.execution import ExecutionSteps
from armcell.grasping import grip_force
from armcell.model import Gripper, RobotModel, SuctionGripper
from armcell.ros.actions import ActionOutcome, ActionServer, Goal, GoalState
from armcell.ros.bus import Bus
from armcell.ros.nodes.motion_queue import MotionHandle, MotionQueue
from armcell.scene import CollisionObject, PlanningScene

logger = logging.getLogger(__name__)
TOPIC = "/gripper_command"
ACTION = "control_msgs/GripperCommand"
ARRIVED = 1e-3  # [m] maximum distance from the target width
STANDS = 2e-3  # [m/s] a slower change of the width counts as standstill
STALL_TIME = 0.15  # [s] of standstill after which the fingers count as stalled
TIMEOUT = 4.0  # [s, cell time]
LOOK_PERIOD = 0.05  # [s] between two checks whether a gripper should close automatically
AT_REST = 0.02  # [rad/s or m/s] an arm is at rest if all of its joints are slower
NEAR = 0.03  # [m] margin around the tcp for objects that closing fingers may touch
REST_TIME = 0.1  # [s] that an arm must rest before automatic closing


def gripper_command_steps(
    driver: Any, gripper: Gripper, width: float, force: float, cancel: threading.Event, patience: float = 1.0
) -> ExecutionSteps:
    """Execute a gripper command from ROS.
    The motion ends when the gripper reaches the target width, an object stops it, or the vacuum has built up.

    A cancelled motion stops the fingers where they are, as ros_control's gripper_action_controller does;
    fingers that hold an object keep their force.

    Args:
        driver: the cell's driver.
        gripper: the gripper.
        width: target width [m].
        force: force per finger [N].
        cancel: event that ends the motion early.
        patience: factor on the time after which fingers count as stalled, and on the time limit.
    Returns:
        SUCCESS with the evidence "stalled", "held" and "width" [m], PREEMPTED with the current "width" [m],
            or CONTROL_FAILED with the gripper's reason.
    """
    # The width of a suction gripper says nothing about its vacuum: wait until it holds or has had time.
    sucks = isinstance(gripper, SuctionGripper) and width <= 0.0
    build_up = 5 * gripper.evacuation if isinstance(gripper, SuctionGripper) else 0.0
    stall_time, timeout = STALL_TIME * patience, TIMEOUT * patience
    driver.command_gripper(gripper.name, width, force)
    began = still = driver.now
    last = driver.gripper(gripper.name).width
    yield
    while True:
        reading = driver.gripper(gripper.name)
        now = driver.now
        if cancel.is_set():
            if not reading.held:
                driver.command_gripper(gripper.name, reading.width, force)
            return ExecutionResult(ErrorCode.PREEMPTED, "cancelled", {"width": reading.width}, began, now)
        if reading.fault:
            return ExecutionResult(ErrorCode.CONTROL_FAILED, reading.fault, {}, began, now)
        if abs(reading.width - last) > STANDS * max(now - still, driver.period):
            last, still = reading.width, now
        arrived = abs(reading.width - width) <= ARRIVED and not sucks
        stalled = now - still >= stall_time and now - began > 2 * stall_time
        if sucks:
            stalled = reading.held is not None or now - began > build_up
        # A held object must be pressed with the full force before the arm moves.
        late = now - began > timeout
        pressed = sucks or not reading.held or reading.force_per_finger >= 0.8 * force or late
        if (arrived and not reading.held) or (stalled and pressed) or late:
            evidence = {"stalled": not arrived, "held": reading.held, "width": reading.width}
            text = f"holds {reading.held}" if reading.held else f"stands at {reading.width * 1000:.1f} mm"
            return ExecutionResult(ErrorCode.SUCCESS, text, evidence, began, now)
        yield


def objects_near_tcp(scene: PlanningScene, gripper: Gripper, margin: float) -> list[CollisionObject]:
    """Return the objects near the tcp of a gripper that a ROS client closes. An object is near if its
    bounding box, grown by `margin` [m], contains the tcp.
    """
    tcp = scene.frame_pose(gripper.tcp_link).translation
    found = []
    for item in scene.objects.values():
        low, high = item.bounds()
        point = item.T_world_object.inverse().apply(tcp)
        if item.movable and np.all(point >= low - margin) and np.all(point <= high + margin):
            found.append(item)
    return found


def with_finger_contacts(scene: PlanningScene, group: str) -> PlanningScene:
    """Return the scene in which a ROS client closes a gripper group: contacts between the gripper's fingers
    and nearby objects are allowed.

    A goal of a gripper group closes the fingers onto the object, so contact at the goal is not a collision.
    For other groups, the scene is unchanged.
    """
    pairs = {
        frozenset((item.name, link)): True
        for gripper in scene.model.grippers.values()
        if gripper.group == group
        for item in objects_near_tcp(scene, gripper, NEAR)
        for link in gripper.contact_links
    }
    return replace(scene, allowed_pairs={**pairs, **scene.allowed_pairs}) if pairs else scene


def finger_goals(model: RobotModel, trajectory: JointTrajectory) -> list[tuple[Gripper, float]]:
    """Return the gripper commands in a ROS client's trajectory that moves only fingers: each gripper with its
    final width [m].

    Returns an empty list for any other trajectory.
    """
    fingers = {name: g for g in model.grippers.values() for name in g.joint_names}
    if not set(trajectory.joint_names) <= set(fingers):
        return []
    return [(fingers[n], max(fingers[n].width(q), 0.0)) for n, q in trajectory.end.as_dict().items()]


def gripper_topics(model: RobotModel) -> dict[str, str]:
    """Return the ROS topic that commands each gripper, by the name of the gripper."""
    return {g: TOPIC if len(model.grippers) == 1 else f"/{g}{TOPIC}" for g in model.grippers}


class GripperMotions:
    """Motions that open and close a cell's grippers for clients on the bus, and the finger contacts that
    these motions cause.

    Args:
        live: the cell.
        conductor: the queue of motions.
        patience: see `gripper_command_steps`.
    """

    def __init__(self, live: LiveCell, conductor: MotionQueue, patience: float = 1.0):
        self._live, self._conductor, self._patience = live, conductor, patience
        self._expected: dict[str, set[str]] = {g: set() for g in live.model.grippers}
        self.has_closed = False
        """True if a client has commanded a gripper to close."""

    def drive(self, gripper: Gripper, width: float, force: float) -> MotionHandle:
        """Queue a client's command to open or close a gripper. A force of 0 selects the maximum force of the
        gripper.

        Args:
            gripper: the gripper.
            width: target width [m].
            force: force per finger [N].
        Raises:
            InputError: a number is not finite.
        """
        if not (np.isfinite(width) and np.isfinite(force)):
            raise InputError(f"gripper command of width {width} m and force {force} N")
        width = float(np.clip(width, 0.0, gripper.max_width))
        force = float(min(force, gripper.max_force)) if force > 0 else gripper.max_force
        joints = gripper.joint_names

        def make(driver: Any, cancel: threading.Event) -> ExecutionSteps:
            return self.command_steps(driver, gripper, width, force, cancel)

        return self._conductor.put(MotionHandle(f"gripper {gripper.name}", joints, make))

    def command_steps(
        self, driver: Any, gripper: Gripper, width: float, force: float, cancel: threading.Event
    ) -> ExecutionSteps:
        """Open or close a gripper. Before the gripper closes, allow contacts between its fingers and nearby
        objects.

        The simulation and the motion gate then accept these contacts.
        """
        if width < driver.gripper(gripper.name).width:
            self.has_closed = True
            self._expect_contact(gripper)
        return gripper_command_steps(driver, gripper, width, force, cancel, self._patience)

    def _expect_contact(self, gripper: Gripper) -> None:
        """Declare that contacts between the fingers of a gripper and
        the objects near its tcp are expected.
        """
        for item in objects_near_tcp(self._live.scene(), gripper, NEAR):
            self._live.ctx.expect_contact(item.name, gripper.contact_links)
            self._expected[gripper.name].add(item.name)

    def revoke_finger_contacts(self, joints: Iterable[str]) -> None:
        """Stop expecting contacts between a gripper's fingers and those objects that the arm has moved away
        from.
        """
        driver = self._live.driver
        for gripper in self._live.model.grippers.values():
            expected = self._expected[gripper.name]
            arm = self._live.model.group(gripper.arm_group).joint_names
            if not expected or not set(arm) & set(joints):
                continue
            near = {item.name for item in objects_near_tcp(self._live.scene(), gripper, NEAR)}
            for name in expected - near - {driver.gripper(gripper.name).held}:
                self._live.ctx.expect_contact(name, gripper.contact_links, expected=False)
                expected.discard(name)


class GripperNode(GripperMotions):
    """Node with a command topic and an action for each gripper of a cell.

    The topic is /gripper_command, or /<gripper>/gripper_command if the cell has several grippers. The action
    is /<gripper>_controller/gripper_cmd.

    Args:
        live: the cell.
        bus: the message bus.
        conductor: the queue of motions.
        say: receives a text for each rejected command and each automatic action.
        auto_grip: if True, a gripper closes when its arm has come to rest with an object between the open
            fingers.
    """

    def __init__(
        self, live: LiveCell, bus: Bus, conductor: MotionQueue, say: Callable[[str], None], auto_grip: bool
    ):
        super().__init__(live, conductor)
        self._bus, self._say, self._auto = bus, say, auto_grip
        self._next, self._rests_since = 0.0, dict.fromkeys(live.model.grippers, np.inf)
        self._moved: dict[str, bool] = dict.fromkeys(live.model.grippers, False)
        self._members: list[Any] = []
        for name, topic in gripper_topics(live.model).items():
            gripper = live.model.gripper(name)
            self._members += [
                bus.subscribe(topic, "std_msgs/Float64", self._commanded(gripper)),
                ActionServer(
                    bus, f"/{name}_controller/gripper_cmd", ACTION, self._action(gripper), accepts=False
                ),
            ]

    @property
    def auto_grip(self) -> bool:
        return self._auto

    def close(self) -> None:
        for member in self._members:
            member.close()

    def _commanded(self, gripper: Gripper) -> Callable[[Any], None]:
        def command(message: Any) -> None:
            value = message.data
            try:
                self.drive(
                    gripper, max(value, 0.0) if value == value else value, -value if value < 0 else 0.0
                )
            except InputError:
                self._say(f"refused: gripper command {value}")

        return command

    def _action(self, gripper: Gripper) -> Callable[[Goal], ActionOutcome]:
        Result = self._bus.schema.message(f"{ACTION}Result")

        def run(goal: Goal) -> ActionOutcome:
            command = goal.message.command
            try:
                work = self.drive(gripper, command.position, command.max_effort)
            except InputError as error:
                return ActionOutcome(GoalState.REJECTED, Result(), str(error))
            while not work.wait(0.02):
                if work.moving:
                    goal.accept()
                if goal.cancel.is_set():
                    work.cancel.set()
            reading = self._conductor.call(lambda: self._live.driver.gripper(gripper.name))
            result = work.outcome()
            stalled = bool(result.evidence.get("stalled"))
            message = Result(reading.width, reading.force_per_finger, stalled, result.ok and not stalled)
            return ActionOutcome(
                GoalState.SUCCEEDED if result.ok else GoalState.PREEMPTED, message, result.message
            )

        return run

    # --- automatic closing, in the driver's thread ---
    def grip_automatically(self) -> None:
        """Automatically close the gripper of each arm at rest if an object is between the fingers."""
        driver = self._live.driver
        if not self._auto or driver.now < self._next:
            return
        self._next = driver.now + LOOK_PERIOD
        state = driver.joint_state()
        for gripper in self._live.model.grippers.values():
            joints = self._live.model.group(gripper.arm_group).joint_names
            busy = self._conductor.motions((*joints, *gripper.joint_names))
            speed = state.reindexed(joints).velocities
            if busy or (speed is not None and np.max(np.abs(speed), initial=0.0) > AT_REST):
                self._rests_since[gripper.name] = driver.now
                self._moved[gripper.name] |= bool(busy)
                continue
            rested = driver.now - self._rests_since[gripper.name] >= REST_TIME
            if rested and self._moved[gripper.name]:
                self._moved[gripper.name] = False
                self._close_around(gripper)

    def _close_around(self, gripper: Gripper) -> None:
        reading = self._live.driver.gripper(gripper.name)
        between = objects_near_tcp(self._live.scene(), gripper, 0.0)
        if reading.held or reading.width < 0.5 * gripper.max_width or not between:
            return
        item = between[0]
        text = f"the arm rests with {item.name} between the fingers"
        self._expect_contact(gripper)
        force = grip_force(item, gripper)
        joints = (*gripper.joint_names, *self._live.model.group(gripper.arm_group).joint_names)
        make = lambda driver, cancel: gripper_command_steps(driver, gripper, 0.0, force, cancel)  # noqa: E731
        try:
            self._conductor.put(MotionHandle(f"grip {item.name}", joints, make, gives_way=False))
        except InputError as error:  # the cell is about to close, or too many motions wait
            self._say(f"{text}, but: {error}")
        else:
            self._say(f"{text}: the gripper closes")
