"""A node that serves a live cell: it publishes states and executes trajectories.

Grippers have their own node (`GripperNode`).
"""

from __future__ import annotations

import logging
import time
from typing import Any

import numpy as np

from armcell.cell import LiveCell
from armcell.core import ErrorCode, ExecutionResult, InputError
from armcell.execution import SCENE_INVALIDATED, ExecutionSettings
from armcell.ros.actions import ActionOutcome, ActionServer, Goal, GoalState
from armcell.ros.bus import Bus
from armcell.ros.nodes.cameras import CameraPublisher
from armcell.ros.nodes.cell_motions import CellMotions
from armcell.ros.nodes.gripper_node import GripperNode
from armcell.ros.nodes.motion_queue import MotionHandle
from armcell.ros.nodes.state_publisher import RATE, StatePublisher, check_rate

logger = logging.getLogger(__name__)
TRAJECTORY = "/planned_trajectory"
STATUS = "/trajectory_status"
ACTION = "control_msgs/FollowJointTrajectory"

# control_msgs/FollowJointTrajectoryResult
SUCCESSFUL, INVALID_GOAL, INVALID_JOINTS, PATH_TOLERANCE_VIOLATED, GOAL_TOLERANCE_VIOLATED = 0, -1, -2, -4, -5


class CellNode(CellMotions):
    """Node that serves a live cell on the bus: it publishes the states of the cell and executes trajectories.

    Input topics:

    - /planned_trajectory (trajectory_msgs/JointTrajectory): a newer trajectory of the same joints replaces
      the current one; an empty trajectory stops.
    - /gripper_command (std_msgs/Float64): a value of 0 or more is a width [m], where 0 grasps; a negative
      value closes with this force [N per finger]. With several grippers: /<gripper>/gripper_command.

    Actions: /<group>_controller/follow_joint_trajectory for each arm and gripper, and
    /<gripper>_controller/gripper_cmd for each gripper. Output topics besides the states: /trajectory_status
    (std_msgs/String) and the camera topics (`CameraPublisher`).

    Args:
        live: the cell; `run` connects it, and its time scale sets the pace.
        bus: the message bus.
        rate: publishing rate of the states [Hz, cell time].
        auto_grip: if True, a gripper closes by itself when its arm rests with an object between the open
            fingers.
    Raises:
        InputError: the rate is higher than the driver's rate.
    """

    def __init__(self, live: LiveCell, bus: Bus, rate: float = RATE, auto_grip: bool = False):
        check_rate(live.driver, rate)
        model = live.model
        super().__init__(
            live,
            {f"{name}_controller": model.group(name).joint_names for name in live.arms}
            | {f"{g.name}_controller": g.joint_names for g in model.grippers.values()},
        )
        self.bus = bus
        self._states = StatePublisher(bus, live.scene_at_start, rate)
        self.cameras = CameraPublisher(bus, live.cameras)
        self._status = bus.advertise(STATUS, "std_msgs/String", latch=True)
        trajectories = bus.subscribe(TRAJECTORY, "trajectory_msgs/JointTrajectory", self._on_trajectory)
        self.grippers = self._gripper_node = GripperNode(live, bus, self.conductor, self.say, auto_grip)
        actions = [
            ActionServer(bus, f"/{name}/follow_joint_trajectory", ACTION, self._follow, accepts=False)
            for name in self.controllers
        ]
        self._members = *actions, trajectories, self.grippers, self._status, self._states, self.cameras

    # --- the driver's thread ---
    def run(self) -> None:
        """Run the node until `close`: step the cell and execute the commands of its clients. Then remove the
        node from the bus.
        """
        try:
            super().run()
        finally:
            for member in self._members:
                member.close()

    def _connected(self) -> None:
        self._states.publish(self.live.driver)

    def _after_step(self) -> None:
        if self._states.due(self.live.driver.now):
            self._states.publish(self.live.driver)
            self.cameras.publish(self._states.tf)
        self._gripper_node.grip_automatically()
        super()._after_step()

    def say(self, text: str) -> None:
        """Publish a status message of the cell node on the topic /trajectory_status."""
        super().say(text)
        if not self._status.closed:
            self._status.publish(self.bus.schema.new("std_msgs/String", text))

    # --- callbacks, in the threads of subscriptions and actions ---
    def _on_trajectory(self, message: Any) -> None:
        try:
            self.queue_trajectory(message)
        except InputError as error:
            logger.info("trajectory refused: %s", error)

    def _follow(self, goal: Goal) -> ActionOutcome:
        """Execute a control_msgs/FollowJointTrajectory goal for a client of the cell node, in the thread of
        the action.

        The goal is accepted when the motion starts.
        """
        Result = self.bus.schema.message(f"{ACTION}Result")
        try:
            if len(goal.message.multi_dof_trajectory.points):
                raise InputError("multi-DOF trajectories are not executed", hint="send joint positions")
            work = self.queue_trajectory(goal.message.trajectory, _tolerances(goal.message))
        except InputError as error:
            code = INVALID_JOINTS if "unknown joint" in str(error) else INVALID_GOAL
            return ActionOutcome(
                GoalState.REJECTED, Result(error_code=code, error_string=str(error)), str(error)
            )
        feedback = _Feedback(self, goal)
        while not work.wait(0.02):
            if goal.cancel.is_set():
                work.cancel.set()
            if work.moving:
                goal.accept()
                feedback.give(work)
        if self._stop.is_set():
            return ActionOutcome(GoalState.ABORTED, Result(), "the cell was closed")
        if work.error is not None:
            text = str(work.error)
            return ActionOutcome(GoalState.REJECTED, Result(error_code=INVALID_GOAL, error_string=text), text)
        result = work.outcome()
        preempted = result.code is ErrorCode.PREEMPTED
        if not (result.ok or preempted or work.moving):  # rejected before it started
            message = Result(error_code=INVALID_GOAL, error_string=result.message)
            return ActionOutcome(GoalState.REJECTED, message, result.message)
        message = Result(error_code=_follow_code(result), error_string=result.message)
        if result.ok:
            return ActionOutcome(GoalState.SUCCEEDED, message, result.message)
        return ActionOutcome(GoalState.PREEMPTED if preempted else GoalState.ABORTED, message, result.message)


class _Feedback:
    """Feedback on a FollowJointTrajectory goal of the cell node: the desired and actual joint states, ten
    times a second.
    """

    PERIOD = 0.1  # [s]

    def __init__(self, node: CellNode, goal: Goal):
        self._node, self._goal, self._next = node, goal, 0.0

    def give(self, work: MotionHandle) -> None:
        trajectory = work.trajectory
        if trajectory is None or work.began is None or time.monotonic() < self._next:
            return
        self._next = time.monotonic() + self.PERIOD
        bus, driver = self._node.bus, self._node.live.driver
        try:
            state, now = self._node.conductor.call(lambda: (driver.joint_state(), driver.now))
        except InputError:
            return  # the cell is closed
        passed = now - work.began
        wanted, moving, _ = trajectory.sample(passed)
        actual = state.reindexed(trajectory.joint_names)
        at = bus.schema.message("builtin_interfaces/Duration").from_sec(passed)

        def point(q: np.ndarray, v: np.ndarray | None) -> Any:
            return bus.schema.new(
                "trajectory_msgs/JointTrajectoryPoint",
                positions=q, velocities=np.zeros(len(q)) if v is None else v, time_from_start=at,
            )  # fmt: skip

        self._goal.feedback(
            bus.schema.new(
                f"{ACTION}Feedback", bus.header(), list(trajectory.joint_names), point(wanted, moving),
                point(actual.positions, actual.velocities), point(wanted - actual.positions, None),
            )
        )  # fmt: skip


def _tolerances(goal: Any) -> ExecutionSettings:
    """Convert the tolerances in a FollowJointTrajectory goal of the cell node to execution settings.

    The smallest tolerance of any joint applies to all joints; missing tolerances keep armcell's defaults.
    """
    values: dict[str, float] = {}
    for key, entries in (("path_tolerance", goal.path_tolerance), ("goal_tolerance", goal.goal_tolerance)):
        given = [float(t.position) for t in entries if t.position > 0]
        if given:
            values[key] = min(given)
    if (seconds := goal.goal_time_tolerance.to_sec()) > 0:
        values["settle_time"] = seconds
    return ExecutionSettings(**values)


def _follow_code(result: ExecutionResult) -> int:
    if result.ok:
        return SUCCESSFUL
    if result.code is ErrorCode.PREEMPTED:
        return INVALID_GOAL  # preemption has no code; ros2_control uses this one for a replaced goal
    left = "left the path" in result.message or result.code is SCENE_INVALIDATED
    return PATH_TOLERANCE_VIOLATED if left else GOAL_TOLERANCE_VIOLATED
