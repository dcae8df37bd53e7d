"""Pair of hands at one object: measurements, gripper commands and synchronized motions."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armcell.collision import neighbors
from armcell.core import SE3, ErrorCode, InputError, JointTrajectory, Outcome, PlanResult
from armcell.core.checks import checked, require
from armcell.execution import AdmittanceSettings
from armcell.kinematics import kinematic_tree
from armcell.planning import CarriedObject, plan_carry
from armcell.scene import PlanningScene
from armcell.tasks.arms.coupled import play
from armcell.tasks.context import StageReport, TaskContext
from armcell.tasks.steps import DONE, staged

Array = NDArray[np.float64]


@dataclass(frozen=True)
@checked()
class CarrySettings:
    """Settings for a pair of hands with which two arms carry one object."""

    velocity: float = 0.3  # scaling of the joint limits
    acceleration: float = 0.15
    max_speed: float = 0.2  # [m/s] maximum speed of the object
    max_off: float = 5e-4  # [m] maximum deviation of the hands' relative position; more stops both arms
    max_turn: float = 1.7453e-3  # [rad] maximum deviation of their relative rotation: 0.1 degree
    max_squeeze: float = 30.0  # [N] maximum internal force between the hands; more stops both arms
    approach: float = 0.1  # [m] straight approach
    planning_time: float = 10.0  # [s] for detours around obstacles; 0: only straight paths
    settle: float = 0.4  # [s] pause after closing and after opening
    admittance: AdmittanceSettings = AdmittanceSettings()

    def __post_init__(self) -> None:
        for name in ("max_off", "max_turn", "max_squeeze", "approach", "max_speed"):
            require(getattr(self, name) > 0, f"{name} is {getattr(self, name):g}, it must be positive")
        require(self.planning_time >= 0, f"planning_time is {self.planning_time:g}, it must be at least 0")


@dataclass
class PairHold:
    """State of a pair of hands, measured when the grippers closed on the object."""

    carried: CarriedObject  # grasps at the set points
    T_hands: SE3  # measured pose of the second hand in the first
    T_first_object: SE3  # measured
    supports: tuple[str, ...]  # bodies on which the object rested
    q: Array = field(default_factory=lambda: np.zeros(0))  # current set points of both arms


class HandPair:
    """Pair of hands with which two arms hold an object at its two ends.

    Args:
        both: the group of both arms' joints.
        ends: arm group -> subframe of the object for the arm's TCP.
    Raises:
        InputError: not two arms, no such subframe, or the object is fixed.
    """

    def __init__(
        self, ctx: TaskContext, both: str, item: str, ends: Mapping[str, str], settings: CarrySettings
    ):
        model, found = ctx.scene().model, ctx.scene().object(item)
        if len(ends) != 2:
            raise InputError(f"{item!r} is given to {len(ends)} arms, two are needed")
        for end in ends.values():
            if end not in found.subframes:
                raise InputError(
                    f"object {item!r} has no subframe {end!r}", hint=f"{sorted(found.subframes)}"
                )
        if not found.movable:
            raise InputError(f"object {item!r} is fixed", hint="give it 'movable: true'")
        self.ctx, self.both, self.item, self.ends, self.settings = ctx, both, item, dict(ends), settings
        self.groups: tuple[str, str] = tuple(ends)  # type: ignore[assignment]
        self.first, self.second = self.groups
        self.grippers = {g: model.gripper(arm_group=g) for g in ends}
        self.tips = {g: self.grippers[g].tcp_link for g in ends}
        self.names = model.group(both).joint_names
        self.columns = model.columns(self.names)
        self.tree = kinematic_tree(model)
        self.hold: PairHold | None = None

    def other(self, group: str) -> str:
        """Return the partner of an arm in a hand pair: the planning group of the arm that carries the object
        together with the arm `group`.
        """
        return next(g for g in self.groups if g != group)

    def tcp_poses_at(self, q: Array) -> dict[str, SE3]:
        """Return T_world_tcp of both hands of a pair, by arm group,
        at given joint positions (n,) of both arms.
        """
        full = self.ctx.driver.joint_state().positions.copy()
        full[self.columns] = q
        return self._tcp_poses(full)

    def measured_tcp_poses(self) -> dict[str, SE3]:
        """Return the measured TCP poses T_world_tcp of both hands of a pair, by arm group."""
        return self._tcp_poses(self.ctx.driver.joint_state().positions)

    def _tcp_poses(self, q: Array) -> dict[str, SE3]:
        return dict(zip(self.groups, self.tree.link_poses(q, tuple(self.tips.values())), strict=True))

    def supports(self, scene: PlanningScene) -> tuple[str, ...]:
        """Return the names of the bodies on which the object of a `HandPair` rests. While the two hands hold
        the object, return the bodies on which it rested when the hands grasped it.
        """
        return self.hold.supports if self.hold is not None else tuple(neighbors(scene, self.item))

    def attached(self, scene: PlanningScene) -> PlanningScene:
        """Return the scene in which the object that two arms hold (`HandPair`) is attached to the first hand.

        Contacts of both hands and of the supports with the object are allowed.
        """
        first, second = (self.grippers[g] for g in self.groups)
        supports = self.supports(scene)
        scene = scene.with_attached(self.item, first.tcp_link, first.hand_links)
        return scene.with_allowed(self.item, (*second.hand_links, *supports))

    def plan(
        self, scene: PlanningScene, carried: CarriedObject, start: SE3, poses: Sequence[SE3], seconds: float
    ) -> PlanResult:
        """Plan a motion with which a pair of hands carries the object
        from its start pose through further poses.

        With a planning time of 0 s, only straight paths are tried.
        """
        s, rests_on = self.settings, self.supports(self.ctx.scene())
        return plan_carry(
            scene, self.both, carried, start, poses, s.velocity, s.acceleration, s.max_speed, rests_on,
            seconds, self.ctx.seed, self.ctx.cancel,
        )  # fmt: skip

    def move_fingers(
        self, name: str, widths: Mapping[str, float], settle: float, force: Mapping[str, float] | None = None
    ) -> Outcome:
        """Command both grippers of a hand pair at the same time and wait until both have finished.

        Args:
            widths: [m] by arm group.
            settle: pause [s] after both have arrived.
            force: [N] per finger by arm group, for closing on the object; default: the maximum.
        """
        ctx, driver = self.ctx, self.ctx.driver

        def act() -> Outcome:
            for group, width in widths.items():
                g = self.grippers[group]
                driver.command_gripper(g.name, width, g.max_force if force is None else force[group])
            end = driver.now + ctx.settings.gripper_timeout
            while driver.now < end and not ctx.cancel.is_set():
                ctx.advance(0.02)
                forces = dict.fromkeys(widths) if force is None else force
                if all(self._arrived(g, w, forces[g]) for g, w in widths.items()):
                    break
            ctx.advance(settle)
            return Outcome(ErrorCode.PREEMPTED, "cancelled") if ctx.cancel.is_set() else DONE

        return staged(ctx, StageReport(name), act)

    def _arrived(self, group: str, width: float, force: float | None) -> bool:
        reading = self.ctx.driver.gripper(self.grippers[group].name)
        if force is None:
            return abs(reading.width - width) < 1e-3
        return reading.held == self.item and reading.force_per_finger >= 0.8 * force

    def play(
        self, name: str, trajectory: JointTrajectory, report: StageReport | None = None,
        correct: Callable | None = None, watch: Callable | None = None,
        evidence: Mapping[str, Any] = MappingProxyType({}), planned_in: PlanningScene | None = None,
    ) -> Outcome:  # fmt: skip
        """Execute a synchronized trajectory of both arms of a hand pair as one stage of a task."""
        report = report or StageReport(name, "cartesian")
        return play(
            self.ctx, trajectory.reindexed(self.names), report, correct, watch, evidence, self._touching,
            planned_in,
        )  # fmt: skip

    def _touching(self) -> PlanningScene:
        """Return the measured scene in which both hands of a pair may touch the object.
        If the hands hold the object, it is attached.
        """
        scene = self.ctx.scene()
        if self.hold is not None:
            return self.attached(scene)
        return scene.with_allowed(self.item, [n for g in self.grippers.values() for n in g.hand_links])
