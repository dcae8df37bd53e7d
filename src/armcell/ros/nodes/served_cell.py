"""A cell with all of its nodes: states, motions, grippers, move_group, pick and place."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, ExitStack, nullcontext
from typing import Any, TypeVar

import numpy as np

from armcell.cell import Cell, LiveCell
from armcell.core import InputError
from armcell.perception import Sensors3d
from armcell.ros.bus import Bus
from armcell.ros.nodes.cell_motions import CellMotions
from armcell.ros.nodes.cell_node import CellNode
from armcell.ros.nodes.grasp_server import GraspServer
from armcell.ros.nodes.motion_queue import SETTLE
from armcell.ros.nodes.move_group import MoveGroupNode
from armcell.ros.nodes.octomap_node import OctomapNode
from armcell.ros.nodes.pick_place import PickPlaceNode
from armcell.ros.nodes.remote_driver import RemoteDriver
from armcell.ros.nodes.remote_motions import RemoteMotions
from armcell.ros.nodes.state_publisher import RATE
from armcell.ros.robot_description import publish_robot_description
from armcell.tasks import TaskSettings

T = TypeVar("T")
RESUME = "/resume"
AT_REST, STILL = 0.01, 0.2  # speed [rad/s or m/s] and its duration [s]: a stopped arm still oscillates


def _serve_planner(
    cell: CellMotions, bus: Bus, settings: TaskSettings, stack: ExitStack, sensors: Sensors3d | None,
    planner_configs: Mapping[str, Any],
) -> None:  # fmt: skip
    group = MoveGroupNode(cell, bus, planner_configs)
    stack.callback(group.close)
    if sensors is not None:
        stack.callback(OctomapNode(cell, bus, group.scene_node, sensors).close)
    stack.callback(PickPlaceNode(group, settings).close)
    if cell.model.grippers:
        stack.callback(GraspServer(cell, bus).close)


class ServedCell:
    """Live cell that is served with all its ROS nodes (states, grippers, move_group) until `close`.

    The service /resume (std_srvs/Trigger) makes the cell ready after a stop, or responds with the action that
    the operator must take first (`LiveCell.resume`). It runs in the caller's thread, because reconnecting to
    an arm takes seconds.

    Args:
        live: the cell.
        bus: the message bus.
        rate: publishing rate of the states [Hz].
        plan: if True, also serve move_group; if False, only the robot and its grippers.
        auto_grip: see `CellNode`.
        sensors: sensors whose clouds and depth images update the octomap; default: the cell's sensors.
    """

    def __init__(
        self, live: LiveCell, bus: Bus, rate: float = RATE, plan: bool = True, auto_grip: bool = False,
        sensors: Sensors3d | None = None,
    ):  # fmt: skip
        self.node = CellNode(live, bus, rate, auto_grip)
        self._set_up(live, bus, self.node, plan, sensors)

    def _set_up(
        self, live: LiveCell, bus: Bus, cell: CellMotions, plan: bool, sensors: Sensors3d | None
    ) -> None:
        self.bus, self.live, self.cell = bus, live, cell
        self._plan, self._sensors = plan, sensors or live.sensors
        self._stack = ExitStack()
        self.failure: BaseException | None = None
        # `Thread.is_alive` is unreliable: an interrupted `join` of Python 3.11 marks a live thread as dead.
        self.over = threading.Event()
        self.thread = threading.Thread(target=self._run, name=f"cell {live.name}", daemon=True)

    def _run(self) -> None:
        try:
            self.cell.run()
        except BaseException as error:  # the thread that waits for this one reports it
            self.failure = error
        finally:
            self.over.set()

    @property
    def has_closed_gripper(self) -> bool:
        """Return whether a gripper of the served cell was commanded to close or can close automatically."""
        return self.node.grippers.auto_grip or self.node.grippers.has_closed

    @property
    def is_running(self) -> bool:
        """Return whether the thread of the served cell is still stepping the cell."""
        return self.thread.ident is not None and not self.over.is_set()

    def start(self, poll: float = 0.1, layer: Callable[[str], AbstractContextManager] = nullcontext) -> None:
        """Start the served cell: connect the live cell and start all its nodes on the message bus. Return
        when the cell can answer clients.

        Args:
            poll: polling period [s] for the cell's thread.
            layer: context manager around the layers "drivers" and "planner" (`cell.health`).
        Raises:
            BaseException: the error that ended the cell's thread before the cell was ready.
        """
        self._stack.callback(publish_robot_description(self.bus, self.live.model).close)
        with layer("drivers"):
            self.thread.start()
            while not self.cell.ready.wait(poll):
                if not self.is_running:
                    raise self.failure or RuntimeError("the cell ended before it was ready")
        if isinstance(self.cell, CellNode):
            self._stack.callback(self.bus.serve(RESUME, "std_srvs/Trigger", self._on_resume).close)
        with layer("planner"):
            if self._plan:
                live = self.live
                _serve_planner(
                    self.cell, self.bus, live.ctx.settings, self._stack, self._sensors, live.planner_configs
                )

    def _on_resume(self, request: Any) -> Any:
        outcome = self.live.resume()
        return self.bus.schema.new("std_srvs/TriggerResponse", outcome.ok, outcome.message or "ready")

    def call(self, function: Callable[[], T]) -> T:
        """Run a function in the thread of the served cell, between two steps, and return its result.

        If that thread has ended, run the function in the caller's thread.
        """
        if self.is_running:
            try:
                return self.cell.conductor.call(function)
            except InputError:
                if not self.over.wait(1.0):
                    raise
        return function()

    def stop_motions(self) -> None:
        """Stop all motions of the served cell for good, wait until the arms are at rest, and update which
        objects they hold.
        """
        self.cell.conductor.stop(for_good=True)
        for work in self.cell.motions():
            work.wait(SETTLE)
        moved = time.monotonic()
        end = moved + SETTLE
        while self.is_running and (now := time.monotonic()) < min(moved + STILL, end):
            moved = now if self.call(self._speed) > AT_REST else moved
            time.sleep(0.01)
        self.call(self.cell.measure_scene)

    def _speed(self) -> float:
        """Return the speed [rad/s or m/s] of the fastest joint in the served cell. It is 0 if velocities are
        not measured.
        """
        v = self.live.driver.joint_state().velocities
        return 0.0 if v is None else float(np.max(np.abs(v), initial=0.0))

    def close(self) -> None:
        """Stop all motions of the served cell and remove its nodes from the bus."""
        self._stack.close()
        self.cell.close()
        if self.thread.ident is not None:
            self.over.wait(5.0)
            self.thread.join(1.0)

    def __enter__(self) -> ServedCell:
        try:
            self.start()
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()


class ServedPlanner(ServedCell):
    """Planner and grasp server that are served on the ROS message bus for a cell whose simulator or robot
    runs in another program.

    The driver of the cell is a `RemoteDriver`.
    """

    def __init__(self, cell: Cell, bus: Bus, seed: int = 0, sensors: Sensors3d | None = None):
        scene = cell.scene(seed)
        self.driver = RemoteDriver(bus, scene, cell.controllers)
        live = LiveCell(cell.name, scene, self.driver, cell.settings, (), seed)
        live.sensors, live.planner_configs = cell.sensors, cell.planner_configs
        self._set_up(live, bus, RemoteMotions(live, self.driver), True, sensors)

    @property
    def has_closed_gripper(self) -> bool:
        """Return whether a gripper of the served cell was commanded to close or was closed by the
        simulator.
        """
        return self.driver.has_closed_gripper

    def stop_motions(self) -> None:
        """Stop the motions of a served cell whose simulator or robot runs in another program, and wait until
        the motions have ended.
        """
        works = self.cell.motions()
        self.cell.stop()
        for work in works:
            work.wait(SETTLE)
