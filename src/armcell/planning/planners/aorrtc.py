"""AORRTC, an anytime planner that shortens its path as long as time remains.

AORRTC must find a path that, before any simplification, is shorter than the best simplified path. Early in
the search such a path is rare. Each round therefore begins with a few quick first paths from other samples,
which are simplified and gain more.
"""

# pyright: reportCallIssue=false
# Numba calls intrinsics without their typing context, and splices tuples into compiled calls.
from __future__ import annotations

import time
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armcell.planning.first_compile import BOUNDS, small_problem
from armcell.planning.planners.native.aorrtc import Improvement, aorrtc
from armcell.planning.planners.native.rrt_connect import FOUND
from armcell.planning.planners.native.tree import new_trees
from armcell.planning.planners.problem import PlannerResult, Problem
from armcell.planning.planners.registry import (
    announce_compilation,
    first_use_hooks,
    pipelines,
    settings_parser,
    settings_parsers,
)
from armcell.planning.planners.rrt_connect import NativePlanner, stop_flag, unsolved_result

Array = NDArray[np.float64]

SHORTEST = 1e-4
"""A path that exceeds the straight line by less than this share counts as optimal."""


@dataclass(frozen=True)
class AORRTCSettings:
    """Settings of AORRTC, an anytime planner that keeps improving its path.

    Only a budget of iterations makes results reproducible by seed.
    """

    max_iterations: int = 1_000_000_000  # of the search in all rounds
    gain: float = 1e-3  # a round must find a path that is shorter by this share
    least_gain: float = 1e-4  # smallest relative gain while polishing
    round_iterations: int = 2000  # of a round after an improvement; twice as many after each without one
    max_nodes: int = 16_384  # per tree and round (a multiple of 16); then the round restarts
    restarts: int = 8  # first paths from other samples per round; one may be better after simplification
    polish: int = 3  # failed attempts in a row to shorten a path locally before the next round


@dataclass(frozen=True, eq=False)
class AORRTCResult:
    """Result of the planner AORRTC: the shortest path that was found, whose edges are all proven
    collision-free, or None.

    Attributes:
        history: (seconds of wall time, iterations, cost [rad]) of every improvement, beginning with the
            first path.
        closest: see `NativeResult`.
    """

    waypoints: Array | None
    history: list[tuple[float, int, float]] = field(default_factory=list)
    iterations: int = 0
    nodes: int = 0
    rounds: int = 0
    closest: Array | None = None


class AORRTCPlanner:
    """Anytime planner that shortens the path of another native planner by the algorithm AORRTC.

    Use one instance per thread.
    """

    def __init__(self, first: NativePlanner, settings: AORRTCSettings = AORRTCSettings()):
        self.first, self.settings = first, settings
        dims = len(first.slack) + 1
        self.trees = new_trees(dims, settings.max_nodes)
        self.space = np.zeros(4 * dims)
        self.found = np.zeros(FOUND, np.int64)

    def plan(
        self, start: Array, goals: Array, lower: Array, upper: Array, seed: int = 0,
        stop: NDArray[np.int64] | None = None,
    ) -> AORRTCResult:  # fmt: skip
        """Run AORRTC until `stop` is set or all iterations are used, and return the shortest path that was
        found.

        Args:
            goals: (g, dof). stop: an int64 array (1,) that another thread writes to.
        """
        began, stop = time.monotonic(), np.zeros(1, np.int64) if stop is None else stop
        answer = self.first.plan(start, goals, lower, upper, seed, stop)
        if answer.waypoints is None:
            return AORRTCResult(None, [], answer.iterations, answer.nodes, 0, answer.closest)
        best, iterations, rounds, most = answer.waypoints, answer.iterations, 0, answer.nodes
        history: list[tuple[float, int, float]] = []
        rng = np.random.default_rng(seed)
        random = rng.integers(1, 2**63, 1).astype(np.uint64)
        roots = np.vstack([start, goals])
        least = float(np.linalg.norm(goals - start, axis=1).min())

        def keep(path: Array) -> None:
            nonlocal best
            best = path
            history.append((time.monotonic() - began, iterations, length(path)))

        keep(best)
        settings, improved, limit = self.settings, True, self.settings.round_iterations
        while True:
            failures = 0 if improved else settings.polish - 1
            while failures < settings.polish and not stop[0]:
                shorter = self._polished(best, rng, stop)
                better = shorter is not None and length(shorter) < length(best) * (1 - settings.least_gain)
                if shorter is not None and better:
                    keep(shorter)
                failures = 0 if better else failures + 1
            left = settings.max_iterations - iterations
            if stop[0] or left <= 0 or length(best) < least * (1 + SHORTEST):
                break
            improved = False
            for _ in range(settings.restarts * limit // settings.round_iterations):
                ask = (lower, upper, int(rng.integers(1, 2**31)), stop, self.first.settings.step)
                count, more, nodes = self.first.search(start, goals, *ask, iterations=min(left, limit))
                iterations, most, left = iterations + more, max(most, nodes), left - more
                count = self.first.shorten(count, stop) if count else 0
                if count and length(self.first.path[:count]) < length(best):
                    improved = True
                    keep(self.first.path[:count].copy())
                if stop[0] or left <= 0:
                    break
            bound = length(best) * (1 - settings.gain)
            count, more, nodes = self.improve(roots, lower, upper, bound, random, stop, min(left, limit))
            iterations, rounds, most = iterations + more, rounds + 1, max(most, nodes)
            count = self.first.shorten(count, stop) if count else 0
            if count and length(self.first.path[:count]) < length(best):
                improved = True
                keep(self.first.path[:count].copy())
            limit = settings.round_iterations if improved else 2 * limit
        return AORRTCResult(best, history, iterations, most, rounds)

    def improve(self, roots, lower, upper, bound, random, stop, iterations) -> tuple[int, int, int]:
        """Search by AORRTC for a path that is shorter than `bound` [rad], and store the path in the array
        `first.path`.

        See `aorrtc`.

        Args:
            roots: (1 + g, dof), start and goals.
        """
        first = self.first
        ask = Improvement(
            roots, len(roots) - 1, lower, upper, bound, first.reach, first.settings.step, random
        )
        return aorrtc(
            first.checker.handle, ask, self.trees, self.space, self.found, stop, iterations, first.path
        )

    def _polished(self, path: Array, rng: np.random.Generator, stop: NDArray[np.int64]) -> Array | None:
        """Divide the edges of a path from AORRTC at random points, and simplify the path again.

        Return None if the path gets too long.
        """
        cuts = rng.random(len(path) - 1)[:, None]
        rows = np.empty((2 * len(path) - 1, path.shape[1]))
        rows[::2] = path
        rows[1::2] = path[:-1] + cuts * (path[1:] - path[:-1])
        if len(rows) > len(self.first.path):
            return None
        self.first.path[: len(rows)] = rows
        count = self.first.shorten(len(rows), stop)
        return self.first.path[:count].copy() if count else None


def length(path: Array) -> float:
    """Return the length [rad] of a path in joint space, the sum of the lengths of its edges, which AORRTC
    minimizes.
    """
    return float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())


@pipelines["native"].register("AORRTC")
def plan_aorrtc(problem: Problem) -> PlannerResult:
    """Plan a path by AORRTC: use the whole planning time, and return the shortest path that was found.

    `cost_over_time` lists (s, rad) pairs.
    """
    planner = AORRTCPlanner(NativePlanner(problem.checker), problem.settings or AORRTCSettings())
    with stop_flag(problem) as stop:
        answer = planner.plan(
            problem.start, np.vstack(problem.goals), problem.lower, problem.upper, problem.seed, stop
        )
    statistics: dict[str, Any] = {
        "iterations": float(answer.iterations),
        "nodes": float(answer.nodes),
        "rounds": float(answer.rounds),
        "cost_over_time": [(seconds, cost) for seconds, _, cost in answer.history],
    }
    if answer.waypoints is not None and not problem.cancel.is_set():
        return PlannerResult(answer.waypoints, "", statistics, simplified=True)
    return unsolved_result("AORRTC", problem, answer.iterations, answer.closest, statistics)


settings_parsers[plan_aorrtc] = settings_parser("AORRTC", AORRTCSettings)


@lru_cache(maxsize=1)
def warm_up_aorrtc() -> None:
    """Warm up the planner AORRTC: compile its kernels before their first use, so that compilation does not
    consume planning time.
    """
    checker, a, b = small_problem()
    planner, stop = AORRTCPlanner(NativePlanner(checker)), np.zeros(1, np.int64)
    announce_compilation("AORRTC", aorrtc)
    planner.improve(np.vstack([a, b]), *BOUNDS, 1.0, np.ones(1, np.uint64), stop, 1)


first_use_hooks[plan_aorrtc] = warm_up_aorrtc
