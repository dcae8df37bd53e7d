"""Selection of a planner by a request or by the configurations of an ompl_planning.yaml."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from armcell.core import InputError, PlanRequest, UnknownNameError
from armcell.planning.pilz.settings import settings_from_request
from armcell.planning.planners.problem import Planner, SpaceOptions
from armcell.planning.planners.registry import (
    PILZ,
    named_planner,
    normalized_pipeline_id,
    planner_settings,
)

WITHOUT_EFFECT = {
    "interpolate", "hybridize", "minimum_waypoint_count", "maximum_waypoint_distance",
    "multi_query_planning_enabled", "store_planner_data", "load_planner_data", "planner_data_path",
    "enforce_joint_model_state_space", "enforce_constrained_state_space", "termination_condition",
}  # fmt: skip
"""MoveIt's keys without effect in armcell: every path is simplified, proven and timed in the same manner."""


@dataclass(frozen=True, eq=False)
class PlannerChoice:
    """Result of reading a planner configuration: the selected planner, its settings, and the configuration
    keys that have no effect.
    """

    planner: Planner
    planner_id: str
    settings: Any
    options: SpaceOptions = SpaceOptions()
    without_effect: tuple[str, ...] = ()  # keys that were read but have no effect
    timeout: float | None = None  # [s] upper limit of the planning time


def choose_planner(request: PlanRequest) -> PlannerChoice:
    """Select the planner that a request specifies by its name or by a planner configuration.

    Raises:
        UnknownNameError: no such pipeline, planner, configuration or parameter; there is no silent
            fallback.
        InputError: a configuration of the wrong form.
    """
    if normalized_pipeline_id(request.pipeline_id) == PILZ:
        planner_id, planner = named_planner(request.pipeline_id, request.planner_id)
        given = settings_from_request(planner_id, request.parameters, request.planner_configs)
        return PlannerChoice(planner, planner_id, given[0], without_effect=given[1])
    config, group = _config(request)
    given = config.get("type", request.planner_id) if config else request.planner_id
    planner_id, planner = named_planner(request.pipeline_id, given)
    values = {**group, **{k: v for k, v in config.items() if k != "type"}}
    timeout = _timeout(values.pop("timeout", None))
    options, ignored, rest = _options(values)
    settings = planner_settings(planner, planner_id, {**rest, **request.parameters})
    return PlannerChoice(planner, planner_id, settings, options, tuple(sorted(ignored)), timeout)


def _timeout(value: Any) -> float | None:
    if value is None:
        return None
    seconds = _number("timeout", value)
    if not 0 < seconds < float("inf"):
        raise InputError(f"ompl_planning: timeout is {seconds:g} s, it must be positive")
    return seconds


def _mapping(value: Any, what: str) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise InputError(f"{what} is {value!r}, a mapping is needed")
    return value


def _config(request: PlanRequest) -> tuple[Mapping[str, Any], Mapping[str, Any]]:
    """Return the planner configuration of a request (ompl_planning.yaml), and the keys that belong to the
    planning group.

    Both are empty if the request has no configuration.
    """
    tables = _mapping(request.planner_configs, "planner_configs")
    if not tables:
        return {}, {}
    configs = _mapping(tables.get("planner_configs", {}), "ompl_planning: planner_configs")
    group = dict(_mapping(tables.get(request.group, {}), f"ompl_planning: {request.group}"))
    default = group.pop("default_planner_config", None)
    listed = group.pop("planner_configs", list(configs))
    if not isinstance(listed, list | tuple):
        raise InputError(f"ompl_planning: {request.group}: planner_configs is {listed!r}, a list is needed")
    for name in listed:
        if name not in configs:
            raise UnknownNameError(f"planner configuration of group {request.group!r}", name, configs)
    wanted = request.planner_id.strip() or str(default or "")
    if wanted.endswith("]") and "[" in wanted:  # MoveIt's "group[config]"
        wanted = wanted[wanted.index("[") + 1 : -1]
    if wanted not in configs:
        own = tables.get(wanted) if wanted != request.group else None
        if isinstance(own, Mapping) and "planner_configs" not in own:  # tutorials write `RRTConnect:` on top
            return {"type": wanted, **own}, group
        return {"type": wanted} if wanted != request.planner_id and wanted else {}, group
    config = _mapping(configs[wanted], f"ompl_planning: planner_configs: {wanted}")
    if not isinstance(config.get("type"), str):
        raise InputError(
            f"ompl_planning: planner_configs: {wanted} has no type", hint="write type: geometric::RRTConnect"
        )
    return config, group


def _options(values: Mapping[str, Any]) -> tuple[SpaceOptions, set[str], dict[str, Any]]:
    """Divide the values of a planner configuration into options of the search space, ignored keys and
    parameters of the planner.
    """
    rest = dict(values)
    ignored = {key for key in rest if key in WITHOUT_EFFECT}
    for key in ignored:
        del rest[key]
    fraction = rest.pop("longest_valid_segment_fraction", None)
    if fraction is not None:
        fraction = _number("longest_valid_segment_fraction", fraction)
        if not 0 < fraction <= 1:
            raise InputError(f"longest_valid_segment_fraction is {fraction:g}, it must be in (0, 1]")
    simplify = rest.pop("simplify_solutions", True)
    if simplify not in (True, False, 0, 1):
        raise InputError(f"simplify_solutions is {simplify!r}, true or false is needed")
    objective = rest.pop("optimization_objective", "PathLengthOptimizationObjective")
    if objective != "PathLengthOptimizationObjective":
        raise UnknownNameError("optimization objective", objective, ["PathLengthOptimizationObjective"])
    joints = _projection(rest.pop("projection_evaluator", ""))
    return SpaceOptions(fraction, joints, bool(simplify)), ignored, rest


def _number(key: str, value: Any) -> float:
    try:
        return float(value)
    except (TypeError, ValueError):
        raise InputError(f"{key} is {value!r}, a number is needed") from None


def _projection(text: Any) -> tuple[str, ...]:
    """Parse the joints that a planner configuration names in its projection evaluator `joints(a,b)`."""
    if not text:
        return ()
    if not isinstance(text, str) or not (text.startswith("joints(") and text.endswith(")")):
        raise InputError(f"projection_evaluator is {text!r}", hint="write joints(first_joint,second_joint)")
    return tuple(name.strip() for name in text[len("joints(") : -1].split(","))
