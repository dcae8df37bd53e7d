"""Execution through external controllers: ros2_control, ros_control or a vendor's driver.

Sources: the user documentation of joint_trajectory_controller (actions, topic, result codes) and
moveit_simple_controller_manager (division of a trajectory's joints among controllers).
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Protocol

import numpy as np

from armcell.cell import Controller
from armcell.core import (
    ErrorCode,
    ExecutionResult,
    InputError,
    JointState,
    JointTrajectory,
    UnknownNameError,
)
from armcell.model import Gripper
from armcell.ros.actions import ActionClient, SentGoal, State
from armcell.ros.bus import Bus
from armcell.ros.moveit_convert.states import trajectory_message
from armcell.ros.nodes.gripping import ACTION as GRIPPER_COMMAND
from armcell.timing import resting, with_resting_joints

FOLLOW = "control_msgs/FollowJointTrajectory"
FIND = 5.0  # [s] to find a controller
FACTOR, GRACE = 3.0, 5.0  # timeout of a motion: factor times its duration, plus a grace period [s]
GONE = 2.0  # [s] for which an action server may be unreachable
ARRIVED = 0.01  # [rad or m] maximum distance from the trajectory's end
AT_REST = 0.02  # [rad/s or m/s] maximum joint speed at rest
HOLD = 0.2  # [s] for a controller with a command topic to come to rest
POLL = 0.01  # [s]
CODES = {
    -1: "INVALID_GOAL", -2: "INVALID_JOINTS", -3: "OLD_HEADER_TIMESTAMP", -4: "PATH_TOLERANCE_VIOLATED",
    -5: "GOAL_TOLERANCE_VIOLATED",
}  # fmt: skip


def chosen(
    controllers: Mapping[str, Iterable[str]], names: Sequence[str], joints: Iterable[str]
) -> list[str]:
    """Select the external ROS controllers that move the given joints.

    Args:
        controllers: joint names of each available controller.
        names: controllers to use; empty means all that move any of the joints.
        joints: joints to move.
    Raises:
        InputError: a controller is unknown, or no selected controller moves one of the joints.
    """
    for name in names:
        if name not in controllers:
            raise UnknownNameError("controller", name, controllers)
    wanted = set(joints)
    found = [n for n in (names or controllers) if wanted & set(controllers[n])]
    left = wanted - {j for name in found for j in controllers[name]}
    if left:
        of = f"of {', '.join(names)} " if names else ""
        raise InputError(
            f"no controller {of}moves {', '.join(sorted(left))}",
            hint="controllers: " + "; ".join(f"{n}: {', '.join(j)}" for n, j in controllers.items()),
        )
    return found


class Outlet(Protocol):
    """Connection to one external ROS controller, of an action or topic interface."""

    def begin(self, trajectory: JointTrajectory) -> Any:
        """Send a motion to the controller; return the handle that `ended` and `cancel` require.

        Raises:
            InputError: the controller is not available.
        """
        ...

    def ended(self, running: Any) -> ExecutionResult | None: ...

    def cancel(self, running: Any) -> None: ...

    def close(self) -> None: ...


class Controllers:
    """Clients of a cell's external controllers, which are located on first use.

    Args:
        bus: the message bus.
        controllers: the controllers of the cell file.
        joints: returns the measured joint state.
    """

    def __init__(self, bus: Bus, controllers: Sequence[Controller], joints: Callable[[], JointState]):
        self._bus, self._measured = bus, joints
        self._by_name = {c.name: c for c in controllers}
        self.joints = {c.name: c.joints for c in controllers}
        makers = {"FollowJointTrajectory": _Action, "JointTrajectory": _Topic}
        self._outlets: dict[str, Outlet] = {
            c.name: makers[c.type](bus, c, joints) for c in controllers if c.type in makers
        }
        self._grippers = {
            c.joints[0]: (c, ActionClient(bus, c.topic, GRIPPER_COMMAND))
            for c in controllers
            if c.type == "GripperCommand"
        }

    def close(self) -> None:
        for outlet in self._outlets.values():
            outlet.close()
        for _, client in self._grippers.values():
            client.close()

    def __bool__(self) -> bool:
        return bool(self._by_name)

    # --- trajectories ---
    def follow(
        self, trajectory: JointTrajectory, cancel: threading.Event, names: Sequence[str] = ()
    ) -> ExecutionResult:
        """Execute a trajectory with the controllers of its joints and wait until it ends.

        Args:
            trajectory: the motion.
            cancel: event that stops the motion.
            names: controllers to use; empty means all controllers of the joints.
        Raises:
            InputError: no controller moves one of the joints, or a controller is not available.
        """
        using = chosen({n: self.joints[n] for n in self._outlets}, names, trajectory.joint_names)
        running: dict[str, Any] = {}
        results: dict[str, ExecutionResult] = {}
        try:
            for name in using:
                running[name] = self._outlets[name].begin(self._part(trajectory, self.joints[name]))
            give_up = time.monotonic() + FACTOR * trajectory.duration + GRACE
            while len(results) < len(using):
                for name in set(running) - set(results):
                    if (result := self._outlets[name].ended(running[name])) is not None:
                        results[name] = result
                if cancel.is_set() or any(not r.ok for r in results.values()):
                    return self._stopped(using, running, results, cancel)
                if time.monotonic() > give_up:
                    late = ", ".join(sorted(set(using) - set(results)))
                    text = f"{late}: no result {GRACE:g} s after {FACTOR:g} times the motion's duration"
                    return ExecutionResult(ErrorCode.CONTROL_FAILED, text)
                time.sleep(POLL)
            return ExecutionResult(ErrorCode.SUCCESS)
        finally:
            for name in set(running) - set(results):
                self._outlets[name].cancel(running[name])

    def _stopped(
        self, using: Sequence[str], running: dict[str, Any], results: dict[str, ExecutionResult],
        cancel: threading.Event,
    ) -> ExecutionResult:  # fmt: skip
        """Cancel the remaining motions, wait until they end, and return the cause of the stop.

        Returns:
            The first failure of a controller, or PREEMPTED if the caller canceled the motion.
        """
        first = next((r for r in results.values() if not r.ok), None)
        for name in set(using) - set(results):
            self._outlets[name].cancel(running[name])
        give_up = time.monotonic() + GONE
        while set(using) - set(results) and time.monotonic() < give_up:
            for name in set(using) - set(results):
                if (result := self._outlets[name].ended(running[name])) is not None:
                    results[name] = result
            time.sleep(POLL)
        if first is not None and not (cancel.is_set() and first.code is ErrorCode.PREEMPTED):
            return first
        return ExecutionResult(ErrorCode.PREEMPTED, "cancelled")

    def _part(self, trajectory: JointTrajectory, joints: Sequence[str]) -> JointTrajectory:
        """Return the part of a trajectory for one external controller's joints.

        Joints of the controller that the trajectory does not move keep their positions.
        """
        if all(joint in trajectory.joint_names for joint in joints):
            return trajectory.reindexed(joints)
        return with_resting_joints(trajectory, self._measured(), joints)

    # --- grippers ---
    def moves_gripper(self, gripper: Gripper) -> bool:
        """Return True if one of the external controllers moves the gripper's fingers."""
        return gripper.joint_name in {j for joints in self.joints.values() for j in joints}

    def grip(self, gripper: Gripper, width: float, force: float) -> Callable[[], ExecutionResult | None]:
        """Send a gripper command and return a function that polls its result.

        The function returns None until the command has ended.

        Args:
            gripper: the gripper.
            width: target width between the fingers [m].
            force: force per finger [N].
        Raises:
            InputError: the controller is not available.
        """
        if gripper.joint_name not in self._grippers:
            return self._finger_motion(gripper, width)
        controller, client = self._grippers[gripper.joint_name]
        _find(client, controller)
        goal = self._bus.schema.new(f"{GRIPPER_COMMAND}Goal")
        goal.command.position = width if controller.gives_width else gripper.joint_position(width)
        goal.command.max_effort = force
        sent = client.send(goal)

        def ended() -> ExecutionResult | None:
            if not sent.wait(0):
                return None
            stopped_by_object = bool(getattr(sent.result, "stalled", False))
            if sent.state is State.SUCCEEDED or stopped_by_object:
                return ExecutionResult(ErrorCode.SUCCESS, evidence={"stalled": stopped_by_object})
            return ExecutionResult(ErrorCode.CONTROL_FAILED, f"{controller.name}: {_why(sent)}")

        return ended

    def _finger_motion(self, gripper: Gripper, width: float) -> Callable[[], ExecutionResult | None]:
        """Move the fingers with a trajectory controller; return a function that polls for success.

        The caller must detect from the joint states whether an object stops the fingers.
        """
        joint = gripper.joint_name
        name = chosen({n: self.joints[n] for n in self._outlets}, (), [joint])[0]
        here, there = self._measured()[joint], gripper.joint_position(width)
        positions = np.array([[here], [there]])
        motion = JointTrajectory((joint,), np.array([0.0, 1.0]), positions, np.zeros((2, 1)))
        outlet = self._outlets[name]
        running = outlet.begin(self._part(motion, self.joints[name]))

        def ended() -> ExecutionResult | None:
            result = outlet.ended(running)
            return result if result is not None and result.ok else None

        return ended


class _Action:
    """External controller with a FollowJointTrajectory action."""

    def __init__(self, bus: Bus, controller: Controller, joints: Callable[[], JointState]):
        self._bus, self._controller = bus, controller
        self._client = ActionClient(bus, controller.topic, FOLLOW)
        self._seen = time.monotonic()

    def close(self) -> None:
        self._client.close()

    def begin(self, trajectory: JointTrajectory) -> SentGoal:
        _find(self._client, self._controller)
        self._seen = time.monotonic()
        now = self._bus.schema.new("std_msgs/Header")  # a stamp of zero starts the motion immediately
        goal = self._bus.schema.new(f"{FOLLOW}Goal", trajectory_message(self._bus.schema, now, trajectory))
        return self._client.send(goal)

    def ended(self, running: SentGoal) -> ExecutionResult | None:
        name = self._controller.name
        if not running.wait(0):
            if self._client.wait_for_server(0):
                self._seen = time.monotonic()
            elif time.monotonic() - self._seen > GONE:
                return ExecutionResult(ErrorCode.CONTROL_FAILED, f"controller {name} has left")
            return None
        if running.state is State.SUCCEEDED:
            return ExecutionResult(ErrorCode.SUCCESS)
        stopped = running.state in (State.PREEMPTED, State.RECALLED)
        code = ErrorCode.PREEMPTED if stopped else ErrorCode.CONTROL_FAILED
        return ExecutionResult(code, f"{name}: {_why(running)}")

    def cancel(self, running: SentGoal) -> None:
        running.cancel()


class _Topic:
    """External controller with a trajectory topic; joint states show the end of a motion."""

    def __init__(self, bus: Bus, controller: Controller, joints: Callable[[], JointState]):
        self._bus, self._controller, self._measured = bus, controller, joints
        self._publisher = bus.advertise(controller.topic, "trajectory_msgs/JointTrajectory")

    def close(self) -> None:
        self._publisher.close()

    def begin(self, trajectory: JointTrajectory) -> tuple[float, JointTrajectory]:
        if not self._publisher.subscribers:
            raise _absent(self._controller, f"no subscriber of {self._controller.topic}")
        self._publish(trajectory)
        return time.monotonic(), trajectory

    def _publish(self, trajectory: JointTrajectory) -> None:
        header = self._bus.schema.new("std_msgs/Header")
        self._publisher.publish(trajectory_message(self._bus.schema, header, trajectory))

    def ended(self, running: tuple[float, JointTrajectory]) -> ExecutionResult | None:
        began, trajectory = running
        passed = time.monotonic() - began
        if passed < trajectory.duration:
            return None
        state = self._measured().reindexed(trajectory.joint_names)
        error = float(np.max(np.abs(state.positions - trajectory.positions[-1])))
        rests = state.velocities is None or float(np.max(np.abs(state.velocities))) <= AT_REST
        if error <= ARRIVED and rests:
            return ExecutionResult(ErrorCode.SUCCESS, final_error=error)
        if passed > trajectory.duration + GRACE and rests:
            text = f"{self._controller.name}: the joints rest {error:.3f} from the end of the motion"
            return ExecutionResult(ErrorCode.CONTROL_FAILED, text, final_error=error)
        return None

    def cancel(self, running: tuple[float, JointTrajectory]) -> None:
        """Stop an external controller's motion with a one-point trajectory at the current positions."""
        here = self._measured().reindexed(running[1].joint_names)
        hold = resting(here.joint_names, here.positions, HOLD)
        self._publish(replace(hold, accelerations=None))


def _find(client: ActionClient, controller: Controller) -> None:
    if not client.wait_for_server(FIND):
        raise _absent(controller, f"no action server {controller.topic}")


def _absent(controller: Controller, what: str) -> InputError:
    return InputError(
        f"controller {controller.name}: {what}",
        hint="is the robot's program running, and is that its name there? (cell file: controllers)",
    )


def _why(sent: SentGoal) -> str:
    """Return the error code and text that an external controller reported for a failed goal."""
    code = getattr(sent.result, "error_code", 0)
    text = getattr(sent.result, "error_string", "") or sent.text
    words = [CODES.get(code, "") if isinstance(code, int) else "", text]
    return ": ".join(word for word in words if word) or sent.state.name
