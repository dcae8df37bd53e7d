"""A request, checked: what is asked, in which scene, of which planner, until when."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armcell.core import ConstraintGoal, InputError, JointGoal, Outcome, PlanRequest, PlanResult, PoseGoal
from armcell.planning import planners as _registered  # noqa: F401  (fills the registry)
from armcell.planning.constraint_sense import check_constraints
from armcell.planning.placed import Placed
from armcell.planning.planner_configs import Choice, choose
from armcell.planning.problem import first_uses
from armcell.planning.speed import check_speed
from armcell.planning.workspace import Workspace
from armcell.scene import PlanningScene
from armcell.timing import check_scaling

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Question:
    """One call of `plan`, free of misuse. Request adapters return a changed copy."""

    scene: PlanningScene  # at the start of the request
    request: PlanRequest
    choice: Choice  # of a planner
    joint_names: tuple[str, ...]  # of the group
    began: float  # [s] of time.monotonic()
    cancel: threading.Event
    adapters: tuple[str, ...] = ()  # by our names
    workspace: Workspace | None = None
    lead_in: Array | None = None  # (k, n): from where the robot is to the start that planning begins at
    evidence: Mapping[str, Any] = field(default_factory=dict)  # what adapters report; ends up in the result

    @property
    def planner_id(self) -> str:
        return self.choice.planner_id

    @property
    def deadline(self) -> float:
        """[s] of time.monotonic()"""
        return self.began + self.request.planning_time

    def forbids(self, q: Array) -> str:
        """Why positions q (n,), though free, may not be used; empty where they may."""
        if self.workspace is not None and self.workspace.excess(q) > 0.0:
            return self.workspace.describe(q)
        return ""

    def failed(self, outcome: Outcome) -> PlanResult:
        """The answer without a motion."""
        return PlanResult(
            outcome.code,
            outcome.message,
            {**self.evidence, **outcome.evidence},
            planner_id=self.planner_id,
            planning_time=time.monotonic() - self.began,
        )


def ask(scene: PlanningScene, request: PlanRequest, cancel: threading.Event | None = None) -> Question:
    """Check a request for misuse, before anything is computed.

    Raises:
        InputError: unknown group, pipeline, planner, parameter, joint, link or frame; an impossible number.
    """
    check_scaling(request.velocity_scaling, "velocity scaling")
    check_scaling(request.acceleration_scaling, "acceleration scaling")
    check_speed(request.max_cartesian_speed)
    if not (np.isfinite(request.planning_time) and request.planning_time > 0):
        raise InputError(f"planning_time is {request.planning_time:g} s, it must be positive")
    if not (np.isfinite(request.arm_clearance) and request.arm_clearance >= 0):
        raise InputError(f"arm_clearance is {request.arm_clearance:g} m, it must be at least 0")
    if request.attempts != int(request.attempts) or request.attempts < 1:
        raise InputError(f"attempts is {request.attempts}, it must be a whole number, at least 1")
    group = scene.model.group(request.group)
    choice = choose(request)
    if choice.planner in first_uses:
        first_uses[choice.planner]()
    began = time.monotonic()
    if not group.joint_names:
        raise InputError(f"group {request.group!r} has no joints")
    if request.start is not None:  # an unknown joint in it is misuse and raises
        scene = replace(scene, positions=scene.state.updated(request.start).positions)
    if request.max_cartesian_speed is not None:
        Placed(scene, request.group, request.speed_link)
    for goal in request.goals:
        _check_goal(scene, request, goal)
    workspace = None if request.workspace is None else Workspace(scene, request)
    return Question(
        scene, request, choice, group.joint_names, began, cancel or threading.Event(), workspace=workspace
    )


def _check_goal(scene: PlanningScene, request: PlanRequest, goal: Any) -> None:
    if isinstance(goal, ConstraintGoal):
        if not goal.constraints:
            raise InputError(
                "a constraint goal asks nothing",
                cure="give it joints, positions, orientations or visibilities",
            )
        check_constraints(scene, request.group, goal.constraints)
    elif isinstance(goal, JointGoal):
        _check_tolerance("joint goal's", goal.tolerance, (1,))
    elif isinstance(goal, PoseGoal):
        _check_tolerance("pose goal's position", goal.position_tolerance, (1,))
        _check_tolerance("pose goal's orientation", goal.orientation_tolerance, (1, 3))


def _check_tolerance(what: str, value: Any, sizes: tuple[int, ...]) -> None:
    if isinstance(value, float) and value >= 0:
        return
    numbers = np.atleast_1d(np.asarray(value, dtype=float))
    if numbers.ndim != 1 or len(numbers) not in sizes or np.any(np.isnan(numbers)) or np.any(numbers < 0):
        many = " or ".join(str(size) for size in sizes)
        raise InputError(f"a {what} tolerance is {value!r}, {many} number(s) not below zero are needed")
