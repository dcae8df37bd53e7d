"""Execution through external controllers: ros2_control, ros_control or a vendor's driver.

Sources: the user documentation of joint_trajectory_controller (actions, topic, result codes) and
moveit_simple_controller_manager (division of a trajectory's joints among controllers).
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Protocol

import numpy as np

from armcell.cell import Controller
from armcell.core import (
    ErrorCode,
    InputError,
    JointState,
    JointTrajectory,
    Outcome,
    UnknownNameError,
)
from armcell.drivers.execution_handle import RUNNING
from armcell.model import Gripper
from armcell.ros.actions import ActionClient, ClientGoalHandle, GoalState
from armcell.ros.bus import Bus
from armcell.ros.convert import trajectory_message
from armcell.ros.nodes.gripper_node import ACTION as GRIPPER_COMMAND
from armcell.timing import stationary_trajectory, with_resting_joints

FOLLOW = "control_msgs/FollowJointTrajectory"
FIND = 5.0  # [s] to find a controller
FACTOR, GRACE = 3.0, 5.0  # timeout of a motion: factor times its duration, plus a grace period [s]
GONE = 2.0  # [s] for which an action server may be unreachable
ARRIVED = 0.01  # [rad or m] maximum distance from the trajectory's end
AT_REST = 0.02  # [rad/s or m/s] maximum joint speed at rest
HOLD = 0.2  # [s] for a controller with a command topic to come to rest
CANCELLED = Outcome(ErrorCode.PREEMPTED, "cancelled")
CODES = {
    -1: "INVALID_GOAL", -2: "INVALID_JOINTS", -3: "OLD_HEADER_TIMESTAMP", -4: "PATH_TOLERANCE_VIOLATED",
    -5: "GOAL_TOLERANCE_VIOLATED",
}  # fmt: skip


def select_controllers(
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


class ControllerConnection(Protocol):
    """Connection to one external ROS controller, through its action or its topic."""

    def wait_until_available(self, timeout: float) -> InputError | None:
        """Wait up to `timeout` [s] for an external ROS controller.
        Return an error if it is still not available.
        """
        ...

    def begin(self, trajectory: JointTrajectory) -> Any:
        """Send a motion to an external ROS controller and return a handle.
        Pass the handle to `ended` and `cancel`.
        """
        ...

    def poll_result(self, running: Any) -> Outcome | None: ...

    def cancel(self, running: Any) -> None: ...

    def close(self) -> None: ...


class ExternalControllers:
    """Client of the external ROS controllers that execute the motions of a cell.

    Args:
        bus: the message bus.
        controllers: the controllers of the cell file.
        joints: returns the measured joint state.
    """

    def __init__(self, bus: Bus, controllers: Sequence[Controller], joints: Callable[[], JointState]):
        self._bus, self._measured = bus, joints
        self.joints = {c.name: c.joints for c in controllers}
        makers = {"FollowJointTrajectory": _Action, "JointTrajectory": _Topic}
        self._outlets: dict[str, ControllerConnection] = {
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

    def wait_for_controllers(self, joints: Iterable[str], names: Sequence[str] = ()) -> None:
        """Wait until the external ROS controllers for some joints are available.

        Args:
            names: controllers to use; empty means all controllers of the joints.
        Raises:
            InputError: no controller moves one of the joints, or a controller is not available.
        """
        arms = [j for j in joints if j not in self._grippers]
        missing = [self._outlets[name].wait_until_available(FIND) for name in self._using(arms, names)]
        missing += [_missing(c, client, FIND) for j, (c, client) in self._grippers.items() if j in joints]
        for error in missing:
            if error is not None:
                raise error

    def _using(self, joints: Sequence[str], names: Sequence[str]) -> list[str]:
        return select_controllers({n: self.joints[n] for n in self._outlets}, names, joints) if joints else []

    # --- trajectories ---
    def follow(self, trajectory: JointTrajectory, names: Sequence[str] = ()) -> ControllerMotion:
        """Execute a trajectory with the external ROS controllers that move its joints.

        Args:
            names: controllers to use; empty means all controllers of the joints.
        """
        outlets = {name: self._outlets[name] for name in self._using(trajectory.joint_names, names)}
        running: dict[str, Any] = {}
        try:
            for name, outlet in outlets.items():
                running[name] = outlet.begin(self._part(trajectory, self.joints[name]))
        except InputError:
            for name in running:
                outlets[name].cancel(running[name])
            raise
        return ControllerMotion(outlets, running, FACTOR * trajectory.duration + GRACE)

    def _part(self, trajectory: JointTrajectory, joints: Sequence[str]) -> JointTrajectory:
        """Return the part of a trajectory for one external controller. The part contains all joints of this
        controller.

        Joints of the controller that the trajectory does not move keep their positions.
        """
        if all(joint in trajectory.joint_names for joint in joints):
            return trajectory.reindexed(joints)
        return with_resting_joints(trajectory, self._measured(), joints)

    # --- grippers ---
    def moves_gripper(self, gripper: Gripper) -> bool:
        """Return whether one of the external ROS controllers moves the fingers of the gripper."""
        return gripper.joint_name in {j for joints in self.joints.values() for j in joints}

    def grip(self, gripper: Gripper, width: float, force: float) -> Callable[[], Outcome | None]:
        """Send a gripper command to an external ROS controller and return a function that polls the result.

        The function returns None until the command has ended.

        Args:
            gripper: the gripper.
            width: target width between the fingers [m].
            force: force per finger [N].
        """
        if gripper.joint_name not in self._grippers:
            return self._finger_motion(gripper, width)
        controller, client = self._grippers[gripper.joint_name]
        goal = self._bus.schema.new(f"{GRIPPER_COMMAND}Goal")
        goal.command.position = width if controller.gives_width else gripper.joint_position(width)
        goal.command.max_effort = force
        sent = client.send_goal(goal)

        def ended() -> Outcome | None:
            if not sent.wait(0):
                return None
            stopped_by_object = bool(getattr(sent.result, "stalled", False))
            if sent.state is GoalState.SUCCEEDED or stopped_by_object:
                return Outcome(ErrorCode.SUCCESS)
            return Outcome(ErrorCode.CONTROL_FAILED, f"{controller.name}: {_why(sent)}")

        return ended

    def _finger_motion(self, gripper: Gripper, width: float) -> Callable[[], Outcome | None]:
        """Move the fingers with an external trajectory controller and return a function that polls whether
        they have arrived.

        The caller must detect from the joint states whether an object stops the fingers.
        """
        joint = gripper.joint_name
        name = select_controllers({n: self.joints[n] for n in self._outlets}, (), [joint])[0]
        here, there = self._measured()[joint], gripper.joint_position(width)
        positions = np.array([[here], [there]])
        motion = JointTrajectory((joint,), np.array([0.0, 1.0]), positions, np.zeros((2, 1)))
        outlet = self._outlets[name]
        running = outlet.begin(self._part(motion, self.joints[name]))

        def ended() -> Outcome | None:
            result = outlet.poll_result(running)
            return result if result is not None and result.ok else None

        return ended


def goal_error(state: JointState, trajectory: JointTrajectory) -> tuple[float, bool]:
    """Return how far [rad or m] the joints that an external controller moves are from the end of the
    trajectory (largest error), and whether the joints are at rest.
    """
    state = state.reindexed(trajectory.joint_names)
    error = float(np.max(np.abs(state.positions - trajectory.positions[-1])))
    return error, state.velocities is None or float(np.max(np.abs(state.velocities))) <= AT_REST


class ReportedMotion(ABC):
    """Handle to a motion of external controllers or a remote simulator, which report only the outcome, not
    the progress.
    """

    _outcome: Outcome | None = None

    def trajectory_time(self) -> None:
        return None

    def paused(self) -> bool:
        return False

    def state(self) -> str | Outcome:
        if self._outcome is None:
            self._outcome = self._poll()
        return RUNNING if self._outcome is None else self._outcome

    @abstractmethod
    def cancel(self) -> None: ...

    @abstractmethod
    def _poll(self) -> Outcome | None:
        """Return the outcome of the external controllers' or remote simulator's motion, or None during the
        motion.
        """


class ControllerMotion(ReportedMotion):
    """Motion that several external ROS controllers execute together.

    If one controller fails, the other controllers are canceled.

    Args:
        outlets: the controllers by name.
        running: the handle that each controller's `begin` returned.
        timeout: time limit [s, wall clock].
    """

    def __init__(
        self, outlets: Mapping[str, ControllerConnection], running: Mapping[str, Any], timeout: float
    ):
        self._outlets, self._running = outlets, running
        self._give_up = time.monotonic() + timeout
        self._results: dict[str, Outcome] = {}
        self._cancelled = False
        self._stopping: float | None = None  # [s, monotonic] of the cancellation

    def cancel(self) -> None:
        self._cancelled = True
        self._stop()

    @property
    def _left(self) -> list[str]:
        return [name for name in self._running if name not in self._results]

    def _stop(self) -> None:
        if self._stopping is None:
            self._stopping = time.monotonic()
            for name in self._left:
                self._outlets[name].cancel(self._running[name])

    def _poll(self) -> Outcome | None:
        """Return the outcome of a motion of external controllers: the first failure, PREEMPTED after
        `cancel`, or success. Return None during the motion.
        """
        for name in self._left:
            if (result := self._outlets[name].poll_result(self._running[name])) is not None:
                self._results[name] = result
        first = next((r for r in self._results.values() if not r.ok), None)
        if first is not None:
            self._stop()
        now, left = time.monotonic(), self._left
        if not left or (self._stopping is not None and now > self._stopping + GONE):
            if first is not None and not (self._cancelled and first.code is ErrorCode.PREEMPTED):
                return first
            return CANCELLED if self._cancelled else Outcome(ErrorCode.SUCCESS)
        if self._stopping is None and now > self._give_up:
            self._stop()
            text = f"{', '.join(left)}: no result {GRACE:g} s after {FACTOR:g} times the motion's duration"
            return Outcome(ErrorCode.CONTROL_FAILED, text)
        return None


class _Action:
    """External ROS controller that executes motions through a FollowJointTrajectory action."""

    def __init__(self, bus: Bus, controller: Controller, joints: Callable[[], JointState]):
        self._bus, self._controller = bus, controller
        self._client = ActionClient(bus, controller.topic, FOLLOW)
        self._seen = time.monotonic()

    def close(self) -> None:
        self._client.close()

    def wait_until_available(self, timeout: float) -> InputError | None:
        return _missing(self._controller, self._client, timeout)

    def begin(self, trajectory: JointTrajectory) -> ClientGoalHandle:
        self._seen = time.monotonic()
        now = self._bus.schema.new("std_msgs/Header")  # a stamp of zero starts the motion immediately
        goal = self._bus.schema.new(f"{FOLLOW}Goal", trajectory_message(self._bus.schema, now, trajectory))
        return self._client.send_goal(goal)

    def poll_result(self, running: ClientGoalHandle) -> Outcome | None:
        name = self._controller.name
        if not running.wait(0):
            if self._client.wait_for_server(0):
                self._seen = time.monotonic()
            elif time.monotonic() - self._seen > GONE:
                return Outcome(ErrorCode.CONTROL_FAILED, f"controller {name} has left")
            return None
        if running.state is GoalState.SUCCEEDED:
            return Outcome(ErrorCode.SUCCESS)
        stopped = running.state in (GoalState.PREEMPTED, GoalState.RECALLED)
        code = ErrorCode.PREEMPTED if stopped else ErrorCode.CONTROL_FAILED
        return Outcome(code, f"{name}: {_why(running)}")

    def cancel(self, running: ClientGoalHandle) -> None:
        running.cancel()


class _Topic:
    """External ROS controller that executes motions through a trajectory topic. The end of a motion is
    detected from the joint states.
    """

    def __init__(self, bus: Bus, controller: Controller, joints: Callable[[], JointState]):
        self._bus, self._controller, self._measured = bus, controller, joints
        self._publisher = bus.advertise(controller.topic, "trajectory_msgs/JointTrajectory")

    def close(self) -> None:
        self._publisher.close()

    def wait_until_available(self, timeout: float) -> InputError | None:
        if self._publisher.subscribers:
            return None
        return _absent(self._controller, f"no subscriber of {self._controller.topic}")

    def begin(self, trajectory: JointTrajectory) -> tuple[float, JointTrajectory]:
        self._publish(trajectory)
        return time.monotonic(), trajectory

    def _publish(self, trajectory: JointTrajectory) -> None:
        header = self._bus.schema.new("std_msgs/Header")
        self._publisher.publish(trajectory_message(self._bus.schema, header, trajectory))

    def poll_result(self, running: tuple[float, JointTrajectory]) -> Outcome | None:
        began, trajectory = running
        passed = time.monotonic() - began
        if passed < trajectory.duration:
            return None
        error, rests = goal_error(self._measured(), trajectory)
        if error <= ARRIVED and rests:
            return Outcome(ErrorCode.SUCCESS)
        if passed > trajectory.duration + GRACE and rests:
            text = f"{self._controller.name}: the joints rest {error:.3f} from the end of the motion"
            return Outcome(ErrorCode.CONTROL_FAILED, text)
        return None

    def cancel(self, running: tuple[float, JointTrajectory]) -> None:
        """Stop the motion of an external ROS controller by sending a trajectory with one point, the current
        positions.
        """
        here = self._measured().reindexed(running[1].joint_names)
        hold = stationary_trajectory(here.joint_names, here.positions, HOLD)
        self._publish(replace(hold, accelerations=None))


def _missing(controller: Controller, client: ActionClient, timeout: float) -> InputError | None:
    if client.wait_for_server(timeout):
        return None
    return _absent(controller, f"no action server {controller.topic}")


def _absent(controller: Controller, what: str) -> InputError:
    return InputError(
        f"controller {controller.name}: {what}",
        hint="is the robot's program running, and is that its name there? (cell file: controllers)",
    )


def _why(sent: ClientGoalHandle) -> str:
    """Return the error code and the text that an external controller has reported for a failed goal."""
    code = getattr(sent.result, "error_code", 0)
    text = getattr(sent.result, "error_string", "") or sent.text
    words = [CODES.get(code, "") if isinstance(code, int) else "", text]
    return ": ".join(word for word in words if word) or sent.state.name
