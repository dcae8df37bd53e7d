"""What a planner is given and what it answers."""

from __future__ import annotations

import difflib
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armcell.collision.kernel.checker import KernelChecker
from armcell.core import InputError, Registry, UnknownNameError
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

RELATIVES = {
    "ABITstar": ("BITstar",), "AITstar": ("BITstar",), "AnytimePathShortening": ("AORRTC",),
    "BiEST": ("EST", "RRTConnect"), "BiTRRT": ("RRTConnect",), "CForest": ("RRTstar",),
    "EITstar": ("BITstar",), "LBTRRT": ("RRTstar",), "LazyPRM": ("PRM",),
    "LazyPRMstar": ("PRMstar",), "LazyRRT": ("RRT",), "PDST": ("KPIECE1",), "ProjEST": ("EST", "KPIECE1"),
    "RRTXstatic": ("RRTstar",), "RRTsharp": ("RRTstar",),
    "SBL": ("EST", "LBKPIECE1"), "SPARS": ("PRM",), "SPARStwo": ("PRM",), "SST": ("RRTstar",),
    "STRIDE": ("EST",), "TRRT": ("RRT",),
}  # fmt: skip
"""OMPL's planners that its Python wheel lacks, and those here that search in the most similar manner."""


def normalized_pipeline_id(pipeline_id: str) -> str:
    """Our name of a pipeline; an empty one is the default."""
    return PIPELINE_ALIASES.get(pipeline_id, pipeline_id)


class UnknownPlannerError(UnknownNameError):
    """A planner that a pipeline lacks; names the pipeline that has it, or the planners nearest to it."""

    def __init__(self, pipeline_id: str, name: str):
        self.kind, self.name = f"planner of pipeline {pipeline_id!r}" if pipeline_id else "planner", name
        self.known = [n for p, table in pipelines.items() if pipeline_id in ("", p) for n in table]
        having = [p for p in pipelines if _name_in(p, name) is not None]
        every = sorted({planner for table in pipelines.values() for planner in table})
        spelled = {planner.casefold(): planner for planner in every}
        near = [spelled[k] for k in difflib.get_close_matches(name.casefold(), spelled, n=3, cutoff=0.6)]
        if having:
            cure = f"pipeline {having[0]!r} has it: set the pipeline to {having[0]!r}, or name none"
        elif name in RELATIVES:
            cure = f"OMPL's {name} is not offered; nearest in kind: {', '.join(RELATIVES[name])}"
        else:
            cure = f"did you mean {' or '.join(map(repr, near))}?" if near else None
        if pipeline_id:
            has = ", ".join(self.known)
        else:
            has = "; ".join(f"{p}: {', '.join(table)}" for p, table in pipelines.items())
        InputError.__init__(self, f"unknown {self.kind} {name!r}; known: {has}", cure=cure)


def _name_in(pipeline_id: str, name: str) -> str | None:
    """The name under which a pipeline has a planner, if it has it."""
    table = pipelines[pipeline_id]
    return next((n for n in (name, ALIASES.get(name)) if n in table), None)


def pipeline_for(pipeline_id: str, planner_id: str) -> str:
    """Our name of the pipeline that a request means: without one, the first that has the planner."""
    if pipeline_id:
        return normalized_pipeline_id(pipeline_id)
    name, default = normalized_planner_id(planner_id), normalized_pipeline_id("")
    return next((p for p in pipelines if _name_in(p, name) is not None), default)


def named_planner(pipeline_id: str, planner_id: str) -> tuple[str, Planner]:
    """The name and the planner that a request means; without a pipeline, the first that has the planner.

    Raises:
        UnknownNameError: no such pipeline, or no such planner in it; never replaced by another.
    """
    asked, pipeline_id = pipeline_id, pipeline_for(pipeline_id, planner_id)
    if pipeline_id not in pipelines:
        raise UnknownNameError("planning pipeline", pipeline_id, pipelines)
    table, name = pipelines[pipeline_id], normalized_planner_id(planner_id)
    if not planner_id.strip() and len(table) == 1:
        name = next(iter(table))
    found = _name_in(pipeline_id, name)
    if found is None:
        raise UnknownPlannerError(asked and pipeline_id, name)
    return found, table[found]


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
