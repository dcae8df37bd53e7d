"""Results of requests: code, message and evidence."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armcell.core.contact import Contact
from armcell.core.errors import ErrorCode
from armcell.core.explanation import Explanation
from armcell.core.joints import JointPath, JointTrajectory

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Outcome:
    """Base class of results: an error code, a one-line message, and named evidence."""

    code: ErrorCode
    message: str = ""
    evidence: dict[str, Any] = field(default_factory=dict)
    explainer: Callable[[float], Explanation] | None = field(
        default=None, repr=False, compare=False, kw_only=True
    )

    @property
    def ok(self) -> bool:
        return self.code is ErrorCode.SUCCESS

    def explain(self, seconds: float = 10.0) -> Explanation:
        """Explain a failed result and suggest changes that would help.
        The search for changes takes about the given number of seconds.

        Without a diagnosis for the kind of request, the explanation contains the code, the message and the
        contacts.
        """
        if self.explainer is not None:
            return self.explainer(seconds)
        contacts = tuple(c for c in self.evidence.get("contacts", ()) if isinstance(c, Contact))
        return Explanation(self.code, self.message or self.code.name, contacts=contacts, data=self.evidence)

    def __bool__(self) -> bool:
        return self.ok


@dataclass(frozen=True)
class IKResult(Outcome):
    """Result of an inverse kinematics request, with the joint positions (dof,) that were found.

    After a failure, `positions` are the closest ones found.
    """

    positions: Array | None = None
    position_error: float = np.inf  # [m]
    rotation_error: float = np.inf  # [rad]


@dataclass(frozen=True)
class PlanResult(Outcome):
    """Result of a planning request, with a path and the trajectory along this path.

    After a failure both are None, except for partial Cartesian paths.
    """

    path: JointPath | None = None
    trajectory: JointTrajectory | None = None
    planner_id: str = ""
    planning_time: float = 0.0  # [s], wall clock
    fraction: float = 1.0  # of a Cartesian path
    clearance: Callable[[], float] | None = field(default=None, repr=False, compare=False)

    @cached_property
    def min_clearance(self) -> float:
        """Return the smallest clearance [m] between the checked pairs of bodies during a planned motion.

        The value is computed on first access.
        """
        return self.clearance() if self.clearance is not None else np.inf


@dataclass(frozen=True)
class ExecutionResult(Outcome):
    """Result of executing a motion, with times [s] on the driver's clock and the tracking errors."""

    started: float = 0.0
    finished: float = 0.0
    max_tracking_error: float = 0.0  # [rad or m]
    final_error: float = 0.0  # [rad or m]

    @property
    def duration(self) -> float:
        return self.finished - self.started
