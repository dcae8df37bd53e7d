"""Results of requests: code, message, contacts between bodies, and explanations of failures."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from enum import Enum
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armcell.core.errors import ErrorCode
from armcell.core.joints import JointPath, JointState, JointTrajectory
from armcell.core.transforms import SE3, SO3

Change = Callable[..., tuple[Any, Any]]
"""Function that applies a suggestion: (scene, request, **arguments) -> (scene, request)."""
TRIED = {True: "", None: " (not tried)", False: " (needed, but not enough alone)"}
Array = NDArray[np.float64]


@dataclass(frozen=True)
class Contact:
    """Contact in a result: two bodies (links or objects) that touch or are close to each other.

    `distance` [m] is negative in penetration; `position` (3,) is in the world frame [m].
    """

    body_a: str
    body_b: str
    distance: float
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def describe(self) -> str:
        if self.distance <= 0:
            return f"{self.body_a} touches {self.body_b} ({-self.distance * 1000:.1f} mm deep)"
        return f"{self.body_a} is {self.distance * 1000:.1f} mm from {self.body_b}"


@dataclass(frozen=True, eq=False)
class Suggestion:
    """Suggestion in the result of a failed request: a change of the scene or of the request that may make the
    request succeed.

    Attributes:
        text: the change as an instruction ("move the goal 12 mm along +z").
        effort: size of the change [m or rad], to compare suggestions of one kind.
        works: True if planning succeeded with the change; None if not tried; False if the change is
            necessary but not sufficient.
    """

    text: str
    change: Change
    arguments: Mapping[str, Any] = field(default_factory=dict)
    effort: float = 0.0
    works: bool | None = None

    def apply(self, scene: Any, request: Any) -> tuple[Any, Any]:
        """Apply the change that a result suggests to copies of the scene and the request, and return the
        copies.
        """
        return self.change(scene, request, **self.arguments)

    def as_dict(self) -> dict[str, Any]:
        name = getattr(self.change, "__name__", type(self.change).__name__)
        return {
            "text": self.text,
            "change": name,
            "arguments": to_json_types(self.arguments),
            "effort": to_json_types(self.effort),
            "works": self.works,
        }


@dataclass(frozen=True, eq=False)
class Explanation:
    """Part of a failed result that explains the failure: its causes, and the changes that would help.

    Attributes:
        summary: one line.
        details: one line per finding.
        suggestions: verified suggestions first; `effort` compares suggestions of one kind.
        contacts: the contacts, deepest first.
        state: the robot state in which the contacts occur.
        nearest: the robot state at the nearest valid goal (or start).
        data: the findings by name.
    """

    code: ErrorCode
    summary: str
    details: tuple[str, ...] = ()
    suggestions: tuple[Suggestion, ...] = ()
    contacts: tuple[Contact, ...] = ()
    state: JointState | None = None
    nearest: JointState | None = None
    data: Mapping[str, Any] = field(default_factory=dict)

    def text(self) -> str:
        """Return the explanation in a failed result as text, with one line per finding."""
        lines = [f"{self.code.name}: {self.summary}", *(f"  {line}" for line in self.details)]
        if self.suggestions:
            lines.append("what would help:")
        for number, suggestion in enumerate(self.suggestions, 1):
            lines.append(f"  {number}. {suggestion.text}{TRIED[suggestion.works]}")
        return "\n".join(lines)

    def as_dict(self) -> dict[str, Any]:
        """Return the explanation in a failed result as a dictionary that contains only JSON types."""
        return {
            "code": int(self.code),
            "code_name": self.code.name,
            "summary": self.summary,
            "details": list(self.details),
            "suggestions": [s.as_dict() for s in self.suggestions],
            "contacts": to_json_types(self.contacts),
            "state": to_json_types(self.state),
            "nearest": to_json_types(self.nearest),
            "data": to_json_types(self.data),
        }


def to_json_types(value: Any) -> Any:
    """Convert a value in a result, such as the evidence of a failure, to JSON types.

    Non-finite numbers become None, and a pose becomes a mapping of position and quaternion.
    """
    if value is None or isinstance(value, (bool, str)):
        return value
    if isinstance(value, Enum):
        return value.name
    if isinstance(value, (int, np.integer)):
        return int(value)
    if isinstance(value, (float, np.floating)):
        return float(value) if np.isfinite(value) else None
    if isinstance(value, SE3):
        return {"xyz": value.translation.tolist(), "quat_xyzw": value.quat_xyzw.tolist()}
    if isinstance(value, SO3):
        return value.quat_xyzw.tolist()
    if isinstance(value, JointState):
        return to_json_types(value.as_dict())
    if is_dataclass(value) and not isinstance(value, type):
        return {f.name: to_json_types(getattr(value, f.name)) for f in fields(value)}
    if isinstance(value, Mapping):
        return {str(k): to_json_types(v) for k, v in value.items()}
    if isinstance(value, Iterable):
        return [to_json_types(v) for v in _items(value)]
    return str(value)


def _items(value: Iterable[Any] | NDArray[Any]) -> list[Any]:
    return value.tolist() if isinstance(value, np.ndarray) else list(value)


@dataclass(frozen=True, repr=False)
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
        """Explain the failure that this outcome reports, and suggest changes that would help. The search for
        changes takes about `seconds`.

        Without a diagnosis for the kind of request, the explanation contains the code, the message and the
        contacts.
        """
        if self.explainer is not None:
            return self.explainer(seconds)
        contacts = tuple(c for c in self.evidence.get("contacts", ()) if isinstance(c, Contact))
        return Explanation(self.code, self.message or self.code.name, contacts=contacts, data=self.evidence)

    def __bool__(self) -> bool:
        return self.ok

    def __repr__(self) -> str:
        """Return the code and the message in one line; `evidence` contains the details."""
        more = f": {' '.join(self.message.split())}" if self.message else ""
        return f"<{type(self).__name__} {self.code.name}{more}>"


@dataclass(frozen=True, repr=False)
class IKResult(Outcome):
    """Result of an inverse kinematics request, with the joint positions (dof,) that were found.

    After a failure, `positions` are the closest ones found.
    """

    positions: Array | None = None
    position_error: float = np.inf  # [m]
    rotation_error: float = np.inf  # [rad]


@dataclass(frozen=True, repr=False)
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
        """Return the smallest clearance [m] in a planning result, between the checked pairs of bodies during
        the motion.

        The value is computed on first access.
        """
        return self.clearance() if self.clearance is not None else np.inf


@dataclass(frozen=True, repr=False)
class ExecutionResult(Outcome):
    """Result of executing a motion, with times [s] on the driver's clock and the tracking errors."""

    started: float = 0.0
    finished: float = 0.0
    max_tracking_error: float = 0.0  # [rad or m]
    final_error: float = 0.0  # [rad or m]

    @property
    def duration(self) -> float:
        return self.finished - self.started
