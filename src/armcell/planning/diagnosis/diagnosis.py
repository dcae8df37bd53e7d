"""Diagnosis of one failed planning request: inputs, findings and tested suggestions."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armcell.collision.kernel.checker import KernelChecker
from armcell.core import (
    ArmcellError,
    Contact,
    Explanation,
    InputError,
    JointGoal,
    JointState,
    NamedGoal,
    PlanRequest,
    PlanResult,
    Suggestion,
)
from armcell.core.results import Change
from armcell.kinematics import kinematic_tree
from armcell.planning.diagnosis.changes import Request
from armcell.planning.diagnosis.nearest_free import nearest_free
from armcell.scene import PlanningScene

Array = NDArray[np.float64]
Solve = Callable[[PlanningScene, Any], PlanResult]
TRY = 2.0  # [s] planning time limit of a changed request
SPARE = 2e-3  # [m] wanted distance of the nearest free configuration from objects
CLOSE_TO_LIMIT = np.deg2rad(5.0)


@dataclass(eq=False)
class Diagnosis:
    """Diagnosis of a failed planning request, which collects findings and suggestions.

    Attributes:
        solvers: the planning function for each kind of request.
        deadline: [s] of time.monotonic(); no further attempt begins after it.
    """

    scene: PlanningScene
    request: Request
    result: PlanResult
    solvers: Mapping[type, Solve]
    deadline: float
    details: list[str] = field(default_factory=list)
    suggestions: list[Suggestion] = field(default_factory=list)
    contacts: list[Contact] = field(default_factory=list)
    state: JointState | None = None
    nearest: JointState | None = None
    data: dict[str, Any] = field(default_factory=dict)

    # --- request ---
    @cached_property
    def start_scene(self) -> PlanningScene:
        """Scene for a diagnosis, in which the robot is at the start of the failed request."""
        if self.request.start is None:
            return self.scene
        positions = self.scene.state.updated(self.request.start).positions
        return replace(self.scene, positions=positions)

    @cached_property
    def joint_names(self) -> tuple[str, ...]:
        return self.scene.model.group(self.request.group).joint_names

    @cached_property
    def columns(self) -> list[int]:
        return self.scene.model.columns(self.joint_names)

    @property
    def start(self) -> Array:
        """Positions (n,) of the group's joints at the start of the diagnosed request."""
        return self.start_scene.positions[self.columns]

    @cached_property
    def checker(self) -> KernelChecker:
        """Collision checker of a diagnosis, for the scene in which the failed request starts. If the start
        state is within the padding, the checker reduces the padding, as the planner does.
        """
        checker = KernelChecker(self.start_scene, self.joint_names)
        if np.isfinite(self.start).all() and not checker.touches(self.start):
            checker.relax_margins(self.start)
        return checker

    def nearest_free(self, q: Array) -> Array | None:
        """Find a configuration (n,) that a diagnosis can suggest in place of q: the nearest one that is
        collision-free, with a small margin if possible.
        """
        lower, upper = self.scene.model.lower[self.columns], self.scene.model.upper[self.columns]
        roomy = self.start_scene.with_padding(
            self.scene.padding + SPARE, {k: v + SPARE for k, v in self.scene.link_padding.items()}
        )
        for checker in (KernelChecker(roomy, self.joint_names), self.checker):
            found = nearest_free(q, checker.is_free, lower, upper, seed=1)
            if found is not None:
                return found
        return None

    def tip_distance(self, a: Array, b: Array) -> float | None:
        """Measure for a diagnosis the distance [m] between the tip's positions at two configurations a and b
        (n,) of the planning group.

        Return None if the group has no tip.
        """
        tip = self.scene.model.group(self.request.group).tip_link
        if tip is None:
            return None
        tree, full = kinematic_tree(self.scene.model), self.start_scene.positions.copy()
        poses = []
        for q in (a, b):
            full[self.columns] = q
            poses.append(tree.link_pose(full, tip))
        return poses[0].distance_to(poses[1])[0]

    @cached_property
    def rng(self) -> np.random.Generator:
        return np.random.default_rng([getattr(self.request, "seed", 0), 2])

    def group_state(self, q: Array) -> JointState:
        """Create a JointState for the planning group of a diagnosed request from the group's joint positions
        q (n,).
        """
        return JointState(self.joint_names, q)

    # --- findings ---
    @property
    def time_left(self) -> float:
        """Time [s] that a diagnosis has left for further planning attempts."""
        return self.deadline - time.monotonic()

    def add_finding(self, line: str) -> None:
        """Add a finding to a diagnosis, unless the diagnosis already contains it."""
        if line not in self.details:
            self.details.append(line)

    def succeeds(self, scene: PlanningScene, request: Request, seconds: float = TRY) -> PlanResult | None:
        """Plan a changed request, to test whether a diagnosis can suggest the change. Return the result, or
        None if planning fails, the request is invalid, or no time is left.
        """
        if self.time_left <= 0:
            return None
        if isinstance(request, PlanRequest):
            request = replace(request, planning_time=min(request.planning_time, seconds))
        try:
            result = self.solvers[type(request)](scene, request)
        except ArmcellError:
            return None
        return result if result.ok else None

    def suggest(
        self, text: str, change: Change, arguments: Mapping[str, Any] = {}, effort: float = 0.0,
        known: bool = False,
        anyway: bool = False,
    ) -> bool:  # fmt: skip
        """Test whether a change makes the diagnosed request succeed, and if so add it to the suggestions.

        Args:
            known: a test has already shown that the change works.
            anyway: keep the suggestion even if the request still fails, because the change is necessary.
        """
        suggestion = Suggestion(text, change, arguments, effort)
        if known:
            works = True
        elif self.time_left <= 0:
            works = None
        else:
            try:
                works = self.succeeds(*suggestion.apply(self.scene, self.request)) is not None
            except ArmcellError:
                works = False
        if works is False and not anyway:
            self.data.setdefault("tried_without_success", []).append(text)
            return False
        self.suggestions.append(replace(suggestion, works=works))
        return works is not False

    def explanation(self) -> Explanation:
        """Create the explanation of a failed request from the findings and suggestions of its diagnosis.

        Working suggestions come first, otherwise in the order found.
        """
        ordered = sorted(self.suggestions, key=lambda s: not s.works)
        summary = self.result.message or self.result.code.name
        if ordered and ordered[0].works:
            summary += f"; it would work to {ordered[0].text}"
        return Explanation(
            self.result.code,
            summary,
            tuple(self.details),
            tuple(ordered),
            tuple(self.contacts),
            self.state,
            self.nearest,
            self.data,
        )


def report_limit_margins(diagnosis: Diagnosis) -> None:
    """Report in a diagnosis which joints are close to a limit at the start of the failed request."""
    model, q = diagnosis.scene.model, diagnosis.start
    margins = np.minimum(q - model.lower[diagnosis.columns], model.upper[diagnosis.columns] - q)
    diagnosis.data["start_limit_margins"] = dict(zip(diagnosis.joint_names, margins.tolist(), strict=True))
    near = [
        f"{name} {np.rad2deg(m):.1f} deg"
        for name, m in zip(diagnosis.joint_names, margins, strict=True)
        if 0 <= m < CLOSE_TO_LIMIT and model.joint(name).type != "prismatic"
    ]
    if near:
        diagnosis.add_finding(f"at the start close to a joint limit: {', '.join(near)}")


def report_distance(diagnosis: Diagnosis, what: str, a: Array, b: Array) -> None:
    """Report in a diagnosis how much two configurations (n,) differ, and how far the tip moves between
    them.
    """
    tip = diagnosis.tip_distance(a, b)
    moved = f", which moves the tip by {tip * 1000:.0f} mm" if tip is not None else ""
    diagnosis.add_finding(f"{what} is {np.linalg.norm(b - a):.2f} rad away{moved}")


def wanted_joints(diagnosis: Diagnosis, goal: JointGoal | NamedGoal) -> np.ndarray | None:
    """Return, for a diagnosis, the group's joint positions (n,) at a joint goal or named goal, even if they
    violate joint limits.

    Return None for misuse.
    """
    model = diagnosis.scene.model
    try:
        state = (
            model.named_state(diagnosis.request.group, goal.name)
            if isinstance(goal, NamedGoal)
            else goal.state
        )
        return diagnosis.start_scene.state.updated(state).reindexed(diagnosis.joint_names).positions
    except InputError:
        return None
