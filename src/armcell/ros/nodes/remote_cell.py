"""Access to a cell whose simulator or robot runs in another process, through topics only.

The other process is Unity, `armcell sim` or a robot's driver. The result of a motion comes from
/trajectory_status if the simulator publishes it, otherwise from the joint states.
"""

from __future__ import annotations

import logging
import re
import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence, Set
from dataclasses import replace
from typing import Any

import numpy as np

from armcell.cell import Controller
from armcell.core import SE3, ErrorCode, ExecutionResult, InputError, JointState, JointTrajectory
from armcell.execution import ExecutionSettings, MotionGate
from armcell.model import Gripper, RobotModel
from armcell.records.mcap_writer import ros_name
from armcell.ros.bus import Bus
from armcell.ros.complaints import Complaints
from armcell.ros.convert import pose_from_message, trajectory_from_message
from armcell.ros.moveit_convert.states import joint_state_from_message
from armcell.ros.nodes.cell_node import STATUS, TRAJECTORY
from armcell.ros.nodes.conductor import Work
from armcell.ros.nodes.controllers import Controllers, chosen
from armcell.ros.nodes.gripping import TOPIC as GRIPPER
from armcell.ros.nodes.gripping import around_tcp, finger_goals
from armcell.ros.units import check_near, unit_fault
from armcell.scene import WORLD, PlanningScene

logger = logging.getLogger(__name__)
STATE_TIMEOUT = 5.0  # [s, wall clock] to wait for the first joint states
POSE_TIMEOUT = 1.0  # [s] to wait for the poses of movable objects after the first joint states
STALE = 2.0  # [s] without joint states after which the simulator counts as lost
ARRIVED = 0.01  # [rad or m] maximum distance from the trajectory's end
AT_REST = 0.02  # [rad/s or m/s] maximum joint speed at rest
FACTOR = 3.0  # timeout of a motion: this multiple of its duration [wall clock],
GRACE = 5.0  # [s] plus this grace period
GRIP_TIME = 0.3  # [s, wall clock] of standstill after which fingers count as stalled
GRIP_TIMEOUT = 6.0  # [s]
GRIP_START = 0.4  # [s] for fingers to begin to move
HELD_MARGIN = 0.01  # [m] an object is between the fingers if its box with this margin contains the tcp
POLL = 0.01  # [s]
CLOSED = 0.002  # [m] threshold for a width below the first one, or above the commanded one
BEGINS = "executing"  # prefix on /trajectory_status that reports the start of a motion


class RemoteCell:
    """Implementation of `CellAccess` for a simulator or robot that is connected to the bus.

    Only one motion runs at a time, even with several arms: this class does not check motions against each
    other, and the simulator's status messages do not identify their motion.

    Args:
        bus: the message bus.
        scene: the cell's initial scene; measured joint states and object poses replace its values.
        controllers: the controllers of the robot's own program, which then executes all motions. Without
            controllers, motions go to /planned_trajectory and gripper widths to /gripper_command.
    """

    def __init__(self, bus: Bus, scene: PlanningScene, controllers: Sequence[Controller] = ()):
        self._bus, self._scene = bus, scene
        self._controllers = Controllers(bus, controllers, self.joints)
        self._lock, self._edit = threading.Lock(), threading.Lock()
        self._joints: JointState | None = None
        self._at = 0.0  # [s, wall clock] arrival of the last joint states
        self._poses: dict[str, SE3] = {}
        self._unseen = {n for n, o in scene.objects.items() if o.movable}  # objects without a pose so far
        self._targets: dict[str, float] = {}  # [m] commanded gripper widths
        self._first_widths: dict[str, float] = {}  # [m] gripper widths in the first joint states
        self._running: list[Work] = []
        self._expected: frozenset[frozenset[str]] = frozenset()
        self.gate = MotionGate(self)
        self._closed = threading.Event()
        movable = [n for n, o in scene.objects.items() if o.movable]
        topics = {f"/object_pose/{ros_name(n)}": n for n in movable}
        if len(movable) == 1:
            topics["/object_pose"] = movable[0]
        self._members: list[Any] = [
            bus.subscribe("/joint_states", "sensor_msgs/JointState", self._on_joints, 2),
            bus.subscribe("/clock", "rosgraph_msgs/Clock", self._on_clock, 2),
            bus.subscribe(STATUS, "std_msgs/String", self._on_status, 50),
            *(
                bus.subscribe(topic, "geometry_msgs/PoseStamped", self._pose_callback(name), 2)
                for topic, name in topics.items()
            ),
        ]
        self._trajectories = bus.advertise(TRAJECTORY, "trajectory_msgs/JointTrajectory")
        grippers = list(scene.model.grippers.values())
        self._grippers = {
            g.name: bus.advertise(
                GRIPPER if len(grippers) == 1 else f"/{g.name}{GRIPPER}", "std_msgs/Float64"
            )
            for g in grippers
        }
        for gripper, publisher in zip(grippers, self._grippers.values()):  # scripts may also command them
            self._members.append(
                bus.subscribe(publisher.topic, "std_msgs/Float64", self._command_callback(gripper.name), 2)
            )
        self._said: list[str] = []
        self._complaints = Complaints()
        self._refused = ""  # reason for which the last joint states were rejected
        self._announces = False  # True if the simulator reports the start of motions

    def close(self) -> None:
        self._closed.set()
        for member in (*self._members, self._trajectories, *self._grippers.values(), self._controllers):
            member.close()

    # --- subscriptions ---
    def _complain(self, text: str) -> None:
        """Log a fault once for each kind, because messages arrive many times per second."""
        if self._complaints.is_new(re.sub(r"[-+.0-9]+", "", text)):
            logger.warning("%s", text)

    def _on_joints(self, message: Any) -> None:
        try:
            state = joint_state_from_message(message, self.model)
            if state is None:
                return
            velocities = None
            if len(message.velocity) == len(message.name):
                by_name = dict(zip(message.name, message.velocity))
                velocities = np.array([float(by_name[n]) for n in state.joint_names])
            state = JointState(state.joint_names, state.positions, velocities)
            if fault := unit_fault(self.model, state.joint_names, state.positions.tolist()):
                raise InputError("positions far outside the limits", hint=fault)
        except InputError as error:
            self._refused = f"; the last one was refused: {error}"
            self._complain(f"/joint_states: {error}")
            return
        with self._lock:
            self._joints, self._at, self._refused = state, time.monotonic(), ""
            for name, gripper in self.model.grippers.items():
                if gripper.joint_name in state.joint_names:
                    self._first_widths.setdefault(name, gripper.width(state[gripper.joint_name]))

    def _on_clock(self, message: Any) -> None:
        self._bus.clock.set(message.clock.to_sec())

    def _on_status(self, message: Any) -> None:
        with self._lock:
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
                check_near(T)
            except InputError as error:
                self._complain(f"pose of {name}: {error}")
                return
            with self._lock:
                self._poses[name] = T
                self._unseen.discard(name)

        return take

    def _command_callback(self, gripper: str) -> Callable[[Any], None]:
        def take(message: Any) -> None:
            if np.isfinite(message.data):
                self._targets[gripper] = max(float(message.data), 0.0)

        return take

    # --- state ---
    @property
    def is_seen(self) -> bool:
        """Return whether joint states of the remote cell have arrived."""
        return self._joints is not None

    @property
    def silence(self) -> float:
        """Return the age of the last joint states [s, wall clock]; 0 before the first joint states."""
        with self._lock:
            return time.monotonic() - self._at if self._joints is not None else 0.0

    @property
    def has_closed(self) -> bool:
        """Return whether a gripper has closed or was commanded to close since the start."""
        with self._lock:
            state, targets = self._joints, dict(self._targets)
        for name, first in self._first_widths.items():
            gripper = self.model.gripper(name)
            width = first if state is None else gripper.width(state[gripper.joint_name])
            if min(targets.get(name, first), width) < first - CLOSED:
                return True
        return False

    @property
    def model(self) -> RobotModel:
        return self._scene.model

    def joints(self) -> JointState:
        """Return the last joint states; before the first joint states, wait for them.

        Raises:
            InputError: no joint states have arrived, or the last joint states are too old; the error states
                the remedy.
        """
        give_up = time.monotonic() + STATE_TIMEOUT
        while self._joints is None and time.monotonic() < give_up and not self._closed.is_set():
            time.sleep(POLL)
        with self._lock:
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
        return state

    def scene(self) -> PlanningScene:
        state = self.joints()
        self._await_poses()
        model = self.model
        q = self._scene.state.updated(state).positions
        with self._lock:
            scene, poses = self._scene, dict(self._poses)
        scene = replace(scene, positions=np.clip(q, model.lower, model.upper))
        for name, T in poses.items():
            if name in scene.objects:
                scene = scene.with_object_pose(name, T)
        for gripper in model.grippers.values():
            between = around_tcp(scene, gripper, HELD_MARGIN)
            if between and self._grips(gripper, state):
                scene = scene.with_attached(between[0].name, gripper.tcp_link, gripper.hand_links)
        return scene

    def _await_poses(self) -> None:
        """Wait once for the simulator's object poses; then use the cell's poses for other objects."""
        if not self._unseen:
            return
        give_up = time.monotonic() + POSE_TIMEOUT
        while self._unseen and time.monotonic() < give_up and not self._closed.is_set():
            time.sleep(POLL)
        if self._unseen:
            logger.warning("no /object_pose of %s: taken from the cell", ", ".join(sorted(self._unseen)))
            self._unseen = set()

    def _grips(self, gripper: Gripper, state: JointState) -> bool:
        """Return True if a gripper holds an object: its fingers are wider open than commanded.

        Without a command, closer fingers than at first mean that the simulator closed them itself.
        """
        if gripper.joint_name not in state.joint_names:
            return False
        target, width = self._targets.get(gripper.name), gripper.width(state[gripper.joint_name])
        if target is None:
            return width < self._first_widths.get(gripper.name, width) - CLOSED
        return width > max(target, 0.0) + CLOSED

    def held(self, gripper: Gripper) -> str | None:
        bodies = self.scene().attached
        return next((n for n, b in bodies.items() if b.link == gripper.tcp_link), None)

    def change(self, make: Callable[[PlanningScene], PlanningScene]) -> PlanningScene:
        with self._edit:
            measured = self.scene()
            changed = make(measured)
            for name in measured.attached:
                if name not in self._scene.attached and name in changed.attached:
                    changed = changed.with_detached(name)  # the fingers determine what is held
            with self._lock:
                self._scene = changed
        return self.scene()

    # --- motions ---
    def works(self, joints: Iterable[str] | None = None) -> list[Work]:
        wanted = None if joints is None else frozenset(joints)
        with self._lock:
            self._running = [w for w in self._running if not w.is_over]
            return [w for w in self._running if wanted is None or w.joints & wanted]

    def _begin(self, work: Work, follow: Callable[[Work], ExecutionResult]) -> Work:
        """Start a motion after conflicting motions have ended.

        Earlier motions of the same joints are stopped; a motion of an arm also waits until the other arms are
        still.

        Raises:
            InputError: the cell is closed.
        """
        while not self._begun(work):
            if self._closed.is_set():
                raise InputError("the cell is closed")

        def run() -> None:
            try:
                work.end(follow(work))
            except InputError as error:
                work.end(None, error)

        threading.Thread(target=run, name=work.name, daemon=True).start()
        return work

    def _begun(self, work: Work) -> bool:
        """Register a motion and return True if no other motion conflicts with it.

        Otherwise, stop the motions of the same joints and return False.
        """
        with self._lock:
            self._running = [w for w in self._running if not w.is_over]
            moves = work.trajectory is not None
            others = [
                w for w in self._running if w.joints & work.joints or (moves and w.trajectory is not None)
            ]
            if not others:
                self._running.append(work)
                return True
        for other in others:
            if other.joints & work.joints:
                other.stop(f"preempted by a newer motion ({work.name})")
        others[0].wait(0.05)
        return False

    # --- interface for the motion gate ---
    @property
    def base(self) -> PlanningScene:
        with self._lock:
            return self._scene

    def object_poses(self) -> dict[str, SE3]:
        with self._lock:
            return dict(self._poses)

    def expected_contacts(self) -> Set[frozenset[str]]:
        return self._expected

    def clock(self) -> float:
        return time.monotonic()

    @property
    def keeps_time(self) -> bool:
        return False  # unknown for a remote simulator

    def emit(self, kind: str, text: str, **data: Any) -> None:
        logger.warning("%s: %s", kind, text)

    def tell(self, kind: str, text: str, **data: Any) -> None:
        pass  # the simulator's process records its own events

    @property
    def controllers(self) -> Mapping[str, tuple[str, ...]]:
        return self._controllers.joints

    def play(
        self,
        message: Any,
        settings: ExecutionSettings = ExecutionSettings(),
        planned_in: PlanningScene | None = None,
        controllers: Sequence[str] = (),
    ) -> Work:
        trajectory = trajectory_from_message(message, self.model, self.joints())
        if not len(trajectory.times):
            joints = trajectory.joint_names or self.model.joint_names
            return self._begin(Work("stop", joints), lambda work: self._stopped(message))
        if controllers or self._controllers:
            chosen(self.controllers, controllers, trajectory.joint_names)
        if goals := finger_goals(self.model, trajectory):
            return self._drive([(gripper, width, gripper.max_force) for gripper, width in goals])

        def follow(work: Work) -> ExecutionResult:
            self._check_start(trajectory, settings)
            motion = self.gate.motion(trajectory, planned_in, work.cancel)
            if (unproven := motion.begin()) is not None:
                return unproven
            try:
                if self._controllers:
                    result = self._controllers.follow(trajectory, motion, controllers)
                else:
                    with self._lock:
                        self._said.clear()
                    self._trajectories.publish(message)
                    result = self._follow(trajectory, motion)
            except BaseException as error:
                motion.end(ExecutionResult(ErrorCode.CONTROL_FAILED, str(error)))
                raise
            return motion.end(result)

        return self._begin(Work("trajectory", trajectory.joint_names, trajectory=trajectory), follow)

    def _stopped(self, message: Any) -> ExecutionResult:
        self._trajectories.publish(message)
        return ExecutionResult(ErrorCode.SUCCESS, "stop")

    def _check_start(self, trajectory: JointTrajectory, settings: ExecutionSettings) -> None:
        here = self.joints().reindexed(trajectory.joint_names).positions
        errors = np.abs(here - trajectory.positions[0])
        if np.max(errors) > settings.start_tolerance:
            i = int(np.argmax(errors))
            raise InputError(
                f"{trajectory.joint_names[i]} is {errors[i]:.3f} from the trajectory's start",
                hint="plan again from its state",
            )

    def _follow(self, trajectory: JointTrajectory, cancel: threading.Event) -> ExecutionResult:
        names, end = trajectory.joint_names, trajectory.positions[-1]
        give_up = time.monotonic() + FACTOR * trajectory.duration + GRACE
        error = np.inf
        while time.monotonic() < give_up and not self._closed.is_set():
            if cancel.is_set():
                self.stop_joints(names)
                return ExecutionResult(ErrorCode.PREEMPTED, "cancelled")
            with self._lock:
                said = list(self._said)
            if (result := _result_of(said, begun=not self._announces)) is not None:
                return result
            if not said:  # the simulator reports no status: check the joint states
                state = self.joints().reindexed(names)
                error = float(np.max(np.abs(state.positions - end)))
                rests = state.velocities is None or float(np.max(np.abs(state.velocities))) <= AT_REST
                if error <= ARRIVED and rests:
                    return ExecutionResult(ErrorCode.SUCCESS, final_error=error)
            time.sleep(POLL)
        text = f"the simulator did not arrive: {error:.3f} from the end"
        return ExecutionResult(ErrorCode.CONTROL_FAILED, text)

    def drive(self, gripper: Gripper, width: float, force: float) -> Work:
        if not (np.isfinite(width) and np.isfinite(force)):
            raise InputError(f"gripper command of width {width} m and force {force} N")
        return self._drive([(gripper, float(np.clip(width, 0.0, gripper.max_width)), force)])

    def _drive(self, goals: list[tuple[Gripper, float, float]]) -> Work:
        """Move grippers one after the other to widths [m] with forces [N]; an object may stop them."""

        def follow(work: Work) -> ExecutionResult:
            result = ExecutionResult(ErrorCode.SUCCESS)
            for gripper, width, force in goals:
                self._targets[gripper.name] = width
                force = min(force, gripper.max_force)
                ended: Callable[[], ExecutionResult | None] = lambda: None  # noqa: E731
                if self._controllers.moves_gripper(gripper):
                    ended = self._controllers.grip(gripper, width, force)
                else:  # the topic carries one number: a width, or, if negative, the closing force
                    value = -force if width <= 0 < force else width
                    self._grippers[gripper.name].publish(self._bus.schema.new("std_msgs/Float64", value))
                result = self._follow_fingers(work, gripper, width, ended)
                if not result.ok:
                    break
            return result

        names = ", ".join(gripper.name for gripper, _, _ in goals)
        return self._begin(Work(f"gripper {names}", [gripper.joint_name for gripper, _, _ in goals]), follow)

    def _follow_fingers(
        self, work: Work, gripper: Gripper, wanted: float, ended: Callable[[], ExecutionResult | None]
    ) -> ExecutionResult:
        """Wait until the fingers reach their target or stop, or their controller reports a failure."""
        began = still = time.monotonic()
        last = np.inf
        while time.monotonic() - began < GRIP_TIMEOUT and not self._closed.is_set():
            if work.cancel.is_set():
                return ExecutionResult(ErrorCode.PREEMPTED, "cancelled")
            if (reported := ended()) is not None and not reported.ok:
                return reported
            width = gripper.width(self.joints()[gripper.joint_name])
            if abs(width - last) > 5e-4:
                last, still = width, time.monotonic()
            if abs(width - wanted) <= 1e-3:
                return ExecutionResult(ErrorCode.SUCCESS, evidence={"width": width, "stalled": False})
            now = time.monotonic()
            if now - still > GRIP_TIME and now - began > GRIP_START + GRIP_TIME:
                break
            time.sleep(POLL)
        return ExecutionResult(ErrorCode.SUCCESS, evidence={"width": last, "stalled": True})

    def expect_contact(self, body: str, others: Iterable[str], expected: bool = True) -> None:
        """Declare expected contacts for the motion gate, which then allows them.

        The simulator handles contacts independently of this declaration.
        """
        pairs = {frozenset((body, other)) for other in others}
        with self._lock:
            self._expected = self._expected | pairs if expected else self._expected - pairs

    def stop_joints(self, names: Iterable[str]) -> None:
        """Stop joints by publishing an empty trajectory.

        Goals that were sent to controllers are canceled by their own motions.
        """
        self._trajectories.publish(
            self._bus.schema.new("trajectory_msgs/JointTrajectory", joint_names=list(names))
        )

    def stop(self) -> None:
        for work in self.works():
            work.cancel.set()
        self.stop_joints(())


def _result_of(said: list[str], begun: bool) -> ExecutionResult | None:
    """Derive a motion's result from the /trajectory_status messages since the motion was sent.

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
            return ExecutionResult(ErrorCode.CONTROL_FAILED, f"the simulator: {why}")
        if begun and what == "done":
            return ExecutionResult(ErrorCode.SUCCESS, why)
        if begun and what == "stopped":
            return ExecutionResult(ErrorCode.PREEMPTED, f"the simulator: {why}")
    return None
