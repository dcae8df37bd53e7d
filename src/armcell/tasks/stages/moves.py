"""Stages that move: connect by free-space planning, or in a straight line."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from armcell.core import (
    SE3,
    CartesianRequest,
    Goal,
    JointGoal,
    JointState,
    NamedGoal,
    PlanRequest,
    PlanResult,
)
from armcell.planning import plan, plan_cartesian
from armcell.scene import PlanningScene
from armcell.tasks.search import Draft, Planning
from armcell.tasks.settings import Speed
from armcell.tasks.steps import Motion


@dataclass(frozen=True, eq=False)
class Connect:
    """Plan from where the draft is to joint positions an earlier stage left in `data[target]`,
    or to a goal."""

    name: str
    group: str
    speed: Speed
    target: str | None = None
    goal: Goal | None = None

    def drafts(self, draft: Draft, planning: Planning) -> Iterator[Draft]:
        names = draft.scene.model.group(self.group).joint_names
        goal = self.goal or JointGoal(JointState(names, draft.data[self.target or ""]))
        seconds = min(planning.settings.planning_time, planning.time_left)
        request = PlanRequest(
            self.group, (goal,), planner_id=planning.settings.planner_id,
            planning_time=max(seconds, 0.01), velocity_scaling=self.speed.velocity,
            acceleration_scaling=self.speed.acceleration, seed=planning.seed,
        )  # fmt: skip
        result = plan(draft.scene, request, planning.cancel)
        if not result.ok or result.trajectory is None:
            planning.reject(self.name, draft.data.get("candidate", ""), result.message, result)
            return
        yield moved(draft, self.name, result)


@dataclass(frozen=True, eq=False)
class Straight:
    """Move the tip in a straight line from where the draft is."""

    name: str
    group: str
    link: str
    speed: Speed
    offset: tuple[float, float, float]  # [m]
    in_tip_frame: bool = False
    allow: tuple[tuple[str, tuple[str, ...]], ...] = ()  # contacts allowed during this motion only

    def drafts(self, draft: Draft, planning: Planning) -> Iterator[Draft]:
        scene = with_contacts(draft.scene, self.allow)
        target = shifted(scene.frame_pose(self.link), self.offset, self.in_tip_frame)
        result = straight(scene, self.group, self.link, target, self.speed)
        if not result.ok or result.trajectory is None:
            # Without the result: this start is the candidate's, in collision it is no reason to give up all.
            planning.reject(self.name, draft.data.get("candidate", ""), result.message)
            return
        yield moved(draft, self.name, result)


def straight(scene: PlanningScene, group: str, link: str, target: SE3, speed: Speed) -> PlanResult:
    request = CartesianRequest(
        group, (target,), link, velocity_scaling=speed.velocity, acceleration_scaling=speed.acceleration
    )
    return plan_cartesian(scene, request)


def shifted(pose: SE3, offset: tuple[float, float, float], in_own_frame: bool) -> SE3:
    step = np.asarray(offset)
    if in_own_frame:
        step = pose.rotation.matrix @ step
    return SE3(pose.rotation, pose.translation + step)


def with_contacts(scene: PlanningScene, allow: tuple[tuple[str, tuple[str, ...]], ...]) -> PlanningScene:
    for body, others in allow:
        if others:
            scene = scene.with_allowed(body, others)
    return scene


def moved(draft: Draft, name: str, result: PlanResult) -> Draft:
    """The draft after a planned motion."""
    trajectory = result.trajectory
    assert trajectory is not None
    motion = Motion(name, trajectory, result.planner_id, result.planning_time, result.min_clearance)
    return draft.then(motion, scene=draft.scene.with_state(trajectory.end))


__all__ = ["Connect", "NamedGoal", "Straight", "moved", "shifted", "straight", "with_contacts"]
