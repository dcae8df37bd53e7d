"""Access for move_group to a cell in the same process, including the held objects."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from armcell.execution import ExecutionSettings
from armcell.model import Gripper, RobotModel
from armcell.ros.nodes.cell_node import CellNode
from armcell.ros.nodes.conductor import Work
from armcell.ros.nodes.controllers import chosen
from armcell.scene import PlanningScene
from armcell.tasks.context import Holding, TaskContext

LET_GO = 0.004  # [m] fingers that opened by more since the grasp have released the object
FALLEN = 0.03  # [m] an object that slipped by more from its grasp has fallen


class LocalCell:
    """Implementation of `CellAccess` for a cell that a `CellNode` runs in this process.

    An object between closed fingers is attached to the hand automatically, no matter which client closed
    them, and returns to the world when the fingers open. Clients need not attach or detach grasped objects in
    the planning scene.
    """

    def __init__(self, node: CellNode):
        self._node = node
        self._widths: dict[str, float] = {}  # finger width at the grasp [m], by object
        node.look_at_hands = lambda: self._look_at_grippers(node.live.ctx)

    @property
    def model(self) -> RobotModel:
        return self._node.live.model

    def scene(self) -> PlanningScene:
        return self._node.conductor.call(self.now)

    def now(self) -> PlanningScene:
        """Return the measured scene, like `scene()`; call this only in the driver's thread."""
        ctx = self._node.live.ctx
        self._look_at_grippers(ctx)
        return ctx.scene()

    def _look_at_grippers(self, ctx: TaskContext) -> None:
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
            ctx.take(Holding(reading.held, gripper, T))
            self._widths[reading.held] = reading.width

    def change(self, make: Callable[[PlanningScene], PlanningScene]) -> PlanningScene:
        self.scene()  # update the held objects from the grippers first
        self._node.live.ctx.change_scene(make)  # in this thread, because a large mesh takes time
        return self.scene()

    @property
    def controllers(self) -> Mapping[str, tuple[str, ...]]:
        return self._node.controllers

    def play(
        self,
        message: Any,
        settings: ExecutionSettings = ExecutionSettings(),
        planned_in: PlanningScene | None = None,
        controllers: Sequence[str] = (),
    ) -> Work:
        if controllers and len(message.points):
            chosen(self.controllers, controllers, message.joint_names)
        return self._node.play(message, settings, planned_in)

    def drive(self, gripper: Gripper, width: float, force: float) -> Work:
        return self._node.grippers.drive(gripper, width, force)

    def held(self, gripper: Gripper) -> str | None:
        return self._node.conductor.call(lambda: self._node.live.driver.gripper(gripper.name).held)

    def works(self, joints: Iterable[str] | None = None) -> list[Work]:
        return self._node.conductor.works(joints)

    def expect_contact(self, body: str, others: Iterable[str], expected: bool = True) -> None:
        others = tuple(others)
        ctx = self._node.live.ctx
        self._node.conductor.call(lambda: ctx.expect_contact(body, others, expected))

    def tell(self, kind: str, text: str, **data: Any) -> None:
        self._node.conductor.soon(lambda: self._node.live.ctx.emit(kind, text, **data))

    def stop(self) -> None:
        self._node.conductor.stop()
