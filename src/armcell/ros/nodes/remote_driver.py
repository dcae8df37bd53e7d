"""Driver of a simulator or robot that another program runs, through topics and actions on the bus.

The other program is Unity, `armcell sim` or a robot's driver.
"""

from __future__ import annotations

import logging
import re
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from armcell.cell import Controller
from armcell.core import SE3, ErrorCode, InputError, JointState, JointTrajectory, Outcome
from armcell.core.checks import require
from armcell.drivers import Capability, Driver, ExecutionHandle, GripperReading
from armcell.model import Gripper
from armcell.records.mcap_writer import ros_name
from armcell.ros.bus import Bus
from armcell.ros.convert import (
    check_in_meters,
    joint_state_from_message,
    pose_from_message,
    trajectory_message,
    unit_fault,
)
from armcell.ros.faults import FaultCounter
from armcell.ros.nodes.cell_node import STATUS, TRAJECTORY
from armcell.ros.nodes.external_controllers import (
    ARRIVED,
    CANCELLED,
    FACTOR,
    GRACE,
    ExternalControllers,
    ReportedMotion,
    goal_error,
)
from armcell.ros.nodes.gripper_node import gripper_topics, objects_near_tcp
from armcell.scene import WORLD, PlanningScene

logger = logging.getLogger(__name__)
STATE_TIMEOUT = 5.0  # [s, wall clock] to wait for the first joint states
POSE_TIMEOUT = 1.0  # [s] to wait for the poses of movable objects after the first joint states
STALE = 2.0  # [s] without joint states after which the simulator counts as lost
GRIP_TIME = 0.3  # [s, wall clock] of standstill after which closing fingers hold an object
FINGER_TIMEOUT = 3.0  # [s] to wait for moving fingers before a motion is planned
GRIP_START = 0.4  # [s] for fingers to begin to move
MOVED = 5e-4  # [m] smallest change of the width that counts as a motion of the fingers
PATIENCE = 2.4  # factor on the times of `gripper_command_steps`, for fingers whose state comes over the bus
HELD_MARGIN = 0.01  # [m] an object is between the fingers if its box with this margin contains the tcp
POLL = 0.01  # [s]
CLOSED = 0.002  # [m] threshold for a width below the first one, or above the commanded one
BEGINS = "executing"  # prefix on /trajectory_status that reports the start of a motion


class RemoteDriver(Driver):
    """Driver for a simulator or robot that runs in another program and is connected to the bus.

    The robot plays whole trajectories: by its controllers, or by /planned_trajectory. The result of a motion
    comes from the controllers, from /trajectory_status if the simulator publishes it, or from the joint
    states. Time is the wall clock.

    Args:
        bus: the message bus.
        scene: the cell's initial scene: the robot and the movable objects.
        controllers: the controllers of the robot's own program, which then execute all motions. Without
            controllers, motions go to /planned_trajectory and gripper widths to /gripper_command.
    """

    name = "remote"
    is_simulated = False
    is_paced = True
    period = 0.01
    capabilities = frozenset({Capability.PLAY_TRAJECTORY})

    def __init__(self, bus: Bus, scene: PlanningScene, controllers: Sequence[Controller] = ()):
        self._bus, self._scene, self.model = bus, scene, scene.model
        self._specs = tuple(controllers)
        self.controllers = {c.name: c.joints for c in controllers}
        """Joint names of each controller, by controller name."""
        self.lock = threading.RLock()
        self._closed = threading.Event()
        self._joints: JointState | None = None
        self._at = 0.0  # [s, wall clock] arrival of the last joint states
        self._poses: dict[str, SE3] = {}
        self._unseen = {n for n, o in scene.objects.items() if o.movable}  # objects without a pose so far
        self._targets: dict[str, float] = {}  # [m] commanded gripper widths
        self._forces: dict[str, float] = {}  # [N] commanded gripper forces
        self._first_widths: dict[str, float] = {}  # [m] gripper widths in the first joint states
        self._last_widths: dict[str, tuple[float, float]] = {}  # [m] width, [s] since when
        self._holds: dict[str, tuple[JointState, str | None]] = {}  # held object for the last joint states
        self._grips: dict[str, Callable[[], Outcome | None]] = {}  # results of the gripper controllers
        self._said: list[str] = []
        self._complaints = FaultCounter()
        self._refused = ""  # reason for which the last joint states were rejected
        self._announces = False  # True if the simulator reports the start of motions

    # --- connection and time ---
    def __enter__(self) -> Self:
        bus, movable = self._bus, sorted(self._unseen)
        self._began = self._now = time.monotonic()
        self._closed.clear()
        self._controllers = ExternalControllers(bus, self._specs, self.joint_state)
        object_topics = {f"/object_pose/{ros_name(n)}": n for n in movable}
        if len(movable) == 1:
            object_topics["/object_pose"] = movable[0]
        self._members: list[Any] = [
            bus.subscribe("/joint_states", "sensor_msgs/JointState", self._on_joints, 2),
            bus.subscribe("/clock", "rosgraph_msgs/Clock", self._on_clock, 2),
            bus.subscribe(STATUS, "std_msgs/String", self._on_status, 50),
            *(
                bus.subscribe(topic, "geometry_msgs/PoseStamped", self._pose_callback(name), 2)
                for topic, name in object_topics.items()
            ),
        ]
        self._trajectories = bus.advertise(TRAJECTORY, "trajectory_msgs/JointTrajectory")
        self._grippers = {
            g: bus.advertise(t, "std_msgs/Float64") for g, t in gripper_topics(self.model).items()
        }
        for gripper, publisher in self._grippers.items():  # scripts may also command them
            self._members.append(
                bus.subscribe(publisher.topic, "std_msgs/Float64", self._command_callback(gripper), 2)
            )
        return self

    def __exit__(self, *exc: object) -> None:
        self._closed.set()
        for member in (*self._members, self._trajectories, *self._grippers.values(), self._controllers):
            member.close()

    @property
    def now(self) -> float:
        return self._now - self._began

    def advance(self, duration: float) -> None:
        self._now += duration
        if (left := self._now - time.monotonic()) > 0:
            self._closed.wait(left)
        else:
            self._now -= left

    # --- subscriptions ---
    def _complain(self, text: str) -> None:
        """Log a fault in the messages to the remote driver.
        Each kind of fault is logged only once, because messages arrive often.
        """
        if self._complaints.count(re.sub(r"[-+.0-9]+", "", text)):
            logger.warning("%s", text)

    def _on_joints(self, message: Any) -> None:
        try:
            state = joint_state_from_message(message, self.model)
            if state is None:
                return
            whole = self._scene.state.updated(state)
            if len(message.velocity) == len(message.name):
                by_name = dict(zip(message.name, message.velocity))
                velocities = [float(by_name.get(n, 0.0)) for n in whole.joint_names]
                whole = JointState(whole.joint_names, whole.positions, np.array(velocities))
            if fault := unit_fault(self.model, state.joint_names, state.positions.tolist()):
                raise InputError("positions far outside the limits", hint=fault)
        except InputError as error:
            self._refused = f"; the last one was refused: {error}"
            self._complain(f"/joint_states: {error}")
            return
        with self.lock:
            self._joints, self._at, self._refused = whole, time.monotonic(), ""
            for name, gripper in self.model.grippers.items():
                if gripper.joint_name in state.joint_names:
                    width = gripper.width_in(state)
                    self._first_widths.setdefault(name, width)
                    if abs(width - self._last_widths.get(name, (np.inf, 0.0))[0]) > MOVED:
                        self._last_widths[name] = width, self._at

    def _on_clock(self, message: Any) -> None:
        self._bus.clock.set(message.clock.to_sec())

    def _on_status(self, message: Any) -> None:
        with self.lock:
            self._said.append(message.data)
            self._announces |= message.data.startswith(BEGINS)

    def _pose_callback(self, name: str) -> Callable[[Any], None]:
        def take(message: Any) -> None:
            try:
                frame = message.header.frame_id or WORLD
                known = frame in (WORLD, self.model.root_link)
                T = (SE3.identity() if known else self._scene.frame_pose(frame)) @ pose_from_message(
                    message.pose
                )
                check_in_meters(T)
            except InputError as error:
                self._complain(f"pose of {name}: {error}")
                return
            with self.lock:
                self._poses[name] = T
                self._unseen.discard(name)

        return take

    def _command_callback(self, gripper: str) -> Callable[[Any], None]:
        def take(message: Any) -> None:
            if np.isfinite(message.data):
                self._aim(gripper, max(float(message.data), 0.0))

        return take

    def _aim(self, gripper: str, width: float) -> None:
        """Store the width [m] that a remote gripper was commanded to reach. If the width is new, the gripper
        counts as empty until its fingers have had time to move.
        """
        with self.lock:
            if abs(width - self._targets.get(gripper, np.inf)) > CLOSED:
                last = self._last_widths.get(gripper, (np.inf, 0.0))[0]
                self._last_widths[gripper] = last, time.monotonic() + GRIP_START
                self._holds.pop(gripper, None)
            self._targets[gripper] = width

    # --- state ---
    @property
    def has_joint_states(self) -> bool:
        """Return whether the remote driver has received any joint states from its robot."""
        return self._joints is not None

    @property
    def time_since_joint_states(self) -> float:
        """Return the time [s, wall clock] since the remote driver last
        received joint states; 0 if it has received none.
        """
        with self.lock:
            return time.monotonic() - self._at if self._joints is not None else 0.0

    @property
    def has_closed_gripper(self) -> bool:
        """Return whether a gripper of the remote driver has closed since the start or was commanded to
        close.
        """
        with self.lock:
            targets, widths = dict(self._targets), dict(self._last_widths)
        return any(
            min(targets.get(name, first), widths[name][0]) < first - CLOSED
            for name, first in self._first_widths.items()
        )

    def wait_for_state(self) -> None:
        """Wait until the remote driver has received joint states and object poses. Objects whose poses do not
        arrive stay where the cell defines them.
        """
        self._wait(STATE_TIMEOUT, lambda: self._joints is not None)
        if self._joints is not None and self._unseen:
            self._wait(POSE_TIMEOUT, lambda: not self._unseen)
            if self._unseen:
                logger.warning("no /object_pose of %s: taken from the cell", ", ".join(sorted(self._unseen)))
                self._unseen = set()

    def wait_for_fingers(self) -> None:
        """Wait until the fingers of the remote robot stop moving.
        Only then does the remote driver know which object they hold.
        """
        self._wait(FINGER_TIMEOUT, lambda: all(map(self._rests, list(self._last_widths))))

    def _rests(self, gripper: str) -> bool:
        """Return whether the last joint states from the remote robot show that the fingers of a gripper are
        at rest.
        """
        return self._at - self._last_widths[gripper][1] >= GRIP_TIME

    def _wait(self, timeout: float, is_there: Callable[[], bool]) -> None:
        give_up = time.monotonic() + timeout
        while not is_there() and time.monotonic() < give_up and not self._closed.is_set():
            time.sleep(POLL)

    def wait_for_controllers(self, joints: Iterable[str], names: Sequence[str] = ()) -> None:
        """Wait until the ROS controllers for some joints of the remote driver are available."""
        self._controllers.wait_for_controllers(joints, names)

    def joint_state(self) -> JointState:
        """Return the latest joint states that the remote driver has received from the bus.

        Raises:
            InputError: no joint states have arrived, or the last joint states are too old; the error states
                the remedy.
        """
        with self.lock:
            state, at = self._joints, self._at
        if state is None:
            raise InputError(
                f"no /joint_states yet{self._refused}",
                hint="is the simulator running, connected, and publishing them?",
            )
        if time.monotonic() - at > STALE:
            raise InputError(
                f"no /joint_states for {time.monotonic() - at:.1f} s{self._refused}",
                hint="the simulator stands or is gone",
            )
        return JointState(state.joint_names, state.positions, state.velocities, time=self.now)

    def object_poses(self) -> dict[str, SE3]:
        with self.lock:
            return dict(self._poses)

    # --- arms ---
    def command(
        self, joint_names: tuple[str, ...], positions: ArrayLike, velocities: ArrayLike
    ) -> JointState:
        """Reject a single setpoint, because the robot of a remote driver executes only whole trajectories.

        Raises:
            UnknownNameError: the model has no such joint.
            InputError: in every other case.
        """
        self.model.columns(joint_names)
        raise InputError(
            "a robot at the other end of the bus cannot stream setpoints", hint="send a whole trajectory"
        )

    def follow(self, trajectory: JointTrajectory, controllers: Sequence[str] = ()) -> ExecutionHandle:
        """Send a trajectory to the robot of the remote driver and return a handle to the motion.

        Args:
            controllers: names of the only controllers that may move the joints; empty means all.
        Raises:
            InputError: a controller cannot execute the trajectory.
        """
        if self.controllers:
            return self._controllers.follow(trajectory, controllers)
        with self.lock:
            self._said.clear()
        self._trajectories.publish(trajectory_message(self._bus.schema, self._bus.header(WORLD), trajectory))
        return _Played(self, trajectory)

    def stop(self) -> None:
        self.hold(())

    def hold(self, joint_names: tuple[str, ...]) -> None:
        """Stop joints of the remote driver's robot by sending an empty trajectory.
        Without names, all joints stop.

        Goals that were sent to controllers are canceled by their own motions.
        """
        self._trajectories.publish(
            self._bus.schema.new("trajectory_msgs/JointTrajectory", joint_names=list(joint_names))
        )

    # --- grippers ---
    def command_gripper(self, gripper: str, width: float, force: float) -> None:
        known = self.model.gripper(gripper)
        require(bool(np.isfinite(width) and np.isfinite(force)), f"gripper target {width} m, {force} N")
        self._aim(gripper, width)
        self._forces[gripper] = force
        if self._controllers.moves_gripper(known):
            self._grips[gripper] = self._controllers.grip(known, width, force)
        else:  # the topic carries one number: a width, or, if negative, the closing force
            value = -force if width <= 0 < force else width
            self._grippers[gripper].publish(self._bus.schema.new("std_msgs/Float64", value))

    def gripper(self, gripper: str) -> GripperReading:
        known, state = self.model.gripper(gripper), self.joint_state()
        ended = self._grips[gripper]() if gripper in self._grips else None
        held = self._held(gripper)
        force = self._forces.get(gripper, known.max_force) if held else 0.0
        fault = ended.message if ended is not None and not ended.ok else ""
        return GripperReading(known.width_in(state), force, held, fault)

    def _held(self, gripper: str) -> str | None:
        """Return the object that stopped the fingers of a remote gripper, or None."""
        state, (last, held) = self._joints, self._holds.get(gripper, (None, None))
        if state is None or state is last:
            return held
        gripped = self._grips_object(gripper, state, held is not None)
        held = self._between(self.model.gripper(gripper), state) if gripped else None
        self._holds[gripper] = state, held
        return held

    def _grips_object(self, name: str, state: JointState, before: bool) -> bool:
        """Return whether the fingers of a remote gripper are at rest but are wider open than commanded.

        Without a command, closer fingers than at first mean that the simulator closed them itself.
        """
        if name not in self._first_widths:  # the joint states lack the fingers
            return False
        gripper, target = self.model.gripper(name), self._targets.get(name)
        if not before and not self._rests(name):
            return False
        width = gripper.width_in(state)
        return width < self._first_widths[name] - CLOSED if target is None else width > target + CLOSED

    def _between(self, gripper: Gripper, state: JointState) -> str | None:
        scene = replace(self._scene, positions=np.clip(state.positions, self.model.lower, self.model.upper))
        for item, T in self.object_poses().items():
            scene = scene.with_object_pose(item, T)
        between = objects_near_tcp(scene, gripper, HELD_MARGIN)
        return between[0].name if between else None


class _Played(ReportedMotion):
    """Trajectory that a remote simulator executes.
    Its end is detected from /trajectory_status or the joint states.
    """

    def __init__(self, driver: RemoteDriver, trajectory: JointTrajectory):
        self._driver, self._trajectory = driver, trajectory
        self._give_up = time.monotonic() + FACTOR * trajectory.duration + GRACE

    def cancel(self) -> None:
        if self._outcome is None:
            self._driver.hold(self._trajectory.joint_names)
            self._outcome = CANCELLED

    def _poll(self) -> Outcome | None:
        driver = self._driver
        with driver.lock:
            said, announces = list(driver._said), driver._announces
        if (result := _result_of(said, begun=not announces)) is not None:
            return result
        if said and time.monotonic() < self._give_up:
            return None
        error, rests = goal_error(driver.joint_state(), self._trajectory)
        if error <= ARRIVED and rests and not said:  # the simulator reports no status
            return Outcome(ErrorCode.SUCCESS)
        if time.monotonic() < self._give_up:
            return None
        return Outcome(ErrorCode.CONTROL_FAILED, f"the simulator did not arrive: {error:.3f} from the end")


def _result_of(said: list[str], begun: bool) -> Outcome | None:
    """Determine the result of a remote motion from the /trajectory_status messages that arrived after it was
    sent.

    Args:
        said: the status messages.
        begun: False if the simulator announces each motion with "executing"; messages before the announcement
            then belong to an earlier motion, except for a rejection. True if the simulator never announces
            motions.
    Returns:
        The result, or None if the motion has not ended.
    """
    for text in said:
        what, _, why = text.partition(": ")
        begun |= text.startswith(BEGINS)
        if what == "refused" or (begun and what == "failed"):
            return Outcome(ErrorCode.CONTROL_FAILED, f"the simulator: {why}")
        if begun and what == "done":
            return Outcome(ErrorCode.SUCCESS, why)
        if begun and what == "stopped":
            return Outcome(ErrorCode.PREEMPTED, f"the simulator: {why}")
    return None
