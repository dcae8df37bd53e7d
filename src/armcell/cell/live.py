"""A connected cell: its arms by name, each with pick, place and moves."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import AbstractContextManager

from armcell.control import Driver
from armcell.core import InputError, JointGoal, Observer, Outcome, UnknownNameError
from armcell.planning import Target, goal_of, prepare
from armcell.scene import PlanningScene
from armcell.tasks import (
    StageReport,
    TaskContext,
    TaskSettings,
    grasp,
    hold,
    let_go,
    move_to,
    pick,
    place,
    release,
)
from armcell.tasks.arms import (
    ArmContext,
    Carrying,
    CarrySettings,
    ScrewSettings,
    SideBySide,
    move_together,
    screw,
    side_by_side,
)


class Arm:
    """One arm of a live cell. Every method returns an `Outcome`, true when it succeeded."""

    def __init__(self, ctx: TaskContext, group: str):
        self._ctx, self.group = ctx, group

    def pick(self, item: str) -> Outcome:
        """Grasp an object and lift it."""
        model = self._ctx.scene().model
        return pick(self._ctx, item, model.gripper(arm_group=self.group))

    def place(self, item: str, on: str, at: tuple[float, float] | None = None) -> Outcome:
        """Put a held object on another one, `at` [m] from the middle of its surface."""
        return place(self._ctx, item, on, at)

    def move_to(self, target: Target) -> Outcome:
        """Move to a named state, a pose of the tip (world frame), joint values, or any goal."""
        return move_to(self._ctx, self.group, goal_of(self._ctx.scene().model, self.group, target))

    def grasp(self, item: str) -> Outcome:
        """Take hold of an object where it is, without lifting it."""
        return grasp(self._ctx, item, self._ctx.scene().model.gripper(arm_group=self.group))

    def let_go(self, item: str) -> Outcome:
        """Open the hand that holds an object and draw it straight back."""
        return let_go(self._ctx, item)

    def screw(
        self, item: str, turns: float, force: float = 8.0, settings: ScrewSettings = ScrewSettings()
    ) -> Outcome:
        """Turn a held object clockwise about the tool's axis, pressing with a force [N] along it."""
        return screw(self._ctx, item, turns, force, settings)

    @property
    def joints(self) -> JointGoal:
        """Where the arm is now, to come back to: `ready = arm.joints; ...; arm.move_to(ready)`."""
        names = self._ctx.scene().model.group(self.group).joint_names
        return JointGoal(self._ctx.driver.joint_state().reindexed(names))

    def open(self) -> Outcome:
        """Open the gripper fully and forget what it held."""
        return release(self._ctx, self._ctx.scene().model.gripper(arm_group=self.group))

    def hold(self, duration: float) -> Outcome:
        """Stand still [s]."""
        return hold(self._ctx, duration)

    def reserve(self, zone: str) -> AbstractContextManager[None]:
        """`with arm.reserve("bin"):` of two arms that work side by side only one is in there."""
        return self._ctx.reserve(zone)

    def meet(self, name: str) -> None:
        """Wait until the other arm's program gets to the same point."""
        self._ctx.meet(name)


class LiveCell:
    """A cell with its driver connected, inside a `with` block.

    Attributes:
        driver: the robot, simulated or real.
        scene_at_start: the planning scene before anything has moved.
        ctx: the running task: scene, reports, events.
    """

    def __init__(
        self,
        name: str,
        scene: PlanningScene,
        driver: Driver,
        settings: TaskSettings,
        observers: Sequence[Observer],
        seed: int,
    ):
        self.name, self.driver, self.scene_at_start = name, driver, scene
        self.ctx = TaskContext(driver, scene, settings, observers, seed)
        self.model, self.seed = scene.model, seed

    def __enter__(self) -> LiveCell:
        self.driver.__enter__()
        self.ctx.observe()
        for group in self.arms:
            prepare(self.ctx.scene(), group)  # not on the time of the first plan
        return self

    def __exit__(self, *exc: object) -> None:
        self.driver.__exit__(*exc)

    @property
    def arms(self) -> dict[str, Arm]:
        """Arms by planning group: those that carry a gripper, else every chain."""
        groups = [g.arm_group for g in self.model.grippers.values()]
        groups = groups or [g.name for g in self.model.groups.values() if g.tip_link]
        return {name: Arm(self.ctx, name) for name in groups}

    @property
    def arm(self) -> Arm:
        """The only arm.

        Raises:
            InputError: the cell has none or several.
        """
        arms = self.arms
        if len(arms) != 1:
            raise InputError(
                f"cell {self.name!r} has {len(arms)} arms", cure=f"use cell.arms[...]: {sorted(arms)}"
            )
        return next(iter(arms.values()))

    def __getitem__(self, group: str) -> Arm:
        if group not in self.arms:
            raise UnknownNameError("arm", group, self.arms)
        return self.arms[group]

    def side_by_side(self, **programs: Callable[[Arm], Outcome | None]) -> SideBySide:
        """Two arms at work, each at its own pace: a function per arm, which gets the `Arm`.

        Example: `cell.side_by_side(left_arm=sort_left, right_arm=sort_right)`
        """

        def program(group: str) -> Callable[[ArmContext], Outcome | None]:
            return lambda ctx: programs[group](Arm(ctx, group))

        for group in programs:
            _ = self[group]
        return side_by_side(self.ctx, {group: program(group) for group in programs})

    def carry(self, item: str, settings: CarrySettings = CarrySettings(), **ends: str) -> Carrying:
        """An object for two arms: by arm, the object's subframe that it takes hold of.

        Example: `cell.carry("rod", left_arm="left_end", right_arm="right_end")`
        """
        for group in ends:
            _ = self[group]
        return Carrying(self.ctx, self._both(ends), item, ends, settings)

    def move_together(self, **targets: Target) -> Outcome:
        """Two arms to a target each; they start and arrive together."""
        scene = self.ctx.scene()
        goals = {group: goal_of(scene.model, group, target) for group, target in targets.items()}
        return move_together(self.ctx, self._both(targets), goals)

    def _both(self, groups: Iterable[str]) -> str:
        """The group of several arms' joints.

        Raises:
            InputError: there is none.
        """
        wanted = {n for group in groups for n in self.model.group(group).joint_names}
        for group in self.model.groups.values():
            if set(group.joint_names) == wanted:
                return group.name
        raise InputError(f"no planning group has the joints of {' and '.join(groups)}")

    @property
    def reports(self) -> list[StageReport]:
        """The stages performed so far."""
        return self.ctx.reports

    def stop(self) -> None:
        """Stop the running motion; from another thread. The next call moves again."""
        self.ctx.cancel.set()

    def scene(self) -> PlanningScene:
        """The planning scene as measured now."""
        return self.ctx.scene()
