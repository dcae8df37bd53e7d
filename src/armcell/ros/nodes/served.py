"""A cell with all that is served of it: states, motions, grippers, move_group, pick and place, grasping."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack, nullcontext
from typing import Any, TypeVar

import numpy as np

from armcell.cell import Cell, LiveCell
from armcell.core import InputError
from armcell.planning import prepare, warm_up
from armcell.ros.bus import Bus
from armcell.ros.nodes.access import CellAccess
from armcell.ros.nodes.cell_node import CellNode
from armcell.ros.nodes.conductor import SETTLE
from armcell.ros.nodes.description import describe
from armcell.ros.nodes.grasp_server import GraspServer
from armcell.ros.nodes.local_cell import LocalCell
from armcell.ros.nodes.move_group import MoveGroupNode
from armcell.ros.nodes.pick_place import PickPlaceNode
from armcell.ros.nodes.remote_cell import RemoteCell
from armcell.ros.nodes.states import RATE
from armcell.tasks import TaskSettings

T = TypeVar("T")
RESUME = "/resume"
AT_REST, STILL = 0.01, 0.2  # [rad/s or m/s], for so long [s]: an arm that was stopped swings


def _serve_planner(cell: CellAccess, bus: Bus, settings: TaskSettings, stack: ExitStack) -> None:
    group = MoveGroupNode(cell, bus)
    stack.callback(group.close)
    stack.callback(PickPlaceNode(group, settings).close)
    if cell.model.grippers:
        stack.callback(GraspServer(cell, bus).close)


class ServedCell:
    """Runs from `start` (or `with`) to `close`.

    Service /resume (std_srvs/Trigger): makes the cell ready after a stop, or answers with what to do first
    (`LiveCell.resume`). In the caller's thread: to connect to an arm again takes seconds.

    Args:
        plan: serve move_group, too, not the robot and its grippers alone.
        auto_grip: see `CellNode`.
    """

    def __init__(
        self, live: LiveCell, bus: Bus, rate: float = RATE, plan: bool = True, auto_grip: bool = False
    ):
        self.bus, self.live = bus, live
        self.node = CellNode(live, bus, rate, auto_grip)
        self.cell = LocalCell(self.node)
        self._plan = plan
        self._stack = ExitStack()
        self.failure: BaseException | None = None
        # Not the thread's own word: an interrupted `join` of Python 3.11 marks a running thread as dead.
        self.over = threading.Event()
        self.thread = threading.Thread(target=self._run, name=f"cell {live.name}", daemon=True)

    def _run(self) -> None:
        try:
            self.node.run()
        except BaseException as error:  # said by whoever waits for it
            self.failure = error
        finally:
            self.over.set()

    @property
    def is_running(self) -> bool:
        """Whether the cell's thread steps it."""
        return self.thread.ident is not None and not self.over.is_set()

    def start(self, poll: float = 0.1, layer: Callable[[str], AbstractContextManager] = nullcontext) -> None:
        """Connect the cell and serve it; returns when it is ready.

        Args:
            layer: around "drivers" and "planner" (`cell.health`).
        Raises:
            What made it end, where it ended before it was ready.
        """
        describe(self.bus, self.live.model)
        with layer("drivers"):
            self.thread.start()
            while not self.node.ready.wait(poll):
                if not self.is_running:
                    raise self.failure or RuntimeError("the cell ended before it was ready")
        self._stack.callback(self.bus.serve(RESUME, "std_srvs/Trigger", self._on_resume).close)
        with layer("planner"):
            if self._plan:
                _serve_planner(self.cell, self.bus, self.live.ctx.settings, self._stack)

    def _on_resume(self, request: Any) -> Any:
        outcome = self.live.resume()
        return self.bus.schema.new("std_srvs/TriggerResponse", outcome.ok, outcome.message or "ready")

    def call(self, function: Callable[[], T]) -> T:
        """Run something in the cell's thread between two steps, and wait; here, where that has ended."""
        if self.is_running:
            try:
                return self.node.conductor.call(function)
            except InputError:
                if not self.over.wait(1.0):
                    raise
        return function()

    def rest(self) -> None:
        """Stop what moves, and wait until it rests; nothing moves again. See what the hands hold then."""
        self.node.conductor.stop(for_good=True)
        for work in self.cell.works():
            work.wait(SETTLE)
        moved = time.monotonic()
        end = moved + SETTLE
        while self.is_running and (now := time.monotonic()) < min(moved + STILL, end):
            moved = now if self.call(self._speed) > AT_REST else moved
            time.sleep(0.01)
        self.call(self.cell.now)

    def _speed(self) -> float:
        """Of the fastest joint [rad/s or m/s]; 0 where it is not known."""
        v = self.live.driver.joint_state().velocities
        return 0.0 if v is None else float(np.max(np.abs(v), initial=0.0))

    def close(self) -> None:
        """Stop what moves and leave the bus."""
        self._stack.close()
        self.node.close()
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


class ServedPlanner:
    """The planner and the grasp server of a cell whose simulator is another program on the bus."""

    def __init__(self, cell: Cell, bus: Bus, seed: int = 0):
        self.bus = bus
        self._scene, self._settings = cell.scene(seed), cell.settings
        self.cell = RemoteCell(bus, self._scene)
        self._stack = ExitStack()

    def start(self) -> None:
        describe(self.bus, self._scene.model)
        warm_up()
        for group in self._scene.model.groups.values():
            if group.tip_link:
                prepare(self._scene, group.name)
        _serve_planner(self.cell, self.bus, self._settings, self._stack)

    def close(self) -> None:
        self._stack.close()
        self.cell.close()

    def __enter__(self) -> ServedPlanner:
        self.start()
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()
