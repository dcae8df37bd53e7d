"""OMPL's RRTConnect from Python with pinocchio and coal as validity check: what people build themselves."""

from __future__ import annotations

import numpy as np
import ompl.base as ob
import ompl.geometric as og
import ompl.util as ou

from benchmarks.planning.peers.base import Result, Stopwatch
from benchmarks.planning.pinocchio_world import PinocchioWorld
from benchmarks.planning.problems import Problem, Robot

CHECK_STEP = 0.05  # [rad] along an edge


class OmplCoal:
    name = "OMPL + pinocchio/coal"

    def load(self, robot: Robot) -> None:
        ou.setLogLevel(ou.LOG_NONE)
        self.world = PinocchioWorld(robot)
        model = self.world.model
        self.lower = model.lowerPositionLimit[self.world.columns]
        self.upper = model.upperPositionLimit[self.world.columns]

    def set_problem(self, problem: Problem) -> None:
        self.problem = problem
        self.world.set_problem(problem)

    def plan(self, seed: int, seconds: float) -> Result:
        ou.RNG.setSeed(seed + 1)
        n = len(self.lower)
        space = ob.RealVectorStateSpace(n)
        bounds = ob.RealVectorBounds(n)
        for i in range(n):
            bounds.setLow(i, float(self.lower[i]))
            bounds.setHigh(i, float(self.upper[i]))
        space.setBounds(bounds)
        setup = og.SimpleSetup(space)
        setup.setStateValidityChecker(
            lambda state: not self.world.touches(np.array([state[i] for i in range(n)]))
        )
        info = setup.getSpaceInformation()
        info.setStateValidityCheckingResolution(CHECK_STEP / space.getMaximumExtent())
        ends = [space.allocState(), space.allocState()]
        for state, q in zip(ends, (self.problem.start, self.problem.goal)):
            for i in range(n):
                state[i] = float(q[i])
        setup.setStartAndGoalStates(*ends)
        setup.setPlanner(og.RRTConnect(info))
        setup.setup()
        watch = Stopwatch()
        setup.solve(seconds)
        plan_us = watch()
        if not setup.haveExactSolutionPath():
            return Result(plan_us)
        raw = self._waypoints(setup)
        watch()
        setup.simplifySolution()
        return Result(plan_us, watch(), 0.0, raw, self._waypoints(setup))

    def _waypoints(self, setup) -> np.ndarray:
        states = setup.getSolutionPath().getStates()
        return np.array([[state[i] for i in range(len(self.lower))] for state in states])
