"""A request, checked: what is asked, in which scene, of which planner, until when."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from armcell.core import ConstraintGoal, InputError, Outcome, PlanRequest, PlanResult
from armcell.planning import planners as _registered  # noqa: F401  (fills the registry)
from armcell.planning.problem import Planner, find_planner, normalized_planner_id
from armcell.scene import PlanningScene
from armcell.timing import check_scaling


@dataclass(frozen=True, eq=False)
class Question:
    """One call of `plan`, free of misuse. Request adapters return a changed copy."""

    scene: PlanningScene  # at the start of the request
    request: PlanRequest
    planner: Planner
    planner_id: str
    joint_names: tuple[str, ...]  # of the group
    began: float  # [s] of time.monotonic()
    cancel: threading.Event
    evidence: Mapping[str, Any] = field(default_factory=dict)  # what adapters report; ends up in the result

    @property
    def deadline(self) -> float:
        """[s] of time.monotonic()"""
        return self.began + self.request.planning_time

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
        InputError: unknown group, pipeline, planner or joint; a number that is impossible.
    """
    began = time.monotonic()
    check_scaling(request.velocity_scaling, "velocity scaling")
    check_scaling(request.acceleration_scaling, "acceleration scaling")
    if not (np.isfinite(request.planning_time) and request.planning_time > 0):
        raise InputError(f"planning_time is {request.planning_time:g} s, it must be positive")
    if any(isinstance(goal, ConstraintGoal) for goal in request.goals):
        raise InputError("constraints are not planned with yet")
    if request.path_constraints:
        raise InputError("constraints are not planned with yet")
    planner_id = normalized_planner_id(request.planner_id)
    planner = find_planner(request.pipeline_id, planner_id)
    group = scene.model.group(request.group)
    if not group.joint_names:
        raise InputError(f"group {request.group!r} has no joints")
    if request.start is not None:  # an unknown joint in it is misuse and raises
        scene = replace(scene, positions=scene.state.updated(request.start).positions)
    return Question(
        scene, request, planner, planner_id, group.joint_names, began, cancel or threading.Event()
    )
