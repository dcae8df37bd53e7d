"""Task context of one of two arms: the scene without the other arm, and the coordinator."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import AbstractContextManager

from armcell.collision.arms import without_arm
from armcell.core import JointTrajectory, Outcome
from armcell.drivers import Driver
from armcell.scene import PlanningScene
from armcell.tasks.arms.coordinator import MotionCoordinator
from armcell.tasks.context import Holding, TaskContext
from armcell.tasks.steps import Motion


class ArmContext(TaskContext):
    """Task context (see `TaskContext`) of one of two arms that work side by side."""

    def __init__(self, parent: TaskContext, group: str, driver: Driver, coordinator: MotionCoordinator):
        super().__init__(driver, parent.base, parent.settings, parent.observers, parent.seed, parent.cancel)
        self.parent, self.group, self.coordinator, self.ended = parent, group, coordinator, False
        self.events, self.world = parent.events, parent.world
        self.gate, self.lost = parent.gate, parent.lost
        coordinator.contexts[group] = self
        arm = {g.name for g in parent.base.model.grippers.values() if g.arm_group == group}
        self.holding = {n: h for n, h in parent.holding.items() if h.gripper.name in arm}

    def hands(self) -> Iterable[Holding]:
        return self.parent.hands()

    def scene(self) -> PlanningScene:
        return without_arm(self.whole_scene(), self.coordinator.other(self.group))

    def expect_contact(self, body: str, others: Iterable[str], expected: bool = True) -> None:
        self.parent.expect_contact(body, others, expected)

    def observe(self) -> None:
        self.parent.observe()

    def clear(self, motion: Motion) -> JointTrajectory | Outcome:
        return self.coordinator.clear(self, motion)

    def reserve(self, zone: str) -> AbstractContextManager[None]:
        return self.coordinator.reserved(self, zone)

    def choose(self, items: Sequence[str], zone: Callable[[str], str]) -> str:
        return self.coordinator.choose(self.group, items, zone)

    def rendezvous(self, name: str) -> None:
        self.coordinator.rendezvous(self, name)

    def rested(self) -> None:
        self.coordinator.rest(self)
