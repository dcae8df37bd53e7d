"""Driver for mode `real`: one or several real arms, of one or several robot kinds."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Iterable
from contextlib import ExitStack
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell import _interrupts
from armcell.core import SE3, InputError, JointState, JointTrajectory, Outcome
from armcell.drivers.driver import Capability, Driver, DriverOptions, GripperReading, drivers
from armcell.drivers.execution_handle import ExecutionHandle, SetpointHistory
from armcell.drivers.motion_guard import MotionGuard
from armcell.drivers.real.arm import CallerStreamedExecution, RealArm, RealGripper, StreamedExecution
from armcell.drivers.real.heartbeat import Heartbeat
from armcell.drivers.real.held_objects import HeldObjects
from armcell.drivers.real.robot_kind import identify_all, kind_of, real_settings
from armcell.drivers.safety import Fault, SafetyEvent, Supervisor, cannot_resume
from armcell.kinematics import kinematic_tree
from armcell.scene import PlanningScene

log = logging.getLogger(__name__)

SEEN_LATE = 0.06  # [s] largest delay of a measured state
GRIPPER_LOST = "gripper lost"
GRIPPER_SILENCE = 1.5  # [s] without an answer of a gripper before the arms stop
LONGEST_SKEW = 0.05  # [s] between the arms' states; an older state is used without interpolation
UNGUARDED = frozenset(
    {
        Capability.PLAY_TRAJECTORY,
        Capability.ROBOT_CLOCK,
        Capability.MEASURE_FORCE,
        Capability.REPORT_MODES,
    }
)


class RealDriver(Driver):
    """Driver of mode `real` for real arms. If any arm stops, no arm moves until `resume()` is called.

    Objects stay at their scene poses until a gripper carries them.
    """

    name = "real"
    is_simulated = False
    is_paced = True

    def __init__(self, scene: PlanningScene, options: DriverOptions):
        if options.time_scale not in (None, 1.0):
            raise InputError(
                f"time scale {options.time_scale:g}: a real robot has its own clock",
                hint="leave out the time scale; use the speed slider",
            )
        self._scene, self._model = scene, scene.model
        self._tree = kinematic_tree(scene.model)
        self.settings = real_settings(options.extra.get("real", {}), scene.model)
        self.period = 1.0 / 125.0
        self.arms: dict[str, RealArm] = {}
        self._grippers: dict[str, RealGripper] = {}
        self._supervisor: Supervisor | None = None  # while connected
        self._resuming = threading.Lock()

    def __enter__(self) -> Self:
        """Connect to every real arm without moving it.

        Raises:
            InputError: wrong address, model or robot, local control, a stop, or a port in use; the message
                states the remedy.
        """
        wanted = self.settings.arms
        for arm in wanted.values():
            kind_of(arm).check_backend(arm.backend)
        self._began = self._advanced = time.monotonic()
        found = identify_all(self.settings)
        for name, arm in wanted.items():
            kind_of(arm).check_identity(name, arm, found[name])
            kind_of(arm).check_ready(name, found[name])
        with ExitStack() as undo:
            self._heartbeat = Heartbeat(self._beat)
            self._heartbeat.start()
            undo.callback(self._heartbeat.stop)
            for name, arm in wanted.items():
                joints = self._model.group(name).joint_names
                made = kind_of(arm).make_arm(name, joints, arm, self.settings, found[name], self._look)
                self.arms[name] = made
                undo.callback(made.close)
                made.connect()
            for gripper in self._model.grippers.values():
                if gripper.arm_group in wanted:
                    tool = self.arms[gripper.arm_group].connect_gripper(gripper)
                    if tool is not None:
                        self._grippers[gripper.name] = tool
                        undo.callback(tool.close)
            undo.pop_all()
        self._column = {
            g.name: column
            for g in self._model.grippers.values()
            for column in self._model.columns(g.joint_names)
        }
        self._q = np.array(self._scene.positions, dtype=float)
        self._objects = HeldObjects(self._scene)
        self._forces: dict[str, float] = {}
        self._T_world_base = {}  # frames of the controllers' bases
        for name, arm in self.arms.items():
            link = self._model.joints[arm.joint_names[0]].parent
            self._T_world_base[name] = self._tree.link_pose(self._q, link) @ arm.T_link_base
        self._supervisor = supervisor = Supervisor(self.arms)
        if self.guard is not None:
            with ExitStack() as undo:
                undo.callback(self.__exit__)
                self._begin_guard(self.guard, supervisor)
                undo.pop_all()
        return self

    def _begin_guard(self, guard: MotionGuard, supervisor: Supervisor) -> None:
        """Prepare the motion guard for the real driver's arms: check their calibrations, measure network
        round trips, and connect the event log.
        """
        guard.check_calibration(self.calibrations())
        guard.trips = {name: arm.start_round_trip_measurement() for name, arm in self.arms.items()}
        guard.note = supervisor.record

    @property
    def capabilities(self) -> frozenset[Capability]:
        return UNGUARDED if self.guard is None else UNGUARDED | {Capability.DRY_RUN}

    @property
    def wants_guard(self) -> bool:
        return self.settings.twin

    @property
    def latency(self) -> float:
        return self.settings.stream_lead + SEEN_LATE

    def calibrations(self) -> dict[str, str]:
        return {name: arm.identity.calibration for name, arm in self.arms.items()}

    def _connected(self) -> Supervisor:
        """Return the safety supervisor of the real driver's connected arms.

        Raises:
            InputError: the driver is not connected.
        """
        if self._supervisor is None:
            raise InputError(
                "the real arms are not connected",
                hint="use the cell within its block: with cell.connect('real') as live: ...",
            )
        return self._supervisor

    def dry_run(self, trajectory: JointTrajectory) -> Outcome | None:
        """Dry-run a trajectory for the real driver in the simulated twin. Return an `Outcome` with the reason
        for rejecting the trajectory, or None.
        """
        if self.guard is None:
            raise self._incapable(Capability.DRY_RUN)
        return self.guard.dry_run(trajectory, self.joint_state(), self._objects.poses, self._objects.held)

    def __exit__(self, *exc: object) -> None:
        self._supervisor = None
        for arm in self.arms.values():
            arm.close()
        self._heartbeat.stop()
        for gripper in self._grippers.values():
            gripper.close()
        self.arms.clear()
        self._grippers.clear()

    def _beat(self) -> None:
        for arm in list(self.arms.values()):
            arm.send_keep_alive()
        self._look()

    def _look(self) -> None:
        supervisor = self._supervisor
        if supervisor is not None and supervisor.check() is None:
            died = self._died()
            if died is not None:
                supervisor.trip(died)

    def _died(self) -> Fault | None:
        """Return a fault if a thread of the real driver has ended or a gripper no longer answers."""
        arm = next(iter(self.arms), "")
        if not self._heartbeat.beats:
            text = "the driver's watchdog thread has ended"
            return Fault(arm, "watchdog thread stopped", text, "start armcell again")
        for name, gripper in self._grippers.items():
            if gripper.time_since_answer > GRIPPER_SILENCE:
                text = f"gripper {name!r} has sent nothing for {gripper.time_since_answer:.1f} s"
                group = self._model.gripper(name).arm_group
                return Fault(group, GRIPPER_LOST, text, gripper.hint)
        return None

    # --- state ---
    @property
    def now(self) -> float:
        return time.monotonic() - self._began

    def joint_state(self) -> JointState:
        """Return the state of all joints of the real driver's arms at one common time.

        The common time is that of the oldest of the arms' latest states, at most `LONGEST_SKEW` before the
        newest.
        """
        self._connected()
        q, v = self._q.copy(), np.zeros(self._model.dof)
        times = [arm.time_of_state for arm in self.arms.values()]
        when = max(min(times), max(times) - LONGEST_SKEW)
        for arm in self.arms.values():
            columns = self._model.columns(arm.joint_names)
            q[columns], v[columns] = arm.state_at(when)
        for name in self._grippers.keys() & self._column.keys():
            g = self._model.gripper(name)
            q[self._column[name]] = g.joint_position(self._grippers[name].read()[0])
        return JointState(self._model.joint_names, q, v, time=self.now)

    def _due(self) -> float:
        """Return the monotonic time [s] at which the last `advance` of the real driver ends.

        If it is more than `stream_lead` in the past, it is reset to now.
        """
        now = time.monotonic()
        if now - self._advanced > self.settings.stream_lead:  # the next setpoints would be late
            self._advanced = now
        return self._advanced

    @property
    def next_command_time(self) -> float:
        """Return the time [s] on the real driver's clock at which the next command is due. Each call of
        `advance` moves this time forward by its duration.

        After a delay of more than `stream_lead`, it jumps to the current time.
        """
        return self._due() - self._began

    def advance(self, duration: float) -> None:
        self._advanced = self._due() + duration  # includes the caller's computing time
        _interrupts.sleep(max(self._advanced - time.monotonic(), 0.0))
        q = self.joint_state().positions
        for name in self._grippers:
            self._carry(name, q)

    # --- motion ---
    def command(
        self, joint_names: tuple[str, ...], positions: ArrayLike, velocities: ArrayLike
    ) -> JointState:
        """Stream a joint target to the real driver's arms that own the joints. After a stop, nothing is sent.

        The target is due `stream_lead` after `next_command_time`, on one clock for all arms.
        """
        sent = JointState(joint_names, positions, velocities, time=self.now)  # type: ignore[arg-type]
        if self.fault() is None:
            at = self._due() + self.settings.stream_lead
            for arm in self._arms_of(joint_names):
                mine = sent.reindexed(arm.joint_names)
                speed = np.zeros(len(arm.joint_names)) if mine.velocities is None else mine.velocities
                arm.servo(mine.positions, speed, at)
        return sent

    def follow(self, trajectory: JointTrajectory) -> ExecutionHandle:
        """Start a trajectory on real arms.
        A single arm receives the whole trajectory. Several arms receive streamed setpoints.

        The setpoints of several arms follow one clock.
        """
        supervisor, fault = self._connected(), self.fault()
        if fault is not None:
            raise InputError(f"no motion after a stop: {fault}", hint="see why, then call resume()")
        arms = self._arms_of(trajectory.joint_names)
        if len(arms) == 1:
            return self._guarded(supervisor, arms[0].follow(trajectory), trajectory, arms)
        streamed = StreamedExecution(arms, trajectory, self.settings.stream_lead, self.fault)
        return self._guarded(supervisor, streamed, trajectory, arms, streamed.sent_for)

    def monitor_execution(self, trajectory: JointTrajectory, forced: bool) -> CallerStreamedExecution:
        """Return the real driver's monitor that compares a streamed motion with its dry run."""
        if self.guard is None:
            raise self._incapable(Capability.DRY_RUN)
        arms = self._arms_of(trajectory.joint_names)
        moving = CallerStreamedExecution(lambda: self._due() + self.settings.stream_lead)
        supervisor = self._connected()
        moving.watched = self._guarded(supervisor, moving, trajectory, arms, moving.sent_for, forced)
        return moving

    def _guarded(
        self,
        supervisor: Supervisor,
        following: ExecutionHandle,
        trajectory: JointTrajectory,
        arms: list[RealArm],
        sent_for: SetpointHistory | None = None,
        forced: bool = False,
    ) -> ExecutionHandle:
        if self.guard is None:
            return following
        return self.guard.monitor(following, trajectory, arms, supervisor.trip, sent_for, forced)

    def _arms_of(self, joint_names: Iterable[str]) -> list[RealArm]:
        names = set(joint_names)
        arms = [a for a in self.arms.values() if names & set(a.joint_names)]
        covered = {n for a in arms for n in a.joint_names}
        if names != covered:
            odd = sorted(names ^ covered)
            raise InputError(
                f"a motion of real arms needs all joints of each, and no others: {', '.join(odd)}",
                hint=f"arms in the cell file's 'real': {', '.join(self.arms)}",
            )
        return arms

    def stop(self) -> None:
        """Stop every arm of the real driver. Each arm then holds its measured position."""
        for arm in self.arms.values():
            arm.cancel()

    def hold(self, joint_names: tuple[str, ...]) -> None:
        """Stop those arms of the real driver that own the given joints.
        Other joints, such as fingers, are ignored.
        """
        for arm in self.arms.values():
            if set(joint_names) & set(arm.joint_names):
                arm.cancel()

    def fault(self) -> Fault | None:
        """Return the fault that stopped the real driver's arms, or None if no fault is latched."""
        self._look()
        return self._supervisor.tripped if self._supervisor is not None else None

    def arm_modes(self) -> dict[str, tuple[int, int]]:
        """Return the robot and safety modes of the real driver's arms.
        An arm that has lost its connection is reported as DISCONNECTED.
        """
        return {name: arm.modes for name, arm in self.arms.items()}

    @property
    def safety_events(self) -> list[SafetyEvent]:
        """Return all stops and resumes of the real driver's arms so far, each with its time and cause."""
        return list(self._supervisor.events) if self._supervisor is not None else []

    def resume(self) -> None:
        """Resume the real driver: reconnect lost links and make every arm ready for commands.

        Raises:
            InputError: an arm cannot resume; the message states the remedy. All arms stay stopped.
        """
        with self._resuming:
            supervisor = self._connected()
            if supervisor.check() is None:
                return
            try:
                self._wait_for_grippers()
                for arm in self.arms.values():
                    arm.check_resume()
                for arm in self.arms.values():
                    arm.restart()
            except InputError as error:
                self._halt()
                raise cannot_resume(error.reason, error.hint) from None
            try:
                supervisor.clear()
            except InputError:
                self._halt()
                raise

    def _wait_for_grippers(self) -> None:
        """Wait until all grippers of the driver's real arms have reconnected.

        Raises:
            InputError: a thread of this driver has ended, or a gripper does not reconnect in time.
        """
        end = time.monotonic() + GRIPPER_SILENCE
        while (died := self._died()) is not None:
            if died.kind != GRIPPER_LOST or time.monotonic() > end:
                raise InputError(f"{died.arm}: {died.text}", hint=died.hint)
            time.sleep(0.05)  # the gripper's thread is reconnecting

    def _halt(self) -> None:
        for arm in self.arms.values():
            arm.halt()

    @property
    def speed_fraction(self) -> float:
        """Return the current speed scaling of the real driver's slowest arm, as a fraction of full speed (0
        to 1). Speed sliders and pauses reduce the fraction.
        """
        return min((arm.speed_scaling for arm in self.arms.values()), default=1.0)

    # --- gripper and objects ---
    def command_gripper(self, gripper: str, width: float, force: float) -> None:
        self._model.gripper(gripper)
        if gripper not in self._grippers:
            raise InputError(f"gripper {gripper!r} has no connection", hint=self._gripper_hint(gripper))
        if not (np.isfinite(width) and np.isfinite(force)):
            raise InputError(f"gripper target {width} m, {force} N")
        present, holds = self._grippers[gripper].read()
        if width > present + 1e-3:
            self._objects.release(gripper)
        elif not holds:
            self.zero_wrench(gripper)  # the empty gripper begins to close
        self._forces[gripper] = force
        self._grippers[gripper].drive(width, force)

    def gripper(self, gripper: str) -> GripperReading:
        g = self._model.gripper(gripper)
        if gripper not in self._grippers:
            return GripperReading(g.width_in(self.joint_state()), 0.0)
        self._carry(gripper, self.joint_state().positions)
        width, holds = self._grippers[gripper].read()
        held = self._objects.held.get(gripper)
        if not holds or held is None:
            return GripperReading(width, 0.0)
        return GripperReading(width, self._forces.get(gripper, 0.0), held)

    def wrench(self, gripper: str) -> NDArray[np.float64]:
        """Return the external wrench on a gripper of the real driver, as measured by the arm.

        The measurement is zeroed whenever the hand begins to close.

        Raises:
            InputError: the gripper is not on a real arm.
        """
        g = self._model.gripper(gripper)
        arm = self._arm_of(gripper)
        force, torque, point = arm.external_wrench()
        T = self._T_world_base[arm.name]
        R = T.rotation.matrix
        here = self._tree.link_pose(self.joint_state().positions, g.tcp_link).translation
        force, torque = R @ force, R @ torque
        return np.concatenate([force, torque + np.cross(T.apply(point) - here, force)])

    def zero_wrench(self, gripper: str) -> None:
        """Zero the wrench that the real driver measures on a gripper.
        Call this only while nothing touches it.
        """
        self._arm_of(gripper).zero_force()

    def _gripper_hint(self, gripper: str) -> str:
        group = self._model.gripper(gripper).arm_group
        if group not in self.settings.arms:
            return f"add {group!r} to 'real: arms:' of the cell file"
        return kind_of(self.settings.arms[group]).gripper_hint

    def _arm_of(self, gripper: str) -> RealArm:
        group = self._model.gripper(gripper).arm_group
        if group not in self.arms:
            raise InputError(
                f"gripper {gripper!r} is on {group!r}, which is no real arm",
                hint=f"arms in the cell file's 'real': {', '.join(self.arms)}",
            )
        return self.arms[group]

    def _carry(self, gripper: str, q: NDArray[np.float64]) -> None:
        """Update the real driver's object poses: an object that a gripper holds moves with the gripper."""
        width, holds = self._grippers[gripper].read()
        T_world_tcp = self._tree.link_pose(q, self._model.gripper(gripper).tcp_link)
        self._objects.update(gripper, T_world_tcp, width, holds)

    def object_poses(self) -> dict[str, SE3]:
        return dict(self._objects.poses)

    def correct_object_pose(self, name: str, T_world_object: SE3) -> None:
        self._objects.correct(name, T_world_object)

    def targets(self) -> JointState | None:
        self._connected()
        names = tuple(n for arm in self.arms.values() for n in arm.joint_names)
        q, v = (np.concatenate(rows) for rows in zip(*(arm.setpoint() for arm in self.arms.values())))
        return JointState(names, q, v, time=self.now)

    # A real robot detects contacts only by protective stops; the twin's simulation detects all of them.
    def expect_contact(self, body: str, others: Iterable[str], expected: bool = True) -> None:
        if self.guard is not None:
            self.guard.simulation.expect_contact(body, tuple(others), expected)

    def watch_object(self, name: str, supports: Iterable[str] = ()) -> None:
        if self.guard is not None:
            self.guard.simulation.watch_object(name, tuple(supports))

    def unwatch_object(self, name: str) -> None:
        if self.guard is not None:
            self.guard.simulation.unwatch_object(name)


drivers.register("real")(RealDriver)
