"""OMPL's geometric planners on armcell's collision kernel, with OMPL's parameter names.

The wheel has no binding for a planner's ParamSet: armcell reads the declared parameters from the printed
settings and sets them through bound methods. A parameter without such a method keeps its value.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np
import ompl.base as ob
import ompl.geometric as og
import ompl.util as ou

from armcell.core import InputError, UnknownNameError
from armcell.planning.planners.problem import PlannerResult, Problem
from armcell.planning.planners.registry import (
    SettingsParser,
    UnknownParameterError,
    pipelines,
    settings_parsers,
)

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
"""Names of setter methods that differ from the parameter's name."""
K_NEAREST = ("KNearest", "UseKNearest", "NearestK")  # method names of `use_k_nearest`, by planner
SPELLINGS = {"nearest_k": "use_k_nearest"}  # spelling in MoveIt's files, for FMT
UNDECLARED = {"AORRTC": {"range": "0"}}  # parameters with a method that OMPL does not declare


def declared_parameters(planner: ob.Planner, name: str) -> dict[str, str]:
    """Read the parameters of an OMPL planner and their current values from the settings that the planner
    prints.
    """
    lines = planner.printSettings().splitlines()[1:]
    pairs = (line.split(" = ", 1) for line in lines if " = " in line)
    return {key.strip(): value.strip() for key, value in pairs} | UNDECLARED.get(name, {})


def make_settings_parser(name: str) -> SettingsParser:
    """Create a parser for the parameters of an OMPL planner. The parser checks the values by setting them on
    a temporary planner.

    The settings are the parameters.
    """

    def make(parameters: Mapping[str, Any]) -> Mapping[str, Any]:
        with trial_planner(name) as planner:
            set_parameters(planner, name, parameters)
        return parameters

    def defaults() -> dict[str, Any]:
        with trial_planner(name) as planner:
            return dict(declared_parameters(planner, name))

    make.defaults = defaults  # type: ignore[attr-defined]
    return make


@contextmanager
def trial_planner(name: str) -> Iterator[ob.Planner]:
    """Yield a temporary OMPL planner in a two-dimensional space. It only serves to list the planner's
    parameters and to check their values; it plans nothing.
    """
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
        planner.setup()  # OMPL 2.0.1 crashes on deletion of an AORRTC that was never set up


def set_parameters(planner: ob.Planner, name: str, parameters: Mapping[str, Any]) -> None:
    """Set parameters of an OMPL planner.

    Raises:
        UnknownParameterError: OMPL declares no such parameter for the planner; the error lists the declared
            parameters with their values.
        InputError: a value has the wrong type, OMPL rejects a value, or a parameter cannot be set.
    """
    present = declared_parameters(planner, name)
    for key, value in parameters.items():
        known = SPELLINGS.get(key, key) if key not in present else key
        if known not in present:
            raise UnknownParameterError(name, key, present)
        what = f"parameter {key!r} of planner {name!r}"
        setter, getter = _methods(planner, known)
        if setter is None:
            if _converted(str, present[known], what) != _text(value):
                raise InputError(
                    f"{what} is {present[known]} and cannot be changed: OMPL for Python has no method for it"
                )
            continue
        wanted = _converted(type(getter()), value, what)
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


def _converted(kind: type, value: Any, what: str) -> Any:
    """Convert a value, such as text, to the type that OMPL has for a parameter of its planner."""
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


CHECK_STEP = 0.03
"""[rad] between validity checks along an edge while searching; the result is certified afterwards."""

NAMES = tuple(
    name
    for name in sorted(dir(og))
    if isinstance(kind := getattr(og, name), type) and issubclass(kind, ob.Planner)
)
# These planners use all available time: they get little time, and more only until a first solution.
ASYMPTOTIC = {"AORRTC", "BITstar", "InformedRRTstar", "PRMstar", "RRTstar", "SORRTstar"}
ASYMPTOTIC_TIME = 1.0  # [s]
FINITE = {"BFMT", "FMT"}  # they end when their samples are used up
ROADMAPS = {"PRM", "PRMstar"}
SLICE = 0.1  # [s] of a roadmap's search for one goal

_one_at_a_time = threading.Lock()
"""OMPL has a single random seed per process."""


class _Edges(ob.MotionValidator):
    """Motion validator for OMPL that checks whole edges, 16 configurations at a time."""

    def __init__(self, info: ob.SpaceInformation, problem: Problem, step: float):
        super().__init__(info)
        self.free, self.n, self.step = problem.checker.edge_is_free, len(problem.start), step
        self.forbids = problem.forbids

    def checkMotion(self, a: Any, b: Any) -> bool:
        """Return whether the straight motion between two OMPL states is valid."""
        n = range(self.n)
        first, last = [a[i] for i in n], [b[i] for i in n]
        if not self.free(first, last, self.step):
            return False
        if self.forbids is None:
            return True
        way = np.subtract(last, first)
        count = max(int(np.ceil(np.linalg.norm(way) / self.step)), 1)
        return not any(self.forbids(np.asarray(first) + way * (k / count)) for k in range(1, count + 1))


def _plan(name: str, problem: Problem) -> PlannerResult:
    with _one_at_a_time:
        # Set the seed for every request, so that equal requests give equal paths; OMPL logs a
        # warning, but all generators created afterward follow the new seed.
        ou.setLogLevel(ou.LOG_NONE)
        ou.RNG.setSeed(problem.seed % (2**31 - 1) + 1)
        return _search(name, problem)


def _search(name: str, problem: Problem) -> PlannerResult:
    n = len(problem.start)
    space = ob.RealVectorStateSpace(n)
    bounds = ob.RealVectorBounds(n)
    for i in range(n):
        bounds.setLow(i, float(problem.lower[i]))
        bounds.setHigh(i, float(problem.upper[i]))
    space.setBounds(bounds)
    _project(space, problem)
    extent = space.getMaximumExtent()
    fraction = problem.options.longest_valid_segment_fraction or CHECK_STEP / extent
    setup = og.SimpleSetup(space)
    q, calls = np.empty(n), [0]

    def valid(state: Any) -> bool:
        calls[0] += 1
        for i in range(n):
            q[i] = state[i]
        return problem.checker.is_free(q) and (problem.forbids is None or not problem.forbids(q))

    setup.setStateValidityChecker(valid)
    info = setup.getSpaceInformation()
    info.setStateValidityCheckingResolution(fraction)
    edges = _Edges(info, problem, fraction * extent)
    info.setMotionValidator(edges)
    setup.setStartState(_state(space, problem.start))
    planner = getattr(og, name)(info)
    if problem.settings:
        set_parameters(planner, name, problem.settings)
    began = time.monotonic()
    if name in ROADMAPS:
        _solve_without_python(setup, planner, space, problem)
    else:
        goals = ob.GoalStates(info)
        for goal in problem.goals:
            goals.addState(_state(space, goal))
        setup.setGoal(goals)
        setup.setPlanner(planner)
        setup.setup()
        stop = ob.PlannerTerminationCondition(lambda: problem.stopped)
        while not problem.stopped and not setup.haveExactSolutionPath():
            timed = ob.timedPlannerTerminationCondition(_time_for(name, problem))
            setup.solve(ob.plannerOrTerminationCondition(stop, timed))
            if name in FINITE:
                break
    statistics = {"checks": float(calls[0])}
    if not setup.haveExactSolutionPath():
        reason = (
            "cancelled" if problem.cancel.is_set() else f"no path found in {time.monotonic() - began:.1f} s"
        )
        return PlannerResult(None, f"{name}: {reason}", statistics)
    path = setup.getSolutionPath()
    if problem.forbids is not None:  # armcell's simplification does not check `forbids`
        simplifier = og.PathSimplifier(info)
        simplifier.reduceVertices(path)
        simplifier.partialShortcutPath(path)
    states: Any = path.getStates()
    waypoints = np.array([[state[i] for i in range(n)] for state in states])
    return PlannerResult(waypoints, "", statistics, simplified=problem.forbids is not None)


def _solve_without_python(
    setup: og.SimpleSetup, planner: ob.Planner, space: ob.RealVectorStateSpace, problem: Problem
) -> None:
    """Solve a planning problem without Python callbacks, for OMPL planners that use a second thread.

    The second thread asks for the end of the time limit and for the validity of further goals. A Python
    callback would wait there for the interpreter lock, which the first thread holds while it waits for the
    second thread. OMPL's own clock therefore limits the time, and only one goal is set at a time; the roadmap
    persists when goals change.
    """
    name, turn = planner.getName(), 0
    enough = time.monotonic() + _time_for(name, problem)
    setup.setGoalState(_state(space, problem.goals[0]))
    setup.setPlanner(planner)
    setup.setup()
    while not problem.stopped:
        setup.solve(SLICE)
        if not setup.haveExactSolutionPath():
            turn += 1
            planner.clearQuery()
            setup.setGoalState(_state(space, problem.goals[turn % len(problem.goals)]))
        elif name not in ASYMPTOTIC or time.monotonic() > enough:
            return


def _time_for(name: str, problem: Problem) -> float:
    """Return the time budget [s] of an OMPL planner: the remaining planning time, with a shorter limit for
    asymptotically optimal planners.
    """
    left = max(problem.deadline - time.monotonic(), 0.0)
    return min(left, ASYMPTOTIC_TIME) if name in ASYMPTOTIC else left


def _project(space: ob.RealVectorStateSpace, problem: Problem) -> None:
    """Register the joints that span the projection grid of the OMPL planners KPIECE and BKPIECE, if the
    request names such joints.
    """
    joints = problem.options.projection_evaluator
    if not joints:
        return
    for name in joints:
        if name not in problem.joint_names:
            raise UnknownNameError("joint of the projection", name, problem.joint_names)
    columns = [problem.joint_names.index(name) for name in joints]
    sizes = [float(problem.upper[k] - problem.lower[k]) / 20.0 for k in columns]  # OMPL's own share
    space.registerDefaultProjection(ob.RealVectorOrthogonalProjectionEvaluator(space, sizes, columns))


def _state(space: ob.RealVectorStateSpace, q: np.ndarray) -> Any:
    state: Any = space.allocState()
    for i, value in enumerate(q):
        state[i] = float(value)
    return state


def _planner(name: str) -> Callable[[Problem], PlannerResult]:
    def plan(problem: Problem) -> PlannerResult:
        return _plan(name, problem)

    plan.__name__ = name
    settings_parsers[plan] = make_settings_parser(name)
    return plan


for _name in NAMES:
    pipelines["ompl"].register(_name)(_planner(_name))
