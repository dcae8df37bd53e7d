"""What the program of one of two arms knows: the scene without the other arm, and the traffic."""

from __future__ import annotations

from contextlib import AbstractContextManager

from armcell.collision.arms import without_arm
from armcell.control import Driver
from armcell.core import JointTrajectory, Outcome
from armcell.scene import PlanningScene
from armcell.tasks.arms.traffic import Traffic
from armcell.tasks.context import TaskContext
from armcell.tasks.steps import Motion


class ArmContext(TaskContext):
    """As `TaskContext`, for one arm of two that work side by side."""

    def __init__(self, parent: TaskContext, group: str, driver: Driver, traffic: Traffic):
        super().__init__(driver, parent.base, parent.settings, parent.observers, parent.seed, parent.cancel)
        self.parent, self.group, self.traffic, self.ended = parent, group, traffic, False
        self.events = parent.events
        traffic.contexts[group] = self
        arm = {g.name for g in parent.base.model.grippers.values() if g.arm_group == group}
        self.holding = {n: h for n, h in parent.holding.items() if h.gripper.name in arm}

    def whole_scene(self) -> PlanningScene:
        """Both arms as measured, with what they hold."""
        scene = super().scene()
        for ctx in self.traffic.contexts.values():
            for held in ctx.holding.values():
                if held.object in scene.objects:
                    scene = scene.with_attached(held.object, held.gripper.tcp_link, held.gripper.hand_links)
        return scene

    def scene(self) -> PlanningScene:
        return without_arm(self.whole_scene(), self.traffic.other(self.group))

    def observe(self) -> None:
        self.parent.observe()

    def clear(self, motion: Motion) -> JointTrajectory | Outcome:
        return self.traffic.clear(self, motion)

    def reserve(self, zone: str) -> AbstractContextManager[None]:
        return self.traffic.reserved(self, zone)

    def meet(self, name: str) -> None:
        self.traffic.meet(self, name)

    def rested(self) -> None:
        self.traffic.rest(self)
