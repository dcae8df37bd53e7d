"""Motions, held objects and planning scene of a live cell that clients share.

Only one thread, `run`, uses the driver; other threads access it through the conductor.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

from armcell.cell import LiveCell
from armcell.collision.motion_proof import ActiveMotion, first_conflict
from armcell.core import ArmcellError, ErrorCode, ExecutionResult, InputError, JointTrajectory
from armcell.drivers import Driver
from armcell.execution import (
    NOT_STARTED,
    ExecutionSettings,
    ExecutionSteps,
    GuardedMotion,
    execution_steps,
)
from armcell.model import Gripper, RobotModel
from armcell.ros.convert import trajectory_from_message
from armcell.ros.nodes.external_controllers import select_controllers
from armcell.ros.nodes.gripper_node import LOOK_PERIOD, GripperMotions, finger_goals
from armcell.ros.nodes.motion_queue import STOPPED, MotionHandle, MotionQueue
from armcell.scene import PlanningScene
from armcell.tasks.context import HeldObject

logger = logging.getLogger(__name__)
SHIFT = 0.15  # [s] timing tolerance between motions that clients start independently
LET_GO = 0.004  # [m] fingers that opened by more since the grasp have released the object
FALLEN = 0.03  # [m] an object that slipped by more from its grasp has fallen


class CellMotions:
    """Interface through which ROS clients in any thread request motions of a live cell and edit its scene,
    while `run` executes the motions.

    An object between closed fingers is attached to the hand automatically, no matter which client closed
    them, and returns to the world when the fingers open. Clients need not attach or detach grasped objects in
    the planning scene.

    Motions of different arms run at the same time if they are proven collision-free; otherwise one of them
    waits.

    Args:
        live: the cell; `run` connects it, and its time scale sets the pace.
        controllers: joint names of each controller that clients may select, by controller name.
    """

    def __init__(self, live: LiveCell, controllers: Mapping[str, tuple[str, ...]]):
        self.live, self.controllers = live, controllers
        self.conductor = MotionQueue(live.driver, self._after_step)
        live.ctx.driver = self.conductor  # tasks share the driver with clients
        live.ctx.gate.shift = SHIFT
        self.grippers = GripperMotions(live, self.conductor)
        self.ready = threading.Event()
        """Set as soon as the cell is connected."""
        self.executed = 0
        self._stop, self._putting = threading.Event(), threading.Lock()
        self._next_look = 0.0  # [s]
        self._widths: dict[str, float] = {}  # finger width at the grasp [m], by object

    @property
    def model(self) -> RobotModel:
        return self.live.model

    # --- the driver's thread ---
    def run(self) -> None:
        """Execute the motions of the cell that clients request, step by step until `close`."""
        try:
            with self.live:
                self._connected()
                self.ready.set()
                while not self._stop.is_set():
                    self.conductor.step()
                self.conductor.stop_and_drain()
        finally:
            self.conductor.close()

    def _connected(self) -> None:
        """Prepare a newly connected cell for the motions of clients, before the cell's first step."""

    def _after_step(self) -> None:
        if self.live.driver.now >= self._next_look:
            self._next_look = self.live.driver.now + LOOK_PERIOD
            self.update_held_objects()
        self.live.ctx.observe()

    def start(self) -> threading.Thread:
        """Start the thread that executes the motions of the cell for its clients, and return the thread."""
        thread = threading.Thread(target=self.run, name=f"cell {self.live.name}", daemon=True)
        thread.start()
        return thread

    def close(self) -> None:
        """Stop the clients' motions of the cell and request that `run` ends."""
        self._stop.set()
        self.conductor.stop()

    def say(self, text: str) -> None:
        """Report the progress of a motion of the cell to the clients."""
        logger.info("trajectory: %s", text)

    # --- scene and held objects ---
    def scene(self) -> PlanningScene:
        """Return the measured scene in which the motions of the cell are checked, including added and held
        objects.
        """
        return self.conductor.call(self.measure_scene)

    def measure_scene(self) -> PlanningScene:
        """Return the current measured scene in which the motions of the cell are checked, including held
        objects. Only the thread of the driver may call this method.
        """
        self.update_held_objects()
        return self.live.ctx.scene()

    def update_held_objects(self) -> None:
        """Update which objects the grippers hold during the motions of the cell. Only the thread of the
        driver may call this method.
        """
        ctx = self.live.ctx
        world = ctx.base
        for gripper in self.model.grippers.values():
            reading = ctx.driver.gripper(gripper.name)
            mine = [h for h in ctx.holding.values() if h.gripper.name == gripper.name]
            for held in mine:
                opened = reading.width > self._widths.get(held.object, reading.width) + LET_GO
                if reading.held == held.object:
                    continue
                if opened:
                    del ctx.holding[held.object]
                elif ctx.slip_of(held) > FALLEN:
                    ctx.lose(held.object, f"{held.object} fell out of {gripper.name}")
            if reading.held is None or reading.held in ctx.holding or reading.held not in world.objects:
                continue
            T = ctx.T_tcp_object(reading.held, gripper)
            ctx.record_grasp(HeldObject(reading.held, gripper, T))
            self._widths[reading.held] = reading.width

    def edit_scene(self, make: Callable[[PlanningScene], PlanningScene]) -> PlanningScene:
        """Replace the scene of the cell by `make(scene)`, an edit that a client requests, and return the new
        scene. Later motions of the cell are checked in the new scene.

        Raises:
            InputError: `make` raised it; the world is unchanged.
        """
        self.scene()  # update the held objects from the grippers first
        self.live.ctx.change_scene(make)  # in this thread, because a large mesh takes time
        return self.scene()

    def held_object(self, gripper: Gripper) -> str | None:
        """Return the object that a gripper of the cell holds, or None. Motions of the cell that clients
        request carry this object along.
        """
        return self.conductor.call(lambda: self.live.driver.gripper(gripper.name).held)

    def expect_contact(self, body: str, others: Iterable[str], expected: bool = True) -> None:
        """Declare that contact between `body` and `others` is expected during motions of the cell,
        or revoke this declaration.
        """
        others = tuple(others)
        self.conductor.call(lambda: self.live.ctx.expect_contact(body, others, expected))

    def queue_event(self, kind: str, text: str, **data: Any) -> None:
        """Queue an event for the observers of the cell and of its clients' motions."""
        self.conductor.call_soon(lambda: self.live.ctx.emit(kind, text, **data))

    # --- motions ---
    def motions(self, joints: Iterable[str] | None = None) -> list[MotionHandle]:
        """Return the waiting and running motions of the cell, from all clients. If joints are given, return
        only motions of these joints.
        """
        return self.conductor.motions(joints)

    def stop(self) -> None:
        """Stop all motions of the cell, including motions of other clients."""
        self.conductor.stop()

    def drive(self, gripper: Gripper, width: float, force: float) -> MotionHandle:
        """Queue a motion of the cell that opens or closes a gripper for a client, and return a handle to the
        motion.

        Args:
            gripper: the gripper.
            width: target width between the fingers [m].
            force: force per finger [N]; 0 means the gripper's maximum force.
        """
        return self.grippers.drive(gripper, width, force)

    def queue_trajectory(
        self,
        message: Any,
        settings: ExecutionSettings = ExecutionSettings(),
        planned_in: PlanningScene | None = None,
        controllers: Sequence[str] = (),
    ) -> MotionHandle:
        """Queue a trajectory_msgs/JointTrajectory as a motion of the cell.
        It starts after earlier motions of the same joints have ended.

        `say` reports the progress. A trajectory without points stops its joints, or all joints if it names
        none. The motion gate certifies the motion when it starts, with the contacts that `planned_in` allows.
        The motion stops if a change of the scene obstructs the rest of its path.

        Args:
            message: the JointTrajectory message.
            settings: tolerances and limits of the execution.
            planned_in: the scene in which the motion was planned; default: the current scene.
            controllers: names of the only controllers that may move the joints; default: all controllers of
                the joints.
        Returns:
            A handle to the motion.
        Raises:
            InputError: the message is invalid; the error states the cause.
        """
        model = self.model
        state = self.conductor.call(self.live.driver.joint_state)
        try:
            trajectory = trajectory_from_message(message, model, state)
        except ArmcellError as error:
            self.say(f"refused: {error}")
            raise
        if not len(trajectory.times):
            return self._halt(trajectory)
        self._find(trajectory.joint_names, controllers)
        if goals := finger_goals(model, trajectory):
            return self._close_or_open(trajectory, goals)

        def steps(driver: Any, cancel: threading.Event) -> ExecutionSteps:
            # The robot may have moved since the message arrived: start from its current state.
            now = trajectory_from_message(message, model, driver.joint_state())
            work.trajectory = now
            driver = self._restricted(driver, controllers)
            return (yield from execution_steps(driver, _Announced(self, now, planned_in, cancel), settings))

        work = MotionHandle(
            "trajectory", trajectory.joint_names, steps, trajectory=trajectory
        ).add_done_callback(self._ended)
        return self._queue_beside_others(work, trajectory)

    def _find(self, joints: Sequence[str], controllers: Sequence[str]) -> None:
        """Check that the controllers selected by a client cover all joints of a motion of the cell."""
        if controllers:
            select_controllers(self.controllers, controllers, joints)

    def _restricted(self, driver: Driver, controllers: Sequence[str]) -> Driver:
        """Return the cell's driver for a client's motions, restricted to the named controllers. Without
        names, the motions may use all controllers.
        """
        return driver

    def _halt(self, trajectory: JointTrajectory) -> MotionHandle:
        joints = trajectory.joint_names or self.model.joint_names

        def steps(driver: Any, cancel: threading.Event) -> Any:
            self.say("stop")
            nothing = replace(trajectory, joint_names=joints, positions=np.zeros((0, len(joints))))
            return execution_steps(driver, self.live.ctx.gate.motion(nothing))

        return self.conductor.put(MotionHandle("stop", joints, steps).add_done_callback(self._ended))

    def _close_or_open(self, trajectory: JointTrajectory, goals: list[tuple[Gripper, float]]) -> MotionHandle:
        """Queue a motion of the cell that moves fingers to their widths [m]. It also succeeds if an object
        stops the fingers.
        """

        def steps(driver: Any, cancel: threading.Event) -> Any:
            self.say(f"executing {len(trajectory.times)} points, {trajectory.duration:.2f} s")
            result = ExecutionResult(ErrorCode.SUCCESS)
            for gripper, width in goals:
                result = yield from self.grippers.command_steps(
                    driver, gripper, width, gripper.max_force, cancel
                )
            return result

        return self.conductor.put(
            MotionHandle("fingers", trajectory.joint_names, steps).add_done_callback(self._ended)
        )

    def _queue_beside_others(self, work: MotionHandle, trajectory: JointTrajectory) -> MotionHandle:
        """Queue a motion of the cell. If it conflicts with running motions of other arms, first wait until
        enough of those motions have ended.

        Raises:
            InputError: the cell is closed, or too many motions wait.
        """
        while not self._stop.is_set():
            others = self._others(work)
            if (late := self._blocking_motion(work, others)) is not None:
                late.wait(self.live.driver.period)  # the proof needs the start time of the other motion
                continue
            if contact := self._temporary_conflict(others, trajectory):
                self.say(f"waits until another motion has ended: {contact}")
                while not self._stop.is_set() and not any(w.wait(0.05) for w in others):
                    pass
                continue
            with self._putting:  # a motion that another thread has queued since then is not in the proof
                if set(self._others(work)) <= set(others):
                    return self.conductor.put(work)
        raise InputError("the cell is closed")

    def _others(self, work: MotionHandle) -> list[MotionHandle]:
        """Return the waiting and running motions of the cell that share no joint with the motion `work`."""
        works = self.conductor.motions()
        return [w for w in works if w.trajectory is not None and not w.joints & work.joints]

    def _blocking_motion(self, work: MotionHandle, others: list[MotionHandle]) -> MotionHandle | None:
        """Return a motion of the cell that must start or end before the motion `work` can be checked for
        collisions. Return None if there is no such motion.
        """
        before = [w for w in self.conductor.motions(work.joints) if not w.gives_way]
        late = [w for w in others if w.began is None]
        return next((w for w in (*before, *late) if not w.is_over), None)

    def _temporary_conflict(self, others: list[MotionHandle], new: JointTrajectory) -> str:
        """Describe the temporary conflict between a new motion and running motions of the cell: the new
        motion can start once the running motions have ended.

        Return an empty string if there is no conflict, or if waiting does not resolve the conflict.
        """
        running = [w.trajectory for w in others if w.trajectory is not None and not w.is_over]
        if not running:
            return ""
        scene, gate, motion = self.conductor.call(self.live.scene), self.live.ctx.gate, ActiveMotion(new)
        now = gate.conflict(motion, scene)
        if now is None:
            return ""
        for trajectory in running:
            scene = scene.with_state(trajectory.end)
        if first_conflict(scene, motion) is not None:
            return ""  # waiting does not help: the motion gate rejects this motion
        return "the motions meet" if now.contact is None else now.contact.describe()

    def _ended(self, work: MotionHandle) -> None:
        self.executed += 1
        if not self._stop.is_set():
            with suppress(InputError):  # the robot's state is unknown
                self.grippers.revoke_finger_contacts(work.joints)
        if work.error is not None:
            self.say(f"refused: {work.error}")
            return
        result = STOPPED if work.result is None else work.result  # same texts as Unity's player
        what = "done" if result.ok else "stopped" if result.code is ErrorCode.PREEMPTED else "failed"
        if result.evidence.get(NOT_STARTED):
            what = "refused"
        self.say(f"{what}: {result.message or f'final error {result.final_error:.4f}'}")


class _Announced(GuardedMotion):
    """Motion of the cell that a client has requested. `MotionGate` checks the motion for collisions, and the
    cell's observers are notified when the motion starts.
    """

    def __init__(
        self, cell: CellMotions, trajectory: JointTrajectory, planned_in: PlanningScene | None,
        cancel: threading.Event,
    ):  # fmt: skip
        super().__init__(cell.live.ctx.gate, trajectory, planned_in, cancel)
        self._cell = cell

    def begin(self, blend: JointTrajectory | None = None) -> ExecutionResult | None:
        self._cell.update_held_objects()
        refused = super().begin(blend)
        if refused is None:
            self._cell.say(f"executing {len(self.trajectory.times)} points, {self.trajectory.duration:.2f} s")
            self._cell.live.ctx.announce(self.trajectory)
        return refused
