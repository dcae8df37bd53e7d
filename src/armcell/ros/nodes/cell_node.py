"""A cell on the bus: states out; trajectories, gripper commands and actions in.

Everything that touches the driver happens in one thread, `run`, through the conductor.
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
from armcell.control import CHANGED, NOT_STARTED, ExecutionSettings, GuardedMotion, playing
from armcell.core import ArmcellError, ErrorCode, ExecutionResult, InputError, JointTrajectory
from armcell.model import Gripper
from armcell.ros.actions import ActionServer, Done, Goal, State
from armcell.ros.bus import Bus
from armcell.ros.convert import trajectory_from_message
from armcell.ros.nodes.cameras import CameraPublisher
from armcell.ros.nodes.conductor import Conductor, Steps, Work
from armcell.ros.nodes.gripping import LOOK_PERIOD, GripperNode, finger_goals
from armcell.ros.nodes.states import RATE, StatePublisher
from armcell.scene import PlanningScene

logger = logging.getLogger(__name__)
TRAJECTORY = "/planned_trajectory"
STATUS = "/trajectory_status"
ACTION = "control_msgs/FollowJointTrajectory"
SHIFT = 0.15  # [s] that clients' motions may be late or early against each other

# control_msgs/FollowJointTrajectoryResult
SUCCESSFUL, INVALID_GOAL, INVALID_JOINTS, PATH_TOLERANCE_VIOLATED, GOAL_TOLERANCE_VIOLATED = 0, -1, -2, -4, -5


class CellNode:
    """Serves a live cell on a bus while `run` runs.

    Topics in: /planned_trajectory (trajectory_msgs/JointTrajectory; a newer one of the same joints takes
    over, an empty one stops), /gripper_command (std_msgs/Float64: 0 or more is a width [m], 0 grasps; below
    0 closes with that force [N per finger]); with several grippers /<gripper>/gripper_command. Actions:
    /<group>_controller/follow_joint_trajectory for each arm and gripper, /<gripper>_controller/gripper_cmd
    for each gripper. Topics out beside the states: /trajectory_status (std_msgs/String) and those of the
    cell's cameras (`CameraPublisher`).

    Motions of different arms run at the same time where they are proven not to meet; else one waits.

    Args:
        live: connected by `run`; paced by its own time scale.
        rate: [Hz] of the states, in the cell's time.
        auto_grip: close a gripper that rests with an object between its open fingers.
    """

    def __init__(self, live: LiveCell, bus: Bus, rate: float = RATE, auto_grip: bool = False):
        self.live, self.bus = live, bus
        self._states = StatePublisher(bus, live.scene_at_start, rate)
        self.cameras = CameraPublisher(bus, live.cameras)
        self.conductor = Conductor(live.driver, self._after_step)
        live.ctx.driver = self.conductor  # type: ignore[assignment]  # tasks move beside the others
        live.ctx.gate.shift = SHIFT
        self._stop, self._putting = threading.Event(), threading.Lock()
        self.look_at_hands: Callable[[], None] = lambda: None
        """Notes what the hands hold; in the driver's thread, often and before every motion."""
        self._next_look = 0.0  # [s]
        self.ready = threading.Event()
        """Set once the cell is connected and publishes."""
        self.executed = 0
        self._status = bus.advertise(STATUS, "std_msgs/String", latch=True)
        self._subs = [bus.subscribe(TRAJECTORY, "trajectory_msgs/JointTrajectory", self._on_trajectory)]
        self.grippers = GripperNode(live, bus, self.conductor, self.say, auto_grip)
        self._actions = [
            ActionServer(bus, f"/{group}_controller/follow_joint_trajectory", ACTION, self._follow)
            for group in (*live.arms, *live.model.grippers)
        ]

    # --- the driver's thread ---
    def run(self) -> None:
        """Step the cell and do what comes in, until `close`; then leave the bus."""
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
        """Run in a thread of its own."""
        thread = threading.Thread(target=self.run, name=f"cell {self.live.name}", daemon=True)
        thread.start()
        return thread

    def close(self) -> None:
        """End `run` soon; running motions are stopped."""
        self._stop.set()
        self.conductor.stop()

    # --- playing, from any thread ---
    def play(
        self,
        message: Any,
        settings: ExecutionSettings = ExecutionSettings(),
        planned_in: PlanningScene | None = None,
    ) -> Work:
        """Begin a trajectory_msgs/JointTrajectory, when what moves the same joints has made way for it.

        /trajectory_status tells of it. One without points stops its joints, or all where it names none. The
        motion gate proves it when it starts, with the contacts that `planned_in` allows.

        Raises:
            InputError: what is wrong with the message.
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

        def steps(driver: Any, cancel: threading.Event) -> Steps:
            # Where it is now decides, not where it was when the message came.
            now = trajectory_from_message(message, model, driver.joint_state())
            work.trajectory = now
            return (yield from playing(driver, _Announced(self, now, planned_in, cancel), settings))

        work = Work("trajectory", trajectory.joint_names, steps, trajectory=trajectory).then(self._ended)
        return self._put_beside(work, trajectory)

    def _halt(self, trajectory: JointTrajectory) -> Work:
        joints = trajectory.joint_names or self.live.model.joint_names

        def steps(driver: Any, cancel: threading.Event) -> Any:
            self.say("stop")
            nothing = replace(trajectory, joint_names=joints, positions=np.zeros((0, len(joints))))
            return playing(driver, self.live.ctx.gate.motion(nothing))

        return self.conductor.put(Work("stop", joints, steps).then(self._ended))

    def _close_or_open(self, trajectory: JointTrajectory, goals: list[tuple[Gripper, float]]) -> Work:
        """Drive fingers to their widths [m]; fingers that an object stops hold it, which is no failure."""

        def steps(driver: Any, cancel: threading.Event) -> Any:
            self.say(f"executing {len(trajectory.times)} points, {trajectory.duration:.2f} s")
            result = ExecutionResult(ErrorCode.SUCCESS)
            for gripper, width in goals:
                result = yield from self.grippers.closing(driver, gripper, width, gripper.max_force, cancel)
            return result

        return self.conductor.put(Work("fingers", trajectory.joint_names, steps).then(self._ended))

    def _put_beside(self, work: Work, trajectory: JointTrajectory) -> Work:
        """Begin a motion; where other arms under way are what it would touch, once they have arrived.

        Raises:
            InputError: the cell is closed, or too many motions wait.
        """
        while not self._stop.is_set():
            others = self._others(work)
            if (late := self._not_begun(work, others)) is not None:
                late.wait(self.live.driver.period)  # when it begins is part of the proof
                continue
            if contact := self._in_passing(others, trajectory):
                self.say(f"waits until the other arm has arrived: {contact}")
                while not self._stop.is_set() and not all(w.wait(0.05) for w in others):
                    pass
                continue
            with self._putting:  # what somebody has put since then is not proven
                if set(self._others(work)) <= set(others):
                    return self.conductor.put(work)
        raise InputError("the cell is closed")

    def _others(self, work: Work) -> list[Work]:
        """Motions of other joints."""
        works = self.conductor.works()
        return [w for w in works if w.trajectory is not None and not w.joints & work.joints]

    def _not_begun(self, work: Work, others: list[Work]) -> Work | None:
        """A motion of other joints that waits for its turn, or what keeps this one waiting."""
        before = [w for w in self.conductor.works(work.joints) if not w.gives_way]
        late = [w for w in others if w.began is None]
        return next((w for w in (*before, *late) if not w.is_over), None)

    def _in_passing(self, others: list[Work], new: JointTrajectory) -> str:
        """What a motion would touch beside others, but not once they have arrived; empty where nothing."""
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
            return ""  # it is refused at once
        return "the motions meet" if now.contact is None else now.contact.describe()

    def _ended(self, work: Work) -> None:
        self.executed += 1
        if not self._stop.is_set():
            self.grippers.moved(work.joints)
        if work.error is not None:
            self.say(f"refused: {work.error}")
            return
        result = work.outcome()
        what = "done" if result.ok else "stopped" if result.code is ErrorCode.PREEMPTED else "failed"
        if result.evidence.get(NOT_STARTED):
            what = "refused"
        self.say(f"{what}: {result.message or f'final error {result.final_error:.4f}'}")

    def say(self, text: str) -> None:
        """Tell /trajectory_status."""
        logger.info("trajectory: %s", text)
        if not self._status.closed:
            self._status.publish(self.bus.schema.new("std_msgs/String", text))

    # --- what comes in, from the subscriptions' threads ---
    def _on_trajectory(self, message: Any) -> None:
        try:
            self.play(message)
        except InputError as error:
            logger.info("trajectory refused: %s", error)

    def _follow(self, goal: Goal) -> Done:
        """control_msgs/FollowJointTrajectory, from the action's thread."""
        Result = self.bus.schema.message(f"{ACTION}Result")
        try:
            work = self.play(goal.message.trajectory, _tolerances(goal.message))
        except InputError as error:
            code = INVALID_JOINTS if "unknown joint" in str(error) else INVALID_GOAL
            return Done(State.REJECTED, Result(error_code=code, error_string=str(error)), str(error))
        feedback = _Feedback(self, goal)
        while not work.wait(0.02):
            if goal.cancel.is_set():
                work.cancel.set()
            feedback.give(work)
        if self._stop.is_set():
            return Done(State.ABORTED, Result(), "the cell was closed")
        if work.error is not None:
            text = str(work.error)
            return Done(State.REJECTED, Result(error_code=INVALID_GOAL, error_string=text), text)
        result = work.outcome()
        message = Result(error_code=_follow_code(result), error_string=result.message)
        if result.ok:
            return Done(State.SUCCEEDED, message, result.message)
        preempted = result.code is ErrorCode.PREEMPTED
        return Done(State.PREEMPTED if preempted else State.ABORTED, message, result.message)


class _Announced(GuardedMotion):
    """A motion of which /trajectory_status tells when it has been proven and starts."""

    def __init__(
        self, node: CellNode, trajectory: JointTrajectory, planned_in: PlanningScene | None,
        cancel: threading.Event,
    ):  # fmt: skip
        super().__init__(node.live.ctx.gate, trajectory, planned_in, cancel)
        self._node = node

    def begin(self, fade: JointTrajectory | None = None) -> ExecutionResult | None:
        self._node.look_at_hands()
        refused = super().begin(fade)
        if refused is None:
            self._node.say(f"executing {len(self.trajectory.times)} points, {self.trajectory.duration:.2f} s")
            self._node.live.ctx.announce(self.trajectory)
        return refused


class _Feedback:
    """Where the motion should be and where it is, ten times a second."""

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
            return  # closed
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
    """The goal's tolerances, the smallest joint's for all; ours where it gives none."""
    values: dict[str, float] = {}
    for key, entries in (("path_tolerance", goal.path_tolerance), ("goal_tolerance", goal.goal_tolerance)):
        given = [float(t.position) for t in entries if t.position > 0]
        if given:
            values[key] = min(given)
    if (seconds := goal.goal_time_tolerance.to_sec()) > 0:
        values["settle_time"] = seconds
    return ExecutionSettings(**values)


def _follow_code(result: ExecutionResult) -> int:
    if result.ok or result.code is ErrorCode.PREEMPTED:
        return SUCCESSFUL
    left = "left the path" in result.message or result.code is CHANGED
    return PATH_TOLERANCE_VIOLATED if left else GOAL_TOLERANCE_VIOLATED
