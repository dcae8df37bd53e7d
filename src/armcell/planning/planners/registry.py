"""Registry of planners: lookup by name, MoveIt's names, parameters and first-use hooks."""

from __future__ import annotations

import difflib
import logging
import os
from collections.abc import Callable, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armcell.core import InputError, Registry, UnknownNameError
from armcell.core.checks import settings_from
from armcell.core.registry import load_plugins
from armcell.planning.planners.problem import Planner

Array = NDArray[np.float64]

SettingsParser = Callable[[Mapping[str, Any]], Any]


class UnknownParameterError(UnknownNameError):
    """Error for a parameter that the selected planner in the registry does not have.

    The message lists the planner's parameters with their current values.
    """

    def __init__(self, planner: str, name: object, present: Mapping[str, Any]):
        self.kind, self.name, self.known = f"parameter of planner {planner!r}", name, sorted(present)
        near = difflib.get_close_matches(str(name), self.known, n=1, cutoff=0.6)
        has = ", ".join(f"{key} = {present[key]}" for key in self.known) or "none"
        InputError.__init__(
            self,
            f"unknown {self.kind} {str(name)!r}; it has: {has}",
            hint=f"did you mean {near[0]!r}?" if near else None,
        )


def settings_parser(planner: str, cls: type) -> SettingsParser:
    """Create a function that converts the parameters of a request to the settings of a planner in the
    registry.

    Raises:
        UnknownParameterError: no such parameter. InputError: a value of the wrong type.
    """

    def make(parameters: Mapping[str, Any]) -> Any:
        present = {f.name: f.default for f in fields(cls)}
        for name in parameters:
            if name not in present:
                raise UnknownParameterError(planner, name, present)
        settings = settings_from(cls, parameters, f"planner {planner}")
        for f in fields(cls):
            value = getattr(settings, f.name)
            if value is not None and value <= 0:
                raise InputError(
                    f"parameter {f.name!r} of planner {planner!r} is {value}, it must be positive"
                )
        return settings

    make.defaults = lambda: {f.name: f.default for f in fields(cls)}  # type: ignore[attr-defined]
    return make


logger = logging.getLogger(__name__)


def announce_compilation(planner: str, function: Any) -> None:
    """Log that a planner in the registry is about to be compiled, unless it is already loaded or cached."""
    if function.signatures or _cached(function):
        return
    logger.info("compiling planner %s, which is kept for later runs", planner)


def _cached(function: Any) -> bool:
    """Return whether Numba's cache contains an index file for the function of a planner in the registry."""
    folder, code = Path(os.environ["NUMBA_CACHE_DIR"]), function.py_func.__code__
    pattern = f"{Path(code.co_filename).stem}.{code.co_name}-{code.co_firstlineno}.*.nbi"
    return any(folder.rglob(pattern))


GROUP = "armcell.planners"
"""Group of the entry points through which installed packages add planners and pipelines."""

PILZ = "pilz"
"""The pipeline of PTP, LIN and CIRC; its planners are `pilz.command.Generator`s."""

pipelines: dict[str, Registry[Any]] = {
    "native": Registry("planner of pipeline 'native'", GROUP),
    "ompl": Registry("planner of pipeline 'ompl'", GROUP),
    PILZ: Registry("planner of pipeline 'pilz'", GROUP),
}
"""Planners by pipeline and name."""

PIPELINE_ALIASES = {"": "native", "pilz_industrial_motion_planner": PILZ}
"""MoveIt's names for pipelines."""

settings_parsers: dict[Planner, SettingsParser] = {}
"""Parsers from parameters to settings. A planner without an entry takes no parameters."""

first_use_hooks: dict[Planner, Callable[[], object]] = {}
"""Functions that compile a planner's kernels before a request's planning time starts, by planner."""


def planner_settings(planner: Planner, planner_id: str, parameters: Mapping[str, Any]) -> Any:
    """Convert the parameters of a request to the settings of a planner in the registry. Return None if there
    are no parameters.

    Raises:
        UnknownParameterError: the planner has no such parameter; the error lists its parameters.
        InputError: an impossible value.
    """
    if not parameters:
        return None
    if planner in settings_parsers:
        return settings_parsers[planner](parameters)
    raise UnknownParameterError(planner_id, next(iter(parameters)), {})


def planner_defaults(pipeline_id: str, planner_id: str) -> dict[str, Any]:
    """List the parameters of a planner in the registry with their default values.

    Raises:
        UnknownNameError: no such pipeline or planner.
    """
    maker = settings_parsers.get(find_planner(pipeline_id, planner_id))
    return maker.defaults() if maker is not None and hasattr(maker, "defaults") else {}


ALIASES = {"BKPIECE": "BKPIECE1", "KPIECE": "KPIECE1", "LBKPIECE": "LBKPIECE1"}
"""MoveIt's names for planners that have another name in OMPL."""

SIMILAR_PLANNERS = {
    "ABITstar": ("BITstar",), "AITstar": ("BITstar",), "AnytimePathShortening": ("AORRTC",),
    "BiEST": ("EST", "RRTConnect"), "BiTRRT": ("RRTConnect",), "CForest": ("RRTstar",),
    "EITstar": ("BITstar",), "LBTRRT": ("RRTstar",), "LazyPRM": ("PRM",),
    "LazyPRMstar": ("PRMstar",), "LazyRRT": ("RRT",), "PDST": ("KPIECE1",), "ProjEST": ("EST", "KPIECE1"),
    "RRTXstatic": ("RRTstar",), "RRTsharp": ("RRTstar",),
    "SBL": ("EST", "LBKPIECE1"), "SPARS": ("PRM",), "SPARStwo": ("PRM",), "SST": ("RRTstar",),
    "STRIDE": ("EST",), "TRRT": ("RRT",),
}  # fmt: skip
"""OMPL planners that its Python wheel lacks, with the most similar available planners."""


def normalized_pipeline_id(pipeline_id: str) -> str:
    """Convert the name of a planning pipeline to the name used in the planner registry. An empty name means
    the default pipeline.
    """
    return PIPELINE_ALIASES.get(pipeline_id, pipeline_id)


class UnknownPlannerError(UnknownNameError):
    """Error for an unknown planner name: the planner registry does not list it for the selected pipeline.

    The message names the pipeline that has the planner, or the most similar planners.
    """

    def __init__(self, pipeline_id: str, name: str):
        self.kind, self.name = f"planner of pipeline {pipeline_id!r}" if pipeline_id else "planner", name
        self.known = [n for p, table in pipelines.items() if pipeline_id in ("", p) for n in table]
        having = [p for p in pipelines if _name_in(p, name) is not None]
        every = sorted({planner for table in pipelines.values() for planner in table})
        spelled = {planner.casefold(): planner for planner in every}
        near = [spelled[k] for k in difflib.get_close_matches(name.casefold(), spelled, n=3, cutoff=0.6)]
        if having:
            hint = f"pipeline {having[0]!r} has it: set the pipeline to {having[0]!r}, or name none"
        elif name in SIMILAR_PLANNERS:
            hint = f"OMPL's {name} is not offered; nearest in kind: {', '.join(SIMILAR_PLANNERS[name])}"
        else:
            hint = f"did you mean {' or '.join(map(repr, near))}?" if near else None
        if pipeline_id:
            has = ", ".join(self.known)
        else:
            has = "; ".join(f"{p}: {', '.join(table)}" for p, table in pipelines.items())
        InputError.__init__(self, f"unknown {self.kind} {name!r}; known: {has}", hint=hint)


def _name_in(pipeline_id: str, name: str) -> str | None:
    """Return a planner's name in the registry, or None if the given pipeline has no such planner."""
    table = pipelines[pipeline_id]
    return next((n for n in (name, ALIASES.get(name)) if n in table), None)


def pipeline_for(pipeline_id: str, planner_id: str) -> str:
    """Select the planning pipeline for a request from the planner registry.

    Without a pipeline name, it is the first pipeline that has the planner.
    """
    if pipeline_id:
        return normalized_pipeline_id(pipeline_id)
    name, default = normalized_planner_id(planner_id), normalized_pipeline_id("")
    return next((p for p in pipelines if _name_in(p, name) is not None), default)


def named_planner(pipeline_id: str, planner_id: str) -> tuple[str, Planner]:
    """Find a planner in the registry by the names of its pipeline and planner, and return its name and its
    function.

    Without a pipeline name, the first pipeline that has the planner is used.

    Raises:
        UnknownNameError: no such pipeline, or no such planner in it; there is no silent fallback.
    """
    asked, pipeline_id = pipeline_id, pipeline_for(pipeline_id, planner_id)
    if pipeline_id not in pipelines:
        load_plugins(GROUP)
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
    """Find a planner in the registry by the names of its pipeline and planner, and return its function."""
    return named_planner(pipeline_id, planner_id)[1]


def normalized_planner_id(planner_id: str) -> str:
    """Convert a planner name that MoveIt uses to the name in armcell's planner registry.

    Examples: `geometric::RRTConnect`, `RRTConnectkConfigDefault`, `arm[RRTConnect]`.
    """
    name = planner_id.strip()
    if name.endswith("]") and "[" in name:
        name = name[name.index("[") + 1 : -1]
    return name.removeprefix("geometric::").removesuffix("kConfigDefault") or "RRTConnect"
