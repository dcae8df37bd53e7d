"""Grippers on the bus: a command topic and an action for each, and closing by themselves where that is asked.

Source of the action: control_msgs/GripperCommand; `position` is the width between the pads [m], `max_effort`
the force per finger [N]; both as ROS drivers of parallel grippers have them.
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
from armcell.grasping import grip_force
from armcell.model import Gripper, RobotModel
from armcell.ros.actions import ActionServer, Done, Goal, State
from armcell.ros.bus import Bus
from armcell.ros.nodes.conductor import Conductor, Steps, Work
from armcell.scene import CollisionObject, PlanningScene

logger = logging.getLogger(__name__)
TOPIC = "/gripper_command"
ACTION = "control_msgs/GripperCommand"
ARRIVED = 1e-3  # [m] from the width that was asked
STANDS = 2e-3  # [m/s] of the width, slower counts as standing
STALL_TIME = 0.15  # [s] that the fingers stand before they count as stalled
TIMEOUT = 4.0  # [s] of the cell's time
LOOK_PERIOD = 0.05  # [s] between two looks whether a gripper should close by itself
AT_REST = 0.02  # [rad/s or m/s] of every joint of an arm that has arrived
NEAR = 0.03  # [m] from the tcp: what closing fingers may touch
REST_TIME = 0.1  # [s]


def gripping(driver: Any, gripper: Gripper, width: float, force: float, cancel: threading.Event) -> Steps:
    """Drive a gripper until it is where it should be, or stands because something is in the way.

    Returns:
        SUCCESS: evidence "stalled", "held" and "width" [m]. PREEMPTED: it stays where it is.
    """
    driver.command_gripper(gripper.name, width, force)
    began = still = driver.now
    last = driver.gripper(gripper.name).width
    yield
    while True:
        reading = driver.gripper(gripper.name)
        now = driver.now
        if cancel.is_set():
            return ExecutionResult(ErrorCode.PREEMPTED, "cancelled", {"width": reading.width}, began, now)
        if abs(reading.width - last) > STANDS * max(now - still, driver.period):
            last, still = reading.width, now
        arrived = abs(reading.width - width) <= ARRIVED
        stalled = now - still >= STALL_TIME and now - began > 2 * STALL_TIME
        # What is held is pressed with the whole force before anything is moved.
        pressed = not reading.held or reading.force_per_finger >= 0.8 * force or now - began > TIMEOUT
        if (arrived and not reading.held) or (stalled and pressed) or now - began > TIMEOUT:
            evidence = {"stalled": not arrived, "held": reading.held, "width": reading.width}
            text = f"holds {reading.held}" if reading.held else f"stands at {reading.width * 1000:.1f} mm"
            return ExecutionResult(ErrorCode.SUCCESS, text, evidence, began, now)
        yield


def around_tcp(scene: PlanningScene, gripper: Gripper, margin: float) -> list[CollisionObject]:
    """Movable objects whose bounding box, grown by a margin [m], holds the tcp."""
    tcp = scene.frame_pose(gripper.tcp_link).translation
    found = []
    for item in scene.objects.values():
        low, high = item.bounds()
        point = item.T_world_object.inv().apply(tcp)
        if item.movable and np.all(point >= low - margin) and np.all(point <= high + margin):
            found.append(item)
    return found


def with_finger_contacts(scene: PlanningScene, group: str) -> PlanningScene:
    """Allow the fingers of a gripper's group to touch what is between them; other groups change nothing.

    A goal of a gripper's group closes onto the object, so its end in contact is no collision.
    """
    pairs = {
        frozenset((item.name, link)): True
        for gripper in scene.model.grippers.values()
        if gripper.group == group
        for item in around_tcp(scene, gripper, NEAR)
        for link in gripper.finger_links
    }
    return replace(scene, allowed_pairs={**pairs, **scene.allowed_pairs}) if pairs else scene


def finger_goals(model: RobotModel, trajectory: JointTrajectory) -> list[tuple[Gripper, float]]:
    """Grippers and final widths [m] of a trajectory that moves only fingers; empty for any other."""
    fingers = {g.joint_name: g for g in model.grippers.values()}
    if not set(trajectory.joint_names) <= set(fingers):
        return []
    return [(fingers[n], max(fingers[n].width(q), 0.0)) for n, q in trajectory.end.as_dict().items()]


class GripperNode:
    """Serves the grippers of a cell: /gripper_command (or /<gripper>/gripper_command where there are
    several) and /<gripper>_controller/gripper_cmd.

    Args:
        say: told what is refused and what the grippers do by themselves.
        auto_grip: close around an object that is between the open fingers where the arm has come to rest.
    """

    def __init__(
        self, live: LiveCell, bus: Bus, conductor: Conductor, say: Callable[[str], None], auto_grip: bool
    ):
        self._live, self._bus, self._conductor, self._say = live, bus, conductor, say
        self._auto = auto_grip
        self._next, self._rests_since = 0.0, dict.fromkeys(live.model.grippers, np.inf)
        self._moved: dict[str, bool] = dict.fromkeys(live.model.grippers, False)
        grippers = list(live.model.grippers.values())
        self._expected: dict[str, set[str]] = {g: set() for g in live.model.grippers}
        self.has_closed = False
        """Whether a gripper has been commanded to close."""
        self._members: list[Any] = []
        for gripper in grippers:
            topic = TOPIC if len(grippers) == 1 else f"/{gripper.name}{TOPIC}"
            self._members.append(bus.subscribe(topic, "std_msgs/Float64", self._commanded(gripper)))
            name = f"/{gripper.name}_controller/gripper_cmd"
            self._members.append(ActionServer(bus, name, ACTION, self._action(gripper)))

    @property
    def closes_by_itself(self) -> bool:
        return self._auto

    def close(self) -> None:
        for member in self._members:
            member.close()

    def drive(self, gripper: Gripper, width: float, force: float) -> Work:
        """Begin to open or close; a force of 0 is the gripper's largest.

        Raises:
            InputError: numbers that are not finite.
        """
        if not (np.isfinite(width) and np.isfinite(force)):
            raise InputError(f"gripper command of width {width} m and force {force} N")
        width = float(np.clip(width, 0.0, gripper.max_width))
        force = float(min(force, gripper.max_force)) if force > 0 else gripper.max_force
        joints = (gripper.joint_name,)

        def make(driver: Any, cancel: threading.Event) -> Steps:
            return self.closing(driver, gripper, width, force, cancel)

        return self._conductor.put(Work(f"gripper {gripper.name}", joints, make))

    def closing(
        self, driver: Any, gripper: Gripper, width: float, force: float, cancel: threading.Event
    ) -> Steps:
        """`gripping`, where physics and the motion gate know that closing fingers touch the object."""
        if width < driver.gripper(gripper.name).width:
            self.has_closed = True
            self._expect_contact(gripper)
        return gripping(driver, gripper, width, force, cancel)

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

    def _action(self, gripper: Gripper) -> Callable[[Goal], Done]:
        Result = self._bus.schema.message(f"{ACTION}Result")

        def run(goal: Goal) -> Done:
            command = goal.message.command
            try:
                work = self.drive(gripper, command.position, command.max_effort)
            except InputError as error:
                return Done(State.REJECTED, Result(), str(error))
            while not work.wait(0.02):
                if goal.cancel.is_set():
                    work.cancel.set()
            reading = self._conductor.call(lambda: self._live.driver.gripper(gripper.name))
            result = work.outcome()
            stalled = bool(result.evidence.get("stalled"))
            message = Result(reading.width, reading.force_per_finger, stalled, result.ok and not stalled)
            return Done(State.SUCCEEDED if result.ok else State.PREEMPTED, message, result.message)

        return run

    # --- by itself; in the driver's thread ---
    def look(self) -> None:
        """Close the grippers whose arms have come to rest around something."""
        driver = self._live.driver
        if not self._auto or driver.now < self._next:
            return
        self._next = driver.now + LOOK_PERIOD
        state = driver.joint_state()
        for gripper in self._live.model.grippers.values():
            joints = self._live.model.group(gripper.arm_group).joint_names
            busy = self._conductor.works((*joints, gripper.joint_name))
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
        between = around_tcp(self._live.scene(), gripper, 0.0)
        if reading.held or reading.width < 0.5 * gripper.max_width or not between:
            return
        item = between[0]
        text = f"the arm rests with {item.name} between the fingers"
        self._expect_contact(gripper)
        force = grip_force(item, gripper)
        joints = (gripper.joint_name, *self._live.model.group(gripper.arm_group).joint_names)
        make = lambda driver, cancel: gripping(driver, gripper, 0.0, force, cancel)  # noqa: E731
        try:
            self._conductor.put(Work(f"grip {item.name}", joints, make, gives_way=False))
        except InputError as error:  # the cell is about to close, or too much waits
            self._say(f"{text}, but: {error}")
        else:
            self._say(f"{text}: the gripper closes")

    def _expect_contact(self, gripper: Gripper) -> None:
        """Fingers that close around something are meant to touch it."""
        for item in around_tcp(self._live.scene(), gripper, NEAR):
            self._live.ctx.expect_contact(item.name, gripper.finger_links)
            self._expected[gripper.name].add(item.name)

    def moved(self, joints: Iterable[str]) -> None:
        """An arm's motion has ended: fingers that have left an object are not meant to touch it any more."""
        driver = self._live.driver
        for gripper in self._live.model.grippers.values():
            expected = self._expected[gripper.name]
            arm = self._live.model.group(gripper.arm_group).joint_names
            if not expected or not set(arm) & set(joints):
                continue
            near = {item.name for item in around_tcp(self._live.scene(), gripper, NEAR)}
            for name in expected - near - {driver.gripper(gripper.name).held}:
                self._live.ctx.expect_contact(name, gripper.finger_links, expected=False)
                expected.discard(name)
