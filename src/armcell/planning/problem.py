"""What a planner is given and what it answers."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armcell.collision.kernel.checker import KernelChecker
from armcell.core import Registry, UnknownNameError
from armcell.model import RobotModel
from armcell.planning.parameters import MakeSettings, UnknownParameterError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SpaceOptions:
    """What a planner configuration says beside the planner's own parameters."""

    longest_valid_segment_fraction: float | None = None  # of the space's extent, between validity checks
    projection_evaluator: tuple[str, ...] = ()  # joints whose values span the cells of (B)KPIECE
    simplify_solutions: bool = True


@dataclass(frozen=True, eq=False)
class Problem:
    """One start, one or more goals (n,) in the joint space of a group, and what is free."""

    checker: KernelChecker
    start: Array
    goals: tuple[Array, ...]
    lower: Array  # bounds to sample in, finite
    upper: Array
    seed: int
    deadline: float  # [s] of time.monotonic()
    cancel: threading.Event = field(default_factory=threading.Event)
    more_goals: Iterator[Array] | None = None  # further ones (n,), worked out when they are asked for
    options: SpaceOptions = SpaceOptions()
    settings: Any = None  # what `planner_settings` made of the request's parameters
    forbids: Callable[[Array], bool] | None = None  # positions (n,) not to be used though free; OMPL's only

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
    statistics: dict[str, Any] = field(default_factory=dict)
    simplified: bool = False


Planner = Callable[[Problem], Answer]
INDUSTRIAL = "pilz"
"""The pipeline of motions that are told, not searched: its planners are `industrial.command.Generator`s."""

pipelines: dict[str, Registry[Any]] = {
    "native": Registry("planner of pipeline 'native'"),
    "ompl": Registry("planner of pipeline 'ompl'"),
    INDUSTRIAL: Registry("planner of pipeline 'pilz'"),
}
"""Planners by pipeline and name."""

PIPELINE_ALIASES = {"": "native", "pilz_industrial_motion_planner": INDUSTRIAL}
"""MoveIt's names for pipelines."""

settings_makers: dict[Planner, MakeSettings] = {}
"""For planners with parameters: what makes their settings of them. A planner without takes none."""

first_uses: dict[Planner, Callable[[], object]] = {}
"""For planners that are not used by default: what has them compiled, before the time of a request runs."""


def planner_settings(planner: Planner, planner_id: str, parameters: Mapping[str, Any]) -> Any:
    """A planner's settings from a request's parameters, or None where there are none.

    Raises:
        UnknownParameterError: the planner has no such parameter; lists those it has.
        InputError: an impossible value.
    """
    if not parameters:
        return None
    if planner in settings_makers:
        return settings_makers[planner](parameters)
    raise UnknownParameterError(planner_id, next(iter(parameters)), {})


def planner_defaults(pipeline_id: str, planner_id: str) -> dict[str, Any]:
    """Parameters that a planner takes, with the values they have where nothing is said.

    Raises:
        UnknownNameError: no such pipeline or planner.
    """
    maker = settings_makers.get(find_planner(pipeline_id, planner_id))
    return maker.defaults() if maker is not None and hasattr(maker, "defaults") else {}


ALIASES = {"BKPIECE": "BKPIECE1", "KPIECE": "KPIECE1", "LBKPIECE": "LBKPIECE1"}
"""MoveIt's names for planners that OMPL calls otherwise."""


def normalized_pipeline_id(pipeline_id: str) -> str:
    """Our name of a pipeline; an empty one is the default."""
    return PIPELINE_ALIASES.get(pipeline_id, pipeline_id)


def named_planner(pipeline_id: str, planner_id: str) -> tuple[str, Planner]:
    """The name and the planner that a request means; an empty pipeline is the default one.

    Raises:
        UnknownNameError: no such pipeline, or no such planner in it; never replaced by another.
    """
    pipeline_id = normalized_pipeline_id(pipeline_id)
    if pipeline_id not in pipelines:
        raise UnknownNameError("planning pipeline", pipeline_id, pipelines)
    table, name = pipelines[pipeline_id], normalized_planner_id(planner_id)
    if not planner_id.strip() and len(table) == 1:
        name = next(iter(table))
    if name not in table and ALIASES.get(name) in table:
        name = ALIASES[name]
    return name, table[name]


def find_planner(pipeline_id: str, planner_id: str) -> Planner:
    """The planner that a request means, see `named_planner`."""
    return named_planner(pipeline_id, planner_id)[1]


def normalized_planner_id(planner_id: str) -> str:
    """MoveIt's spellings in one: `geometric::RRTConnect`, `RRTConnectkConfigDefault`, `arm[RRTConnect]`."""
    name = planner_id.strip()
    if name.endswith("]") and "[" in name:
        name = name[name.index("[") + 1 : -1]
    return name.removeprefix("geometric::").removesuffix("kConfigDefault") or "RRTConnect"


def sampling_bounds(
    model: RobotModel, joint_names: tuple[str, ...], start: Array, goals: Sequence[Array]
) -> tuple[Array, Array]:
    """Bounds (n,) to sample in: the limits, or one turn around start and goals where they span more."""
    columns = model.columns(joint_names)
    low, high = model.lower[columns], model.upper[columns]
    points = np.vstack([start, *goals])
    near_low, near_high = points.min(0) - np.pi / 2, points.max(0) + np.pi / 2
    wide = ~np.isfinite(high - low) | (high - low > 2 * np.pi)
    return (
        np.where(wide, np.maximum(low, near_low), np.minimum(low, points.min(0))),
        np.where(wide, np.minimum(high, near_high), np.maximum(high, points.max(0))),
    )
