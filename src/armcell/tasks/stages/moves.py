"""Stages that move the arm: collision-free (`Connect`), or in a straight line (`MoveStraight`)."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np

from armcell.collision.kernel.checker import KernelChecker
from armcell.core import (
    SE3,
    SO3,
    CartesianRequest,
    Constraints,
    ErrorCode,
    Goal,
    JointGoal,
    JointState,
    NamedGoal,
    OrientationConstraint,
    Outcome,
    PlanRequest,
    PlanResult,
    PoseGoal,
)
from armcell.core.checks import checked, require
from armcell.planning import plan, plan_cartesian
from armcell.planning.cartesian.line_following import COLLISION
from armcell.scene import PlanningScene
from armcell.tasks.search import PartialSolution, SearchState, stage_types
from armcell.tasks.settings import Speed
from armcell.tasks.steps import Motion, Step

LEAST_LEFT = 0.1  # share of the planning time below which a new attempt is not worthwhile
MOST_AGAIN = 20  # limit of attempts, in case a planner waits without using the CPU
SEED_STEP = 1_000_003
WITHIN_REACH = 0.9  # length of a shorter straight motion, as a share of the feasible part of the full one


@dataclass(frozen=True)
class UprightConstraint:
    """Limit on how far [rad] a held object may tilt from its initial orientation during a move."""

    object: str
    lean: float

    def __post_init__(self) -> None:
        require(0 < self.lean < np.pi / 2, f"lean is {self.lean:g} rad, it must be above 0 and below pi / 2")

    def constraints(self, scene: PlanningScene) -> Constraints:
        """Return path constraints that keep the held object upright during a move: the object axis that is
        nearest to vertical must stay vertical.
        """
        R = scene.object(self.object).T_world_object.rotation.matrix
        k = int(np.argmax(np.abs(R[2])))
        axis, up = R[:, k], np.array([0.0, 0.0, np.sign(R[2, k])])
        across = np.cross(axis, up)
        sine = float(np.linalg.norm(across))
        turn = SO3.exp(across / sine * np.arctan2(sine, axis @ up)) if sine > 1e-9 else SO3.identity()
        tolerance = [self.lean / np.sqrt(2)] * 3  # two axes together: at most `lean`
        tolerance[k] = np.pi
        x, y, z = tolerance
        return Constraints(orientations=(OrientationConstraint(turn @ SO3(R), (x, y, z), link=self.object),))


@stage_types.register("connect")
@dataclass(frozen=True, eq=False)
class Connect:
    """Stage that moves the arm without collision to a goal, or to the joint positions `data[target]`."""

    name: str
    group: str
    speed: Speed
    target: str | None = None
    goal: Goal | None = None
    upright: UprightConstraint | None = None  # limits the tilt of a carried object

    @property
    def requires(self) -> tuple[str, ...]:
        return () if self.goal is not None else (self.target or "a goal",)

    def propose(self, solution: PartialSolution, planning: SearchState) -> Iterator[PartialSolution]:
        names = solution.scene.model.group(self.group).joint_names
        goal = self.goal or JointGoal(JointState(names, solution.data[self.target or ""]))
        seconds = min(planning.settings.planning_time, planning.time_left)
        request = PlanRequest(
            self.group, (goal,), planner_id=planning.settings.planner_id,
            planning_time=max(seconds, 0.01), velocity_scaling=self.speed.velocity,
            acceleration_scaling=self.speed.acceleration, seed=planning.seed,
            path_constraints=self.upright.constraints(solution.scene) if self.upright else Constraints(),
        )  # fmt: skip
        result, last = _planned(solution.scene, request, planning)
        yield from with_motion(solution, planning, self.name, result, result, asked=_asked(last, goal))


def _asked(request: PlanRequest, goal: Goal) -> dict[str, Any]:
    """Return the planning request of a move stage as data that a record can store."""
    return {
        "goal": goal_data(goal), "planner_id": request.planner_id, "seed": request.seed,
        "attempts": request.attempts, "planning_time_limit_s": request.planning_time,
    }  # fmt: skip


def goal_data(goal: Goal) -> Any:
    """Return the goal of a move stage as data that a record can store."""
    match goal:
        case NamedGoal():
            return goal.name
        case JointGoal():
            return dict(zip(goal.state.joint_names, goal.state.positions.tolist()))
        case PoseGoal():
            return {"link": goal.link, "T_world_link": goal.T_world_link}
        case _:
            return str(goal)


def _planned(
    scene: PlanningScene, request: PlanRequest, planning: SearchState
) -> tuple[PlanResult, PlanRequest]:
    """Plan the motion of a stage. After a timeout, retry with another seed while enough of the requested CPU
    time is left. Return the last result and the request that produced it.

    Planners stop by the wall clock, which also runs while other programs use the CPU. The remaining CPU time
    is therefore used for further attempts with other seeds.
    """
    began, last = time.thread_time(), request
    result = plan(scene, request, planning.cancel)
    for again in range(1, MOST_AGAIN):
        left = request.planning_time - (time.thread_time() - began)
        if result.code is not ErrorCode.TIMED_OUT or left < LEAST_LEFT * request.planning_time:
            break
        seed = request.seed + again * SEED_STEP
        last = replace(request, planning_time=left, seed=seed)
        result = plan(scene, last, planning.cancel)
    return result, last


@stage_types.register("straight")
@dataclass(frozen=True, eq=False)
@checked()
class MoveStraight:
    """Stage that moves the tip along a straight line from its present pose."""

    name: str
    group: str
    link: str
    speed: Speed
    offset: tuple[float, float, float]  # [m]
    in_tip_frame: bool = False
    allow: tuple[tuple[str, tuple[str, ...]], ...] = ()  # contacts allowed during this motion only
    least: float | None = None  # [m] minimum length, if the arm does not reach farther; None: the full offset

    def propose(self, solution: PartialSolution, planning: SearchState) -> Iterator[PartialSolution]:
        scene = with_contacts(solution.scene, self.allow)
        start, distance = scene.frame_pose(self.link), float(np.linalg.norm(self.offset))

        def over(length: float) -> PlanResult:
            x, y, z = np.asarray(self.offset) * (length / distance)
            target = shifted(start, (x, y, z), self.in_tip_frame)
            result = plan_straight(scene, self.group, self.link, target, self.speed)
            if length < distance and result.ok and _ends_in_contact(solution.scene, result):
                what = ", ".join(body for body, _ in self.allow)
                text = f"after {1000 * length:.0f} of {1000 * distance:.0f} mm, {what} is still in contact"
                return replace(result, code=ErrorCode.GOAL_IN_COLLISION, message=text)
            return result

        least = distance if self.least is None else self.least
        result = plan_within_reach(over, distance, least)
        yield from with_motion(solution, planning, self.name, result, planned_in=scene)


def _ends_in_contact(scene: PlanningScene, result: PlanResult) -> bool:
    """Return whether the motion of a move stage ends in contact, so that the next motion cannot start. For
    example, the open hand may still surround the object.
    """
    assert result.trajectory is not None
    end = result.trajectory.end
    checker = KernelChecker(scene.with_state(end), end.joint_names)
    return not checker.is_free(np.asarray(end.positions))


@stage_types.register("run_steps")
@dataclass(frozen=True, eq=False)
class RunSteps:
    """Stage that appends given steps without planning a move."""

    name: str
    steps: tuple[Step, ...]

    def propose(self, solution: PartialSolution, planning: SearchState) -> Iterator[PartialSolution]:
        yield solution.then(*self.steps)


def plan_straight(scene: PlanningScene, group: str, link: str, target: SE3, speed: Speed) -> PlanResult:
    request = CartesianRequest(
        group, (target,), link, velocity_scaling=speed.velocity, acceleration_scaling=speed.acceleration
    )
    result = plan_cartesian(scene, request)
    return replace(result, evidence={"goal": goal_data(PoseGoal(target, link)), **result.evidence})


def plan_within_reach(
    over: Callable[[float], PlanResult], distance: float, least: float, around_obstacles: bool = False
) -> PlanResult:
    """Plan the straight move of a stage over a distance [m]. If the arm cannot move that far, plan it over
    nearly the distance that the arm can move, and if that fails, over the distance `least`.

    Args:
        over: plans the motion over a given length [m].
        around_obstacles: whether the motion may also end before an obstacle that blocks the full distance.
    """
    result = over(distance)
    for shorter in (WITHIN_REACH * result.fraction * distance, least):
        blocked = result.evidence.get("cause") == COLLISION and not around_obstacles
        if not result.ok and not blocked and least <= shorter < distance:
            result = over(shorter)
    return result


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


def with_motion(
    solution: PartialSolution, planning: SearchState, name: str, result: PlanResult,
    outcome: Outcome | None = None, planned_in: PlanningScene | None = None,
    asked: Mapping[str, Any] = MappingProxyType({}), kind: Callable[..., Motion] = Motion,
) -> Iterator[PartialSolution]:  # fmt: skip
    """Append the planned motion of the arm to a partial solution, and yield the result. If planning has
    failed, yield nothing and reject the candidate.

    Args:
        outcome: result of a motion from the robot's present state, for its code. Omit it for a motion from a
            candidate's state: a collision at such a start must not end the whole search.
        planned_in: the scene with the contacts allowed during this motion, if there are any.
        asked: data of the request, for the record.
        kind: the step that executes the motion.
    """
    trajectory = result.trajectory
    if not result.ok or trajectory is None:
        planning.reject(name, solution.data.get("candidate", ""), result.message, outcome)
        return
    scene = solution.scene if planned_in is None else planned_in
    motion = kind(
        name, trajectory, result.planner_id, result.planning_time, result.min_clearance, scene,
        {**asked, **result.evidence},
    )  # fmt: skip
    yield solution.then(motion, scene=solution.scene.with_state(trajectory.end))


__all__ = [
    "Connect",
    "MoveStraight",
    "NamedGoal",
    "RunSteps",
    "UprightConstraint",
    "plan_straight",
    "plan_within_reach",
    "shifted",
    "with_contacts",
    "with_motion",
]
