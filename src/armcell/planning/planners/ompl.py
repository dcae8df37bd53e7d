"""OMPL's planners on the kernel."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import ompl.base as ob
import ompl.geometric as og
import ompl.util as ou

from armcell.planning.problem import Answer, Problem, pipelines

CHECK_STEP = 0.03
"""[rad] between validity checks along an edge while searching; the result is certified afterwards."""

# PRM and PRMstar ask for validity from a second thread and wait for ever on Python's lock.
NAMES = ("RRTConnect", "RRT", "RRTstar", "BKPIECE1", "KPIECE1", "LBKPIECE1", "BFMT", "FMT", "BITstar")
ASYMPTOTIC = {"RRTstar", "BITstar"}  # they use all the time they get: give them little
ASYMPTOTIC_TIME = 1.0  # [s]


class _Edges(ob.MotionValidator):
    """Whole edges at once, 16 configurations at a time, instead of one Python call for each."""

    def __init__(self, info: ob.SpaceInformation, problem: Problem):
        super().__init__(info)
        self.free, self.n = problem.checker.edge_is_free, len(problem.start)

    def checkMotion(self, a: Any, b: Any) -> bool:
        n = range(self.n)
        return self.free([a[i] for i in n], [b[i] for i in n], CHECK_STEP)


def _plan(name: str, problem: Problem) -> Answer:
    n = len(problem.start)
    ou.setLogLevel(ou.LOG_NONE)
    # OMPL has one seed for the process. It is set for every request, so that the same request gives the
    # same path; OMPL logs that it dislikes this, but all generators made after it follow the new seed.
    ou.RNG.setSeed(problem.seed % (2**31 - 1) + 1)
    space = ob.RealVectorStateSpace(n)
    bounds = ob.RealVectorBounds(n)
    for i in range(n):
        bounds.setLow(i, float(problem.lower[i]))
        bounds.setHigh(i, float(problem.upper[i]))
    space.setBounds(bounds)
    setup = og.SimpleSetup(space)
    q, calls = np.empty(n), [0]

    def valid(state: Any) -> bool:
        calls[0] += 1
        for i in range(n):
            q[i] = state[i]
        return problem.checker.is_free(q)

    setup.setStateValidityChecker(valid)
    info = setup.getSpaceInformation()
    info.setStateValidityCheckingResolution(CHECK_STEP / space.getMaximumExtent())
    edges = _Edges(info, problem)
    info.setMotionValidator(edges)
    setup.setStartState(_state(space, problem.start))
    goals = ob.GoalStates(info)
    for goal in problem.goals:
        goals.addState(_state(space, goal))
    setup.setGoal(goals)
    setup.setPlanner(getattr(og, name)(info))
    setup.setup()
    left = problem.deadline - time.monotonic()
    if name in ASYMPTOTIC:
        left = min(left, ASYMPTOTIC_TIME)
    stop = ob.PlannerTerminationCondition(lambda: problem.stopped)
    timed = ob.timedPlannerTerminationCondition(max(left, 0.0))
    setup.solve(ob.plannerOrTerminationCondition(stop, timed))
    statistics = {"checks": float(calls[0])}
    if not setup.haveExactSolutionPath():
        reason = "cancelled" if problem.cancel.is_set() else f"no path found in {max(left, 0):.1f} s"
        return Answer(None, f"{name}: {reason}", statistics)
    states: Any = setup.getSolutionPath().getStates()
    waypoints = np.array([[state[i] for i in range(n)] for state in states])
    return Answer(waypoints, "", statistics)


def _state(space: ob.RealVectorStateSpace, q: np.ndarray) -> Any:
    state: Any = space.allocState()
    for i, value in enumerate(q):
        state[i] = float(value)
    return state


def _planner(name: str) -> Callable[[Problem], Answer]:
    def plan(problem: Problem) -> Answer:
        return _plan(name, problem)

    plan.__name__ = name
    return plan


for _name in NAMES:
    pipelines["ompl"].register(_name)(_planner(_name))
