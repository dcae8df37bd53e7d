"""A node that serves a live cell: it publishes states and executes trajectories.

Grippers have their own node (`GripperNode`). Only one thread, `run`, uses the driver; other threads access it
through the conductor.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from armcell.cell import LiveCell
from armcell.collision.motion_proof import Moving, first_conflict
from armcell.core import ArmcellError, ErrorCode, ExecutionResult, InputError, JointTrajectory
from armcell.execution import (
    NOT_STARTED,
    SCENE_INVALIDATED,
    ExecutionSettings,
    ExecutionSteps,
    GuardedMotion,
    execution_steps,
)
from armcell.model import Gripper
from armcell.ros.actions import ActionServer, Done, Goal, State
from armcell.ros.bus import Bus
from armcell.ros.convert import trajectory_from_message
from armcell.ros.nodes.cameras import CameraPublisher
from armcell.ros.nodes.conductor import STOPPED, Conductor, Work
from armcell.ros.nodes.gripping import LOOK_PERIOD, GripperNode, finger_goals
from armcell.ros.nodes.states import RATE, StatePublisher, check_rate
from armcell.scene import PlanningScene

logger = logging.getLogger(__name__)
TRAJECTORY = "/planned_trajectory"
STATUS = "/trajectory_status"
ACTION = "control_msgs/FollowJointTrajectory"
SHIFT = 0.15  # [s] timing tolerance between motions that clients start independently

# control_msgs/FollowJointTrajectoryResult
SUCCESSFUL, INVALID_GOAL, INVALID_JOINTS, PATH_TOLERANCE_VIOLATED, GOAL_TOLERANCE_VIOLATED = 0, -1, -2, -4, -5


class CellNode:
    """Node that serves a live cell on the bus while `run` executes.

    Input topics:

    - /planned_trajectory (trajectory_msgs/JointTrajectory): a newer trajectory of the same joints replaces
      the current one; an empty trajectory stops.
    - /gripper_command (std_msgs/Float64): a value of 0 or more is a width [m], where 0 grasps; a negative
      value closes with this force [N per finger]. With several grippers: /<gripper>/gripper_command.

    Actions: /<group>_controller/follow_joint_trajectory for each arm and gripper, and
    /<gripper>_controller/gripper_cmd for each gripper. Output topics besides the states: /trajectory_status
    (std_msgs/String) and the camera topics (`CameraPublisher`).

    Motions of different arms run at the same time if they are proven collision-free; otherwise one of them
    waits.

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
        self.live, self.bus = live, bus
        self._states = StatePublisher(bus, live.scene_at_start, rate)
        self.cameras = CameraPublisher(bus, live.cameras)
        self.conductor = Conductor(live.driver, self._after_step)
        live.ctx.driver = self.conductor  # tasks share the driver with clients
        live.ctx.gate.shift = SHIFT
        self._stop, self._putting = threading.Event(), threading.Lock()
        self.look_at_hands: Callable[[], None] = lambda: None
        """Updates which objects the grippers hold; runs in the driver's thread, also before each motion."""
        self._next_look = 0.0  # [s]
        self.ready = threading.Event()
        """Set as soon as the cell is connected and publishes states."""
        self.executed = 0
        self._status = bus.advertise(STATUS, "std_msgs/String", latch=True)
        self._subs = [bus.subscribe(TRAJECTORY, "trajectory_msgs/JointTrajectory", self._on_trajectory)]
        self.grippers = GripperNode(live, bus, self.conductor, self.say, auto_grip)
        model = live.model
        self.controllers = {f"{name}_controller": model.group(name).joint_names for name in live.arms} | {
            f"{g.name}_controller": (g.joint_name,) for g in model.grippers.values()
        }
        """Joint names of each controller that the cell serves, by controller name."""
        self._actions = [
            ActionServer(bus, f"/{name}/follow_joint_trajectory", ACTION, self._follow, accepts=False)
            for name in self.controllers
        ]

    # --- the driver's thread ---
    def run(self) -> None:
        """Step a cell node's cell and execute clients' commands until `close`; then remove the node."""
        try:
            with self.live:
                self._states.publish(self.live.driver)
                self.ready.set()
                while not self._stop.is_set():
                    self.conductor.turn()
                self.conductor.settle()
        finally:
            self.conductor.close()
            for member in (
                *self._actions,
                *self._subs,
                self.grippers,
                self._status,
                self._states,
                self.cameras,
            ):
                member.close()

    def _after_step(self) -> None:
        if self._states.due(self.live.driver.now):
            self._states.publish(self.live.driver)
            self.cameras.publish(self._states.tf)
        self.grippers.look()
        if self.live.driver.now >= self._next_look:
            self._next_look = self.live.driver.now + LOOK_PERIOD
            self.look_at_hands()
        self.live.ctx.observe()

    def start(self) -> threading.Thread:
        """Start the node in a new thread and return the thread."""
        thread = threading.Thread(target=self.run, name=f"cell {self.live.name}", daemon=True)
        thread.start()
        return thread

    def close(self) -> None:
        """Stop the node: stop the running motions and request the end of `run`."""
        self._stop.set()
        self.conductor.stop()

    # --- trajectories, callable from any thread ---
    def play(
        self,
        message: Any,
        settings: ExecutionSettings = ExecutionSettings(),
        planned_in: PlanningScene | None = None,
    ) -> Work:
        """Start a trajectory_msgs/JointTrajectory once earlier motions of its joints have ended.

        /trajectory_status reports the progress. A trajectory without points stops its joints, or all joints
        if it names none. The motion gate certifies the motion when it starts, with the contacts that
        `planned_in` allows.

        Args:
            message: the JointTrajectory message.
            settings: tolerances and limits of the execution.
            planned_in: the scene in which the motion was planned; default: the current scene.
        Returns:
            A handle to the motion.
        Raises:
            InputError: the message is invalid; the error states the cause.
        """
        model = self.live.model
        state = self.conductor.call(self.live.driver.joint_state)
        try:
            trajectory = trajectory_from_message(message, model, state)
        except ArmcellError as error:
            self.say(f"refused: {error}")
            raise
        if not len(trajectory.times):
            return self._halt(trajectory)
        if goals := finger_goals(model, trajectory):
            return self._close_or_open(trajectory, goals)

        def steps(driver: Any, cancel: threading.Event) -> ExecutionSteps:
            # The robot may have moved since the message arrived: start from its current state.
            now = trajectory_from_message(message, model, driver.joint_state())
            work.trajectory = now
            return (yield from execution_steps(driver, _Announced(self, now, planned_in, cancel), settings))

        work = Work("trajectory", trajectory.joint_names, steps, trajectory=trajectory).then(self._ended)
        return self._put_beside(work, trajectory)

    def _halt(self, trajectory: JointTrajectory) -> Work:
        joints = trajectory.joint_names or self.live.model.joint_names

        def steps(driver: Any, cancel: threading.Event) -> Any:
            self.say("stop")
            nothing = replace(trajectory, joint_names=joints, positions=np.zeros((0, len(joints))))
            return execution_steps(driver, self.live.ctx.gate.motion(nothing))

        return self.conductor.put(Work("stop", joints, steps).then(self._ended))

    def _close_or_open(self, trajectory: JointTrajectory, goals: list[tuple[Gripper, float]]) -> Work:
        """Move fingers to their target widths [m]; fingers that an object stops count as success."""

        def steps(driver: Any, cancel: threading.Event) -> Any:
            self.say(f"executing {len(trajectory.times)} points, {trajectory.duration:.2f} s")
            result = ExecutionResult(ErrorCode.SUCCESS)
            for gripper, width in goals:
                result = yield from self.grippers.closing(driver, gripper, width, gripper.max_force, cancel)
            return result

        return self.conductor.put(Work("fingers", trajectory.joint_names, steps).then(self._ended))

    def _put_beside(self, work: Work, trajectory: JointTrajectory) -> Work:
        """Queue a motion; wait for other arms to arrive if their motions conflict with it.

        Raises:
            InputError: the cell is closed, or too many motions wait.
        """
        while not self._stop.is_set():
            others = self._others(work)
            if (late := self._not_begun(work, others)) is not None:
                late.wait(self.live.driver.period)  # the proof needs the start time of the other motion
                continue
            if contact := self._in_passing(others, trajectory):
                self.say(f"waits until the other arm has arrived: {contact}")
                while not self._stop.is_set() and not all(w.wait(0.05) for w in others):
                    pass
                continue
            with self._putting:  # a motion that another thread has queued since then is not in the proof
                if set(self._others(work)) <= set(others):
                    return self.conductor.put(work)
        raise InputError("the cell is closed")

    def _others(self, work: Work) -> list[Work]:
        """Return the queued and running motions that share no joint with the motion `work`."""
        works = self.conductor.works()
        return [w for w in works if w.trajectory is not None and not w.joints & work.joints]

    def _not_begun(self, work: Work, others: list[Work]) -> Work | None:
        """Return a motion that must start or end before `work` can be checked, or None."""
        before = [w for w in self.conductor.works(work.joints) if not w.gives_way]
        late = [w for w in others if w.began is None]
        return next((w for w in (*before, *late) if not w.is_over), None)

    def _in_passing(self, others: list[Work], new: JointTrajectory) -> str:
        """Describe a motion's conflict with running motions if the conflict ends with them.

        Returns an empty string if there is no such conflict.
        """
        running = [w.trajectory for w in others if w.trajectory is not None and not w.is_over]
        if not running:
            return ""
        scene, gate, motion = self.conductor.call(self.live.scene), self.live.ctx.gate, Moving(new)
        now = gate.conflict(motion, scene)
        if now is None:
            return ""
        for trajectory in running:
            scene = scene.with_state(trajectory.end)
        if first_conflict(scene, motion) is not None:
            return ""  # waiting does not help: the motion gate rejects this motion
        return "the motions meet" if now.contact is None else now.contact.describe()

    def _ended(self, work: Work) -> None:
        self.executed += 1
        if not self._stop.is_set():
            self.grippers.moved(work.joints)
        if work.error is not None:
            self.say(f"refused: {work.error}")
            return
        result = STOPPED if work.result is None else work.result  # same texts as Unity's player
        what = "done" if result.ok else "stopped" if result.code is ErrorCode.PREEMPTED else "failed"
        if result.evidence.get(NOT_STARTED):
            what = "refused"
        self.say(f"{what}: {result.message or f'final error {result.final_error:.4f}'}")

    def say(self, text: str) -> None:
        """Publish a text on /trajectory_status."""
        logger.info("trajectory: %s", text)
        if not self._status.closed:
            self._status.publish(self.bus.schema.new("std_msgs/String", text))

    # --- callbacks, in the threads of subscriptions and actions ---
    def _on_trajectory(self, message: Any) -> None:
        try:
            self.play(message)
        except InputError as error:
            logger.info("trajectory refused: %s", error)

    def _follow(self, goal: Goal) -> Done:
        """Execute a control_msgs/FollowJointTrajectory goal with a cell node, in the action's thread.

        The goal is accepted when the motion starts.
        """
        Result = self.bus.schema.message(f"{ACTION}Result")
        try:
            if len(goal.message.multi_dof_trajectory.points):
                raise InputError("multi-DOF trajectories are not executed", hint="send joint positions")
            work = self.play(goal.message.trajectory, _tolerances(goal.message))
        except InputError as error:
            code = INVALID_JOINTS if "unknown joint" in str(error) else INVALID_GOAL
            return Done(State.REJECTED, Result(error_code=code, error_string=str(error)), str(error))
        feedback = _Feedback(self, goal)
        while not work.wait(0.02):
            if goal.cancel.is_set():
                work.cancel.set()
            if work.moving:
                goal.accept()
                feedback.give(work)
        if self._stop.is_set():
            return Done(State.ABORTED, Result(), "the cell was closed")
        if work.error is not None:
            text = str(work.error)
            return Done(State.REJECTED, Result(error_code=INVALID_GOAL, error_string=text), text)
        result = work.outcome()
        preempted = result.code is ErrorCode.PREEMPTED
        if not (result.ok or preempted or work.moving):  # rejected before it started
            message = Result(error_code=INVALID_GOAL, error_string=result.message)
            return Done(State.REJECTED, message, result.message)
        message = Result(error_code=_follow_code(result), error_string=result.message)
        if result.ok:
            return Done(State.SUCCEEDED, message, result.message)
        return Done(State.PREEMPTED if preempted else State.ABORTED, message, result.message)


class _Announced(GuardedMotion):
    """A guarded motion that reports its start on /trajectory_status after certification."""

    def __init__(
        self, node: CellNode, trajectory: JointTrajectory, planned_in: PlanningScene | None,
        cancel: threading.Event,
    ):  # fmt: skip
        super().__init__(node.live.ctx.gate, trajectory, planned_in, cancel)
        self._node = node

    def begin(self, blend: JointTrajectory | None = None) -> ExecutionResult | None:
        self._node.look_at_hands()
        refused = super().begin(blend)
        if refused is None:
            self._node.say(f"executing {len(self.trajectory.times)} points, {self.trajectory.duration:.2f} s")
            self._node.live.ctx.announce(self.trajectory)
        return refused


class _Feedback:
    """Cell node's FollowJointTrajectory feedback: desired and actual joint state, ten times a second."""

    PERIOD = 0.1  # [s]

    def __init__(self, node: CellNode, goal: Goal):
        self._node, self._goal, self._next = node, goal, 0.0

    def give(self, work: Work) -> None:
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
    """Return the tolerances of a cell node's FollowJointTrajectory goal as execution settings.

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
