"""Parameters of OMPL's planners by the names that OMPL declares for them.

The wheel has no binding for a planner's ParamSet. What a planner declares is read from its printed settings,
and set through the methods that are bound. A parameter without such a method keeps its value.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import ompl.base as ob
import ompl.geometric as og
import ompl.util as ou

from armcell.core import InputError
from armcell.planning.parameters import MakeSettings, UnknownParameterError

METHODS = {
    "cache_cc": "CacheCC",
    "delay_collision_checking": "DelayCC",
    "delay_rewiring_to_first_solution": "DelayRewiringUntilInitialSolution",
    "drop_unconnected_samples_on_prune": "DropSamplesOnPrune",
    "extended_fmt": "ExtendedFMT",
    "failed_expansion_score_factor": "FailedExpansionCellScoreFactor",
    "find_approximate_solutions": "ConsiderApproximateSolutions",
    "number_sampling_attempts": "NumSamplingAttempts",
    "ordering_batch_size": "BatchSize",
    "prune_threshold_as_fractional_cost_change": "PruneThresholdFraction",
    "stop_on_each_solution_improvement": "StopOnSolnImprovement",
    "use_admissible_heuristic": "AdmissibleCostToCome",
    "use_graph_pruning": "Pruning",
    "use_just_in_time_sampling": "JustInTimeSampling",
    "use_strict_queue_ordering": "StrictQueueOrdering",
}
"""Where a method's name is not the parameter's."""
K_NEAREST = ("KNearest", "UseKNearest", "NearestK")  # of `use_k_nearest`, by planner
SPELLINGS = {"nearest_k": "use_k_nearest"}  # of MoveIt's files, for FMT
UNDECLARED = {"AORRTC": {"range": "0"}}  # has a method, and OMPL does not declare it


def declared(planner: ob.Planner, name: str) -> dict[str, str]:
    """Parameters and their present values, as OMPL prints them."""
    lines = planner.printSettings().splitlines()[1:]
    pairs = (line.split(" = ", 1) for line in lines if " = " in line)
    return {key.strip(): value.strip() for key, value in pairs} | UNDECLARED.get(name, {})


def settings_maker(name: str) -> MakeSettings:
    """Checks parameters of a planner on one made for the purpose; the settings are the parameters."""

    def make(parameters: Mapping[str, Any]) -> Mapping[str, Any]:
        with trial_planner(name) as planner:
            set_parameters(planner, name, parameters)
        return parameters

    def defaults() -> dict[str, Any]:
        with trial_planner(name) as planner:
            return dict(declared(planner, name))

    make.defaults = defaults  # type: ignore[attr-defined]
    return make


@contextmanager
def trial_planner(name: str) -> Iterator[ob.Planner]:
    """A planner that is not for planning, in a space of two dimensions."""
    ou.setLogLevel(ou.LOG_NONE)
    space = ob.RealVectorStateSpace(2)
    bounds = ob.RealVectorBounds(2)
    bounds.setLow(0.0)
    bounds.setHigh(1.0)
    space.setBounds(bounds)
    setup = og.SimpleSetup(space)
    setup.setStateValidityChecker(lambda state: True)
    planner = getattr(og, name)(setup.getSpaceInformation())
    try:
        yield planner
    finally:
        planner.setup()  # OMPL 2.0.1 crashes when an AORRTC goes that has not been set up


def set_parameters(planner: ob.Planner, name: str, parameters: Mapping[str, Any]) -> None:
    """Set a planner's parameters.

    Raises:
        UnknownParameterError: OMPL declares no such parameter for it; lists those it does, with values.
        InputError: a value of the wrong type, one OMPL refuses, or a parameter that cannot be set.
    """
    present = declared(planner, name)
    for key, value in parameters.items():
        known = SPELLINGS.get(key, key) if key not in present else key
        if known not in present:
            raise UnknownParameterError(name, key, present)
        what = f"parameter {key!r} of planner {name!r}"
        setter, getter = _methods(planner, known)
        if setter is None:
            if _as(str, present[known], what) != _text(value):
                raise InputError(
                    f"{what} is {present[known]} and cannot be changed: OMPL for Python has no method for it"
                )
            continue
        wanted = _as(type(getter()), value, what)
        try:
            setter(wanted)
        except (RuntimeError, ValueError, TypeError) as error:
            raise InputError(f"{what} cannot be {value!r}: {error}") from None
        if getter() != wanted:
            raise InputError(f"{what} cannot be {value!r}: OMPL keeps it at {getter()}")


def _methods(planner: ob.Planner, key: str) -> tuple[Any, Any]:
    plain = METHODS.get(key, "".join(part.capitalize() for part in key.split("_")))
    for stem in (plain, *(K_NEAREST if key == "use_k_nearest" else ())):
        if hasattr(planner, f"set{stem}"):
            return getattr(planner, f"set{stem}"), getattr(planner, f"get{stem}")
    return None, None


def _text(value: Any) -> str:
    return f"{float(value):g}" if isinstance(value, bool | int | float) else str(value)


def _as(kind: type, value: Any, what: str) -> Any:
    """A value of the kind that the planner has now; a file's text counts as what it says."""
    if kind is str:
        return str(value)
    text = str(value).strip().lower()
    if kind is bool:
        if text not in ("0", "1", "true", "false"):
            raise InputError(f"{what} is {value!r}, true or false is needed")
        return text in ("1", "true")
    try:
        number = float(text if not isinstance(value, bool) else "x")
    except ValueError:
        raise InputError(f"{what} is {value!r}, a number is needed") from None
    if kind is int:
        if number != int(number) or number < 0:
            raise InputError(f"{what} is {value!r}, a whole number not below zero is needed")
        return int(number)
    return number
