"""A cell on the bus: states out; trajectories, gripper commands and actions in.

Everything that touches the driver happens in one thread, `run`; what comes in is queued for it.
"""

from __future__ import annotations

import logging
import queue
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from armcell.cell import LiveCell
from armcell.control import Driver
from armcell.control.executor import ExecutionSettings, execute
from armcell.core import ArmcellError, ErrorCode, ExecutionResult, JointTrajectory
from armcell.model import Gripper
from armcell.ros.actions import ActionServer, Done, Goal, State
from armcell.ros.bus import Bus
from armcell.ros.convert import trajectory_from_message
from armcell.ros.nodes.cameras import CameraPublisher
from armcell.ros.nodes.states import RATE, StatePublisher

logger = logging.getLogger(__name__)
TRAJECTORY = "/planned_trajectory"
GRIPPER = "/gripper_command"
STATUS = "/trajectory_status"
ACTION = "control_msgs/FollowJointTrajectory"
MAX_JOBS = 16

# control_msgs/FollowJointTrajectoryResult
SUCCESSFUL, INVALID_GOAL, INVALID_JOINTS, PATH_TOLERANCE_VIOLATED, GOAL_TOLERANCE_VIOLATED = 0, -1, -2, -4, -5


@dataclass
class _Job:
    """Something for the driver's thread: `run` plays it; `stop` is set when it shall end early."""

    run: Callable[[threading.Event], None]
    stop: threading.Event = field(default_factory=threading.Event)


class CellNode:
    """Serves a live cell on a bus while `run` runs.

    Topics in: /planned_trajectory (trajectory_msgs/JointTrajectory; a newer one takes over, an empty one
    stops), /gripper_command (std_msgs/Float64: 0 or more is a width [m], 0 grasps; below 0 closes with that
    force [N per finger]); with several grippers /<gripper>/gripper_command. Actions: /<group>_controller/
    follow_joint_trajectory for each arm. Topics out beside the states: /trajectory_status (std_msgs/String)
    and those of the cell's cameras (`CameraPublisher`).

    Args:
        live: connected by `run`; paced by its own time scale.
        rate: [Hz] of the states, in the cell's time.
    """

    def __init__(self, live: LiveCell, bus: Bus, rate: float = RATE):
        self.live, self.bus = live, bus
        self._states = StatePublisher(bus, live.scene_at_start, rate)
        self._cameras = CameraPublisher(bus, live.cameras)
        self._driver: Any = _Publishing(live.driver, self._states, self._cameras)
        self._jobs: queue.Queue[_Job] = queue.Queue(MAX_JOBS)
        self._motion: _Job | None = None  # the newest one, waiting or at work
        self._stop = threading.Event()
        self.ready = threading.Event()
        """Set once the cell is connected and publishes."""
        self.executed = 0
        self._status = bus.advertise(STATUS, "std_msgs/String", latch=True)
        self._subs = [bus.subscribe(TRAJECTORY, "trajectory_msgs/JointTrajectory", self._on_trajectory)]
        grippers = list(live.model.grippers.values())
        for gripper in grippers:
            topic = GRIPPER if len(grippers) == 1 else f"/{gripper.name}{GRIPPER}"
            self._subs.append(bus.subscribe(topic, "std_msgs/Float64", self._gripper_callback(gripper)))
        self._actions = [
            ActionServer(bus, f"/{group}_controller/follow_joint_trajectory", ACTION, self._follow)
            for group in live.arms
        ]

    # --- the driver's thread ---
    def run(self) -> None:
        """Step the cell and do what comes in, until `close`; then leave the bus."""
        try:
            with self.live:
                self._states.publish(self.live.driver)
                self.ready.set()
                while not self._stop.is_set():
                    self._turn()
        finally:
            for member in (*self._actions, *self._subs, self._status, self._states, self._cameras):
                member.close()

    def _turn(self) -> None:
        try:
            job = self._jobs.get_nowait()
        except queue.Empty:
            self._driver.advance(self.live.driver.period)
        else:
            job.run(job.stop)

    def start(self) -> threading.Thread:
        """Run in a thread of its own."""
        thread = threading.Thread(target=self.run, name=f"cell {self.live.name}", daemon=True)
        thread.start()
        return thread

    def close(self) -> None:
        """End `run` soon; a running motion is stopped."""
        self._stop.set()
        if motion := self._motion:
            motion.stop.set()

    def _put(self, job: _Job) -> bool:
        """Queue a motion; it takes over from the one before."""
        if motion := self._motion:
            motion.stop.set()
        self._motion = job
        try:
            self._jobs.put_nowait(job)
        except queue.Full:
            self._say(f"refused: {MAX_JOBS} commands wait already")
            return False
        return True

    def _play(self, message: Any, stop: threading.Event) -> tuple[ExecutionResult, str]:
        """Check and play a trajectory message, telling /trajectory_status about it."""
        try:
            trajectory = trajectory_from_message(message, self.live.model, self.live.driver.joint_state())
        except ArmcellError as error:
            self._say(f"refused: {error}")
            return ExecutionResult(ErrorCode.INVALID_MOTION_PLAN, str(error)), "refused"
        count = len(trajectory.times)
        self._say(f"executing {count} points, {trajectory.duration:.2f} s" if count else "stop")
        result = self._execute(trajectory, stop)
        self.executed += 1
        what = "done" if result.ok else "stopped" if result.code is ErrorCode.PREEMPTED else "failed"
        text = result.message or f"final error {result.final_error:.4f}"
        self._say(f"{what}: {text}")
        return result, what

    def _execute(self, trajectory: JointTrajectory, stop: threading.Event) -> ExecutionResult:
        driver: Driver = self._driver
        return execute(driver, trajectory, ExecutionSettings(), stop)

    # --- what comes in, from the subscriptions' threads ---
    def _on_trajectory(self, message: Any) -> None:
        def run(stop: threading.Event) -> None:
            self._play(message, stop)

        self._put(_Job(run))

    def _gripper_callback(self, gripper: Gripper) -> Callable[[Any], None]:
        def command(message: Any) -> None:
            value = message.data
            if not abs(value) < float("inf"):
                self._say(f"refused: gripper command {value}")
                return
            width = min(max(value, 0.0), gripper.max_width)
            force = gripper.max_force if value >= 0 else min(-value, gripper.max_force)
            self._driver.later(lambda: self.live.driver.command_gripper(gripper.name, width, force))

        return command

    def _follow(self, goal: Goal) -> Done:
        """control_msgs/FollowJointTrajectory, from the action's thread."""
        finished, results = threading.Event(), []

        def run(stop: threading.Event) -> None:
            results.append(self._play(goal.message.trajectory, stop))
            finished.set()

        job = _Job(run)
        Result = self.bus.schema.message(f"{ACTION}Result")
        if not self._put(job):
            return Done(State.REJECTED, Result(error_code=INVALID_GOAL), "too many commands wait")  # type: ignore[call-arg]
        while not finished.wait(0.02):
            if goal.cancel.is_set():
                job.stop.set()
            if self._stop.is_set():
                return Done(State.ABORTED, Result(), "the cell was closed")
        result, what = results[0]
        code = _follow_code(result)
        message = Result(error_code=code, error_string=result.message)  # type: ignore[call-arg]
        states = {"done": State.SUCCEEDED, "stopped": State.PREEMPTED, "refused": State.REJECTED}
        return Done(states.get(what, State.ABORTED), message, result.message)

    def _say(self, text: str) -> None:
        logger.info("trajectory: %s", text)
        self._status.publish(self.bus.schema.new("std_msgs/String", text))


def _follow_code(result: ExecutionResult) -> int:
    if result.ok or result.code is ErrorCode.PREEMPTED:
        return SUCCESSFUL
    if result.code is ErrorCode.INVALID_MOTION_PLAN:
        return INVALID_JOINTS if "unknown joint" in result.message else INVALID_GOAL
    return PATH_TOLERANCE_VIOLATED if "left the path" in result.message else GOAL_TOLERANCE_VIOLATED


class _Publishing:
    """A driver that publishes its states whenever time passes, and runs small commands in between."""

    def __init__(self, driver: Driver, states: StatePublisher, cameras: CameraPublisher):
        self._driver, self._states, self._cameras = driver, states, cameras
        self._later: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._driver, name)

    def later(self, command: Callable[[], None]) -> None:
        """Do something to the driver before the next step, from the driver's thread."""
        self._later.put(command)

    def advance(self, duration: float) -> None:
        while not self._later.empty():
            self._later.get()()
        self._driver.advance(duration)
        if self._states.due(self._driver.now):
            self._states.publish(self._driver)
            self._cameras.publish(self._states.tf)
