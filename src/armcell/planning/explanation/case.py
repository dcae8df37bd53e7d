"""One failed request while it is looked into: what is asked of it, and what has been found so far."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armcell.collision.kernel.checker import KernelChecker
from armcell.core import ArmcellError, Contact, Explanation, JointState, PlanRequest, PlanResult, Suggestion
from armcell.core.explanation import Change
from armcell.kinematics import kinematic_tree
from armcell.planning.explanation.changes import Request
from armcell.planning.explanation.nearest import nearest_free
from armcell.scene import PlanningScene

Array = NDArray[np.float64]
Solve = Callable[[PlanningScene, Any], PlanResult]

TRY = 2.0  # [s] of planning that a changed request gets at most
SPARE = 2e-3  # [m] from objects that the nearest free configuration should have
CLOSE_TO_LIMIT = np.deg2rad(5.0)


@dataclass(eq=False)
class Case:
    """A failed request.

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

    # --- what was asked ---
    @cached_property
    def started(self) -> PlanningScene:
        """The scene with the robot at the request's start."""
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
        """(n,) of the group."""
        return self.started.positions[self.columns]

    @cached_property
    def checker(self) -> KernelChecker:
        """Of the start's scene, its paddings relaxed as the planner relaxes them."""
        checker = KernelChecker(self.started, self.joint_names)
        if np.isfinite(self.start).all() and not checker.touches(self.start):
            checker.relax_margins(self.start)
        return checker

    def nearest_free(self, q: Array) -> Array | None:
        """The nearest free configuration (n,): with a little room to spare where there is any."""
        lower, upper = self.scene.model.lower[self.columns], self.scene.model.upper[self.columns]
        roomy = self.started.with_padding(
            self.scene.padding + SPARE, {k: v + SPARE for k, v in self.scene.link_padding.items()}
        )
        for checker in (KernelChecker(roomy, self.joint_names), self.checker):
            found = nearest_free(q, checker.is_free, lower, upper, seed=1)
            if found is not None:
                return found
        return None

    def tip_way(self, a: Array, b: Array) -> float | None:
        """How far [m] the group's tip is moved between two configurations (n,); None: it has no tip."""
        tip = self.scene.model.group(self.request.group).tip_link
        if tip is None:
            return None
        tree, full = kinematic_tree(self.scene.model), self.started.positions.copy()
        poses = []
        for q in (a, b):
            full[self.columns] = q
            poses.append(tree.link_pose(full, tip))
        return poses[0].distance_to(poses[1])[0]

    @cached_property
    def rng(self) -> np.random.Generator:
        return np.random.default_rng([getattr(self.request, "seed", 0), 2])

    def group_state(self, q: Array) -> JointState:
        return JointState(self.joint_names, q)

    # --- what was found ---
    @property
    def time_left(self) -> float:
        return self.deadline - time.monotonic()

    def say(self, line: str) -> None:
        if line not in self.details:
            self.details.append(line)

    def succeeds(self, scene: PlanningScene, request: Request, seconds: float = TRY) -> PlanResult | None:
        """The result of a changed request, or None: it failed, is misuse, or there is no time left."""
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
        """Try a change, and keep it as a suggestion if the request then succeeds (or nothing could be tried).

        Args:
            known: that it works was just seen.
            anyway: keep it even if the request still fails: without it, it cannot work.
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
        """What was found; the suggestions that work first, otherwise in the order they were found."""
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


def tell_margins(case: Case) -> None:
    """How far the joints of the start are from their limits; those that are close are told."""
    model, q = case.scene.model, case.start
    margins = np.minimum(q - model.lower[case.columns], model.upper[case.columns] - q)
    case.data["start_limit_margins"] = dict(zip(case.joint_names, margins.tolist(), strict=True))
    near = [
        f"{name} {np.rad2deg(m):.1f} deg"
        for name, m in zip(case.joint_names, margins, strict=True)
        if 0 <= m < CLOSE_TO_LIMIT and model.joint(name).type != "prismatic"
    ]
    if near:
        case.say(f"at the start close to a joint limit: {', '.join(near)}")


def tell_way(case: Case, what: str, a: Array, b: Array) -> None:
    """How far apart two configurations (n,) are, and how far the tip goes between them."""
    tip = case.tip_way(a, b)
    moved = f", which moves the tip by {tip * 1000:.0f} mm" if tip is not None else ""
    case.say(f"{what} is {np.linalg.norm(b - a):.2f} rad away{moved}")
