"""Interface of all planners: their input (Problem) and their result (PlannerResult)."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armcell.collision.kernel.checker import KernelChecker
from armcell.model import RobotModel

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SpaceOptions:
    """Options of a planning problem that concern the search space rather than the planner."""

    longest_valid_segment_fraction: float | None = None  # check step: share of the space's extent
    projection_evaluator: tuple[str, ...] = ()  # joints whose values span the cells of (B)KPIECE
    simplify_solutions: bool = True


@dataclass(frozen=True, eq=False)
class Problem:
    """Planning problem that every planner receives: a start (n,), goals (n,), bounds, a collision checker and
    a deadline.
    """

    checker: KernelChecker
    start: Array
    goals: tuple[Array, ...]
    lower: Array  # finite sampling bounds
    upper: Array
    seed: int
    deadline: float  # [s] on the clock of time.monotonic()
    cancel: threading.Event = field(default_factory=threading.Event)
    more_goals: Iterator[Array] | None = None  # further goals (n,), computed on demand
    options: SpaceOptions = SpaceOptions()
    settings: Any = None  # settings from `planner_settings`
    forbids: Callable[[Array], bool] | None = None  # forbids free positions (n,); only OMPL's planners use it
    began: float = field(default_factory=time.monotonic)  # [s] of time.monotonic()

    @property
    def stopped(self) -> bool:
        """Whether a planner must stop working on the problem, because the request is canceled or its time is
        up.
        """
        return self.cancel.is_set() or time.monotonic() > self.deadline

    @property
    def joint_names(self) -> tuple[str, ...]:
        return self.checker.joint_names


@dataclass(frozen=True, eq=False)
class PlannerResult:
    """Result of a planner for a planning problem: waypoints (k, n) from the start to a goal, or None with a
    message.
    """

    waypoints: Array | None
    message: str = ""
    statistics: dict[str, Any] = field(default_factory=dict)
    simplified: bool = False


Planner = Callable[[Problem], PlannerResult]


def sampling_bounds(
    model: RobotModel, joint_names: tuple[str, ...], start: Array, goals: Sequence[Array]
) -> tuple[Array, Array]:
    """Compute the lower and upper bounds (n,) between which planners sample joint positions for a planning
    problem.

    The bounds are the joint limits, or one turn around start and goals for joints with wider limits.
    """
    columns = model.columns(joint_names)
    low, high = model.lower[columns], model.upper[columns]
    points = np.vstack([start, *goals])
    near_low, near_high = points.min(0) - np.pi / 2, points.max(0) + np.pi / 2
    wide = ~np.isfinite(high - low) | (high - low > 2 * np.pi)
    return (
        np.where(wide, np.maximum(low, near_low), np.minimum(low, points.min(0))),
        np.where(wide, np.minimum(high, near_high), np.maximum(high, points.max(0))),
    )
