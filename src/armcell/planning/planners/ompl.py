"""OMPL's planners on the kernel: every geometric planner of the installed wheel."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import ompl.base as ob
import ompl.geometric as og
import ompl.util as ou

from armcell.core import UnknownNameError
from armcell.planning.planners.ompl_parameters import set_parameters, settings_maker
from armcell.planning.problem import Answer, Problem, pipelines, settings_makers

CHECK_STEP = 0.03
"""[rad] between validity checks along an edge while searching; the result is certified afterwards."""

NAMES = tuple(
    name
    for name in sorted(dir(og))
    if isinstance(kind := getattr(og, name), type) and issubclass(kind, ob.Planner)
)
# They use all the time they get: give them little, and more only while they have found nothing.
ASYMPTOTIC = {"AORRTC", "BITstar", "InformedRRTstar", "PRMstar", "RRTstar", "SORRTstar"}
ASYMPTOTIC_TIME = 1.0  # [s]
FINITE = {"BFMT", "FMT"}  # they end when their samples are used up
ROADMAPS = {"PRM", "PRMstar"}
SLICE = 0.1  # [s] of a roadmap's search for one goal

_one_at_a_time = threading.Lock()
"""OMPL has one random seed for the process."""


class _Edges(ob.MotionValidator):
    """Whole edges at once, 16 configurations at a time, instead of one Python call for each."""

    def __init__(self, info: ob.SpaceInformation, problem: Problem, step: float):
        super().__init__(info)
        self.free, self.n, self.step = problem.checker.edge_is_free, len(problem.start), step
        self.forbids = problem.forbids

    def checkMotion(self, a: Any, b: Any) -> bool:
        n = range(self.n)
        first, last = [a[i] for i in n], [b[i] for i in n]
        if not self.free(first, last, self.step):
            return False
        if self.forbids is None:
            return True
        way = np.subtract(last, first)
        count = max(int(np.ceil(np.linalg.norm(way) / self.step)), 1)
        return not any(self.forbids(np.asarray(first) + way * (k / count)) for k in range(1, count + 1))


def _plan(name: str, problem: Problem) -> Answer:
    with _one_at_a_time:
        # It is set for every request, so that the same request gives the same path; OMPL logs that it
        # dislikes this, but all generators made after it follow the new seed.
        ou.setLogLevel(ou.LOG_NONE)
        ou.RNG.setSeed(problem.seed % (2**31 - 1) + 1)
        return _search(name, problem)


def _search(name: str, problem: Problem) -> Answer:
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
        return Answer(None, f"{name}: {reason}", statistics)
    path = setup.getSolutionPath()
    if problem.forbids is not None:  # our own simplification knows nothing of that
        simplifier = og.PathSimplifier(info)
        simplifier.reduceVertices(path)
        simplifier.partialShortcutPath(path)
    states: Any = path.getStates()
    waypoints = np.array([[state[i] for i in range(n)] for state in states])
    return Answer(waypoints, "", statistics, simplified=problem.forbids is not None)


def _solve_without_python(
    setup: og.SimpleSetup, planner: ob.Planner, space: ob.RealVectorStateSpace, problem: Problem
) -> None:
    """Solve with a planner that looks for solutions in a second thread.

    That thread asks for the end of the time, and for the validity of goals beyond the first. Asked in Python
    it waits for the interpreter's lock, which the first thread holds while it waits for the second. So the
    time is kept by OMPL's own clock, and there is one goal at a time; the roadmap is kept when they change.
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
    """[s] that a planner gets before it is asked what it has."""
    left = max(problem.deadline - time.monotonic(), 0.0)
    return min(left, ASYMPTOTIC_TIME) if name in ASYMPTOTIC else left


def _project(space: ob.RealVectorStateSpace, problem: Problem) -> None:
    """The joints whose values span the cells of (B)KPIECE, where they are named."""
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


def _planner(name: str) -> Callable[[Problem], Answer]:
    def plan(problem: Problem) -> Answer:
        return _plan(name, problem)

    plan.__name__ = name
    settings_makers[plan] = settings_maker(name)
    return plan


for _name in NAMES:
    pipelines["ompl"].register(_name)(_planner(_name))
