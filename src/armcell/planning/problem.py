"""What a planner is given and what it answers."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from armcell.collision import ExactChecker
from armcell.core import Registry

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Problem:
    """One start, one or more goals (n,) in the joint space of a group, and what is free."""

    checker: ExactChecker
    start: Array
    goals: tuple[Array, ...]
    lower: Array  # bounds to sample in, finite
    upper: Array
    seed: int
    deadline: float  # [s] of time.monotonic()
    cancel: threading.Event = field(default_factory=threading.Event)

    @property
    def stopped(self) -> bool:
        return self.cancel.is_set() or time.monotonic() > self.deadline

    @property
    def joint_names(self) -> tuple[str, ...]:
        return self.checker.joint_names


@dataclass(frozen=True, eq=False)
class Answer:
    """Waypoints (k, n) from the start to a goal, or None with the reason."""

    waypoints: Array | None
    message: str = ""
    statistics: dict[str, float] = field(default_factory=dict)


Planner = Callable[[Problem], Answer]
planners: Registry[Planner] = Registry("planner")


def normalized_planner_id(planner_id: str) -> str:
    """MoveIt's spellings in one: `geometric::RRTConnect`, `RRTConnectkConfigDefault`, `arm[RRTConnect]`."""
    name = planner_id.strip()
    if name.endswith("]") and "[" in name:
        name = name[name.index("[") + 1 : -1]
    return name.removeprefix("geometric::").removesuffix("kConfigDefault") or "RRTConnect"


def edge_is_free(checker: ExactChecker, a: Array, b: Array, step: float) -> bool:
    """Whether the straight motion from a to b is free at samples at most `step` [rad] apart (b included)."""
    count = max(int(np.ceil(np.max(np.abs(b - a)) / step)), 1)
    # Middle first, then quarters: a blocked motion is usually found early.
    order = sorted(range(1, count + 1), key=lambda k: (-(k & -k), k))
    return all(checker.is_free(a + (b - a) * (k / count)) for k in order)
