"""What the program of one of two arms knows: the scene without the other arm, and the traffic."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import AbstractContextManager

from armcell.collision.arms import without_arm
from armcell.control import Driver
from armcell.core import JointTrajectory, Outcome
from armcell.scene import PlanningScene
from armcell.tasks.arms.traffic import Traffic
from armcell.tasks.context import Holding, TaskContext
from armcell.tasks.steps import Motion


class ArmContext(TaskContext):
    """As `TaskContext`, for one arm of two that work side by side."""

    def __init__(self, parent: TaskContext, group: str, driver: Driver, traffic: Traffic):
        super().__init__(driver, parent.base, parent.settings, parent.observers, parent.seed, parent.cancel)
        self.parent, self.group, self.traffic, self.ended = parent, group, traffic, False
        self.events, self.world = parent.events, parent.world
        self.gate, self.lost = parent.gate, parent.lost
        traffic.contexts[group] = self
        arm = {g.name for g in parent.base.model.grippers.values() if g.arm_group == group}
        self.holding = {n: h for n, h in parent.holding.items() if h.gripper.name in arm}

    def hands(self) -> Iterable[Holding]:
        return self.parent.hands()

    def scene(self) -> PlanningScene:
        return without_arm(self.whole_scene(), self.traffic.other(self.group))

    def expect_contact(self, body: str, others: Iterable[str], expected: bool = True) -> None:
        self.parent.expect_contact(body, others, expected)

    def observe(self) -> None:
        self.parent.observe()

    def clear(self, motion: Motion) -> JointTrajectory | Outcome:
        return self.traffic.clear(self, motion)

    def reserve(self, zone: str) -> AbstractContextManager[None]:
        return self.traffic.reserved(self, zone)

    def choose(self, items: Sequence[str], zone: Callable[[str], str]) -> str:
        return self.traffic.choose(self.group, items, zone)

    def meet(self, name: str) -> None:
        self.traffic.meet(self, name)

    def rested(self) -> None:
        self.traffic.rest(self)
