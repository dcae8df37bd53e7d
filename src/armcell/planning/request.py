"""Validation of a planning request: checks for misuse, and the workspace limits of the tip."""

from __future__ import annotations

import itertools
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

import armcell.planning.planners  # noqa: F401  (registers the planners)
from armcell.core import ConstraintGoal, InputError, JointGoal, Outcome, PlanRequest, PlanResult, PoseGoal
from armcell.planning.constraints.constraint_validation import check_constraints
from armcell.planning.moved_frame import MovedFrame, check_cartesian_speed
from armcell.planning.planners.planner_configs import PlannerChoice, choose_planner
from armcell.planning.planners.registry import first_use_hooks
from armcell.scene import PlanningScene
from armcell.timing import check_scaling

Array = NDArray[np.float64]

STEP = 0.02  # [rad] between workspace checks along a motion


class Workspace:
    """Workspace of a planning request: a box in the world frame that the tip of the planning group must not
    leave.

    Raises:
        InputError: not two corners; the low corner is not below the high corner; the group has no tip.
    """

    def __init__(self, scene: PlanningScene, request: PlanRequest):
        corners = np.asarray(request.workspace, dtype=float)
        if corners.shape != (2, 3) or np.any(np.isnan(corners)):
            raise InputError("the workspace needs a low and a high corner, three numbers [m] each")
        if np.any(corners[0] >= corners[1]):
            axis = "xyz"[int(np.argmax(corners[0] >= corners[1]))]
            raise InputError(f"the workspace is empty: along {axis} its low corner is not below the high one")
        self.low, self.high = corners
        self.tip = MovedFrame(scene, request.group)

    def excess(self, q: ArrayLike) -> float:
        """Return how far [m] the tip is outside the workspace box of a request at joint positions q (n,). The
        result is 0 if the tip is inside.
        """
        at = self.tip.pose(q).translation
        return float(np.linalg.norm(np.maximum(np.maximum(self.low - at, at - self.high), 0.0)))

    def describe(self, q: ArrayLike) -> str:
        """Describe how far the tip is outside the workspace that a planning request allows, at joint
        positions q (n,).
        """
        low, high, at = (
            ", ".join(f"{v:.3g}" for v in p) for p in (self.low, self.high, self.tip.pose(q).translation)
        )
        return (
            f"{self.tip.name} at ({at}) is {self.excess(q) * 1000:.0f} mm outside the workspace "
            f"from ({low}) to ({high})"
        )

    def first_outside(self, positions: ArrayLike) -> Array | None:
        """Return the first joint positions (n,) of a motion (k, n) at which the tip is outside the workspace
        of the request.

        The result is None if the tip stays in the workspace.
        """
        points = np.asarray(positions, dtype=float)
        for a, b in itertools.pairwise(points):
            for t in np.linspace(
                0.0, 1.0, max(int(np.ceil(np.max(np.abs(b - a)) / STEP)), 1), endpoint=False
            ):
                if self.excess(a + t * (b - a)) > 0.0:
                    return a + t * (b - a)
        return points[-1] if self.excess(points[-1]) > 0.0 else None


@dataclass(frozen=True, eq=False)
class ValidatedRequest:
    """Planning request that has passed validation, together with its scene, planner and deadline.

    Adapters return changed copies of the request.
    """

    scene: PlanningScene  # at the start of the request
    request: PlanRequest
    choice: PlannerChoice  # the planner and its settings
    joint_names: tuple[str, ...]  # joints of the group
    began: float  # [s] of time.monotonic()
    cancel: threading.Event
    adapters: tuple[str, ...] = ()  # armcell's names of the adapters
    workspace: Workspace | None = None
    lead_in: Array | None = None  # (k, n): from the robot's actual state to the planning start
    evidence: Mapping[str, Any] = field(default_factory=dict)  # reports of adapters, copied to the result

    @property
    def planner_id(self) -> str:
        return self.choice.planner_id

    @property
    def deadline(self) -> float:
        """Time [s, time.monotonic()] by which planning of a validated request must end."""
        return self.began + self.request.planning_time

    def forbids(self, q: Array) -> str:
        """Return the reason why a validated request forbids joint positions q (n,) although they are
        collision-free, or "" if it allows them.
        """
        if self.workspace is not None and self.workspace.excess(q) > 0.0:
            return self.workspace.describe(q)
        return ""

    def failed(self, outcome: Outcome) -> PlanResult:
        """Create the PlanResult of a validated planning request that failed with the given outcome."""
        return PlanResult(
            outcome.code,
            outcome.message,
            {**self.evidence, **outcome.evidence},
            planner_id=self.planner_id,
            planning_time=time.monotonic() - self.began,
        )


def validate_request(
    scene: PlanningScene, request: PlanRequest, cancel: threading.Event | None = None
) -> ValidatedRequest:
    """Check a planning request for errors before any computation.
    Return it together with its scene, planner and deadline.

    Raises:
        InputError: unknown group, pipeline, planner, parameter, joint, link or frame; an impossible number.
    """
    check_scaling(request.velocity_scaling, "velocity scaling")
    check_scaling(request.acceleration_scaling, "acceleration scaling")
    check_cartesian_speed(request.max_cartesian_speed)
    if not (np.isfinite(request.planning_time) and request.planning_time > 0):
        raise InputError(f"planning_time is {request.planning_time:g} s, it must be positive")
    if not (np.isfinite(request.arm_clearance) and request.arm_clearance >= 0):
        raise InputError(f"arm_clearance is {request.arm_clearance:g} m, it must be at least 0")
    if request.attempts != int(request.attempts) or request.attempts < 1:
        raise InputError(f"attempts is {request.attempts}, it must be a whole number, at least 1")
    group = scene.model.group(request.group)
    choice = choose_planner(request)
    if choice.timeout is not None:
        request = replace(request, planning_time=min(request.planning_time, choice.timeout))
    if choice.planner in first_use_hooks:
        first_use_hooks[choice.planner]()
    began = time.monotonic()
    if not group.joint_names:
        raise InputError(f"group {request.group!r} has no joints")
    if request.start is not None:  # raises if the start has an unknown joint
        scene = replace(scene, positions=scene.state.updated(request.start).positions)
    if request.max_cartesian_speed is not None:
        MovedFrame(scene, request.group, request.speed_link)
    for goal in request.goals:
        _check_goal(scene, request, goal)
    workspace = None if request.workspace is None else Workspace(scene, request)
    return ValidatedRequest(
        scene, request, choice, group.joint_names, began, cancel or threading.Event(), workspace=workspace
    )


def _check_goal(scene: PlanningScene, request: PlanRequest, goal: Any) -> None:
    if isinstance(goal, ConstraintGoal):
        if not goal.constraints:
            raise InputError(
                "a constraint goal asks nothing",
                hint="give it joints, positions, orientations or visibilities",
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
