"""PRM planner: one roadmap per robot and group, kept between queries, repaired on changes.

If the roadmap has no path, it grows by uniform samples, and RRT-Connect from the query's start and goals
runs, longer each time; its path joins the roadmap. Narrow passages, which uniform samples hardly ever find,
are therefore in the roadmap after the first query through them (compare Coleman, Sucan, Moll, Okada and
Correll, "Experience-based planning with sparse roadmap spanners", ICRA 2015).
"""

# pyright: reportCallIssue=false
# Numba calls intrinsics without their typing context, and splices tuples into compiled calls.
from __future__ import annotations

import hashlib
import threading
import time
from dataclasses import dataclass
from functools import lru_cache
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from armcell.collision.kernel.checker import KernelChecker
from armcell.collision.kernel.motion import prove_points
from armcell.collision.kernel.simd import L
from armcell.model import RobotModel
from armcell.planning.first_compile import BOUNDS, small_problem
from armcell.planning.planners.native import roadmap as compiled
from armcell.planning.planners.native.roadmap import Graph, Search, query
from armcell.planning.planners.native.rrt_connect import Samples, kronecker_steps
from armcell.planning.planners.problem import PlannerResult, Problem
from armcell.planning.planners.registry import (
    announce_compilation,
    first_use_hooks,
    pipelines,
    settings_parser,
    settings_parsers,
)
from armcell.planning.planners.rrt_connect import (
    POLL,
    NativePlanner,
    nearest_roots,
    shorter,
    stop_flag,
    unsolved_result,
)

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PRMSettings:
    """Settings of the planner PRM."""

    max_vertices: int = 16_384  # a multiple of 16
    blocks: int = 4  # blocks of 16 samples by which the roadmap grows when a query finds no path
    slice: int = 1000  # iterations of the first RRT-Connect; doubled for each further one


@dataclass(frozen=True, eq=False)
class PRMResult:
    """Result of a query to the planner PRM: waypoints (k, dof) that are proven collision-free, or None, with
    statistics.

    Attributes:
        vertex_checks, edge_checks: number of checks in this query.
        bridged: whether RRT-Connect found the path.
        closest: see `NativeResult`.
    """

    waypoints: Array | None
    plan_s: float  # [s] CPU time of this thread, including simplification
    vertices: int
    edges: int
    vertex_checks: int
    edge_checks: int
    bridged: bool = False
    iterations: int = 0
    closest: Array | None = None


class Roadmap:
    """PRM roadmap for one group of joints. It is kept between queries and can be used in any scene.

    Hold `lock` during a query.
    """

    def __init__(self, dof: int, settings: PRMSettings = PRMSettings(), seed: int = 0):
        self.settings, self.lock = settings, threading.Lock()
        n = settings.max_vertices
        edges = n * compiled.MAX_NEIGHBORS
        self.graph = Graph(
            np.empty(n * dof, np.float32), np.full(n, -1, np.int32), np.empty(2 * edges, np.int32),
            np.empty(2 * edges, np.int32), np.empty(edges, np.float32), np.zeros(n, np.int32),
            np.zeros(edges, np.int32), np.zeros(compiled.COUNTS, np.int64),
            np.zeros(compiled.MAX_NEIGHBORS, np.int32), np.zeros(compiled.MAX_NEIGHBORS, np.float32),
            np.zeros(L, np.float32),
        )  # fmt: skip
        self.search = Search(
            np.zeros(n, np.int64), np.empty(n), np.empty(n, np.int32), np.empty(2 * edges),
            np.empty(2 * edges, np.int32), np.zeros(2 * dof),
        )  # fmt: skip
        self.steps = np.zeros(dof)
        kronecker_steps(dof, self.steps)
        self.sample = np.random.default_rng(seed).random(dof)
        self.block, self.no_room = np.zeros(L * dof), np.zeros(dof)
        self.stamp, self._scene = 0, b""

    def recheck_vertices(self, checker: KernelChecker, stop: NDArray[np.int64]) -> None:
        """Check every vertex of a PRM roadmap in the scene of the checker, unless the last query used the
        same scene.
        """
        digest = hashlib.blake2b(digest_size=16)
        for array in checker.flat:
            digest.update(array.data)
        if digest.digest() != self._scene:
            self._scene = digest.digest()
            self.stamp += 1
        compiled.recheck(checker.handle, self.no_room, self.graph, self.stamp, stop)

    def grow(self, checker: KernelChecker, lower: Array, upper: Array, blocks: int, stop) -> None:
        """Extend a PRM roadmap: sample 16 * `blocks` configurations, and add the collision-free ones."""
        samples = Samples(lower, upper, self.steps, self.sample)
        compiled.grow(checker.handle, self.no_room, self.graph, self.stamp, samples, self.block, blocks, stop)

    def insert(self, path: Array, joined: bool) -> NDArray[np.int32]:
        """Add collision-free configurations, and optionally the edges between them, to a PRM roadmap.

        Return the numbers of the vertices.
        """
        numbers = np.zeros(len(path), np.int32)
        rows = np.ascontiguousarray(path)
        compiled.insert(self.graph, self.stamp, rows, numbers, joined)
        return numbers

    def query(self, checker, start: int, goals, step: float, path: Array, route, stop) -> int:
        """Find the shortest collision-free path on a PRM roadmap.

        See native.roadmap.query.
        """
        return compiled.query(
            checker.handle, self.graph, self.stamp, start, goals, step, self.search, route, path, stop
        )


def plan_with_roadmap(
    roadmap: Roadmap, planner: NativePlanner, start: Array, goals: Array, lower: Array, upper: Array,
    seed: int = 0, stop: NDArray[np.int64] | None = None,
) -> PRMResult:  # fmt: skip
    """Plan by PRM on a roadmap from earlier queries, and add the new path to the roadmap. Every edge of the
    path is proven collision-free.

    The result depends on earlier queries; the same queries in the same order give the same results.

    Args:
        goals: (g, dof). stop: an int64 array (1,) that another thread writes to.
    """
    began, before = time.thread_time(), roadmap.graph.counts.copy()
    stop = np.zeros(1, np.int64) if stop is None else stop
    checker, step, settings = planner.checker, planner.settings.step, roadmap.settings
    roadmap.recheck_vertices(checker, stop)
    first = int(roadmap.insert(start[None], False)[0])
    last = roadmap.insert(goals, False)
    route = np.zeros(len(planner.path), np.int32)
    more, iterations, bridged, tried = settings.slice, 0, False, 0
    closest = nearest_roots(start, goals)  # over all searches: a new search may stop before it has one

    def answer(waypoints: Array | None) -> PRMResult:
        now = roadmap.graph.counts - before
        return PRMResult(
            waypoints, time.thread_time() - began, int(roadmap.graph.counts[compiled.VERTICES]),
            int(roadmap.graph.counts[compiled.EDGES]), int(now[compiled.VERTEX_CHECKS]),
            int(now[compiled.EDGE_CHECKS]), bridged, iterations,
            None if waypoints is not None else closest,
        )  # fmt: skip

    if first < 0 or last.max() < 0:
        return answer(None)
    while not stop[0]:
        count = roadmap.query(checker, first, last, step, planner.path, route, stop)
        if count:
            raw, edges = planner.path[:count].copy(), route[: count - 1].copy()
            raw[0], raw[-1] = start, goals[np.argmin(np.linalg.norm(goals - raw[-1], axis=1))]
            planner.path[:count] = raw
            if count == 1:
                return answer(np.vstack([start, raw[-1]]))
            count = planner.shorten(count, stop)
            if count:
                return answer(planner.path[:count].copy())
            failed = [
                prove_points(checker.handle, rows, roadmap.no_room, 0.0, 0) >= 0
                for rows in np.stack([raw[:-1], raw[1:]], axis=1)
            ]
            roadmap.graph.edge_stamps[edges[failed] if any(failed) else edges] = -roadmap.stamp
            step /= 2
            continue
        if iterations >= planner.settings.max_iterations:
            break
        roadmap.grow(checker, lower, upper, settings.blocks, stop)
        count, now, _ = planner.search(start, goals, lower, upper, seed + 7919 * tried, stop, step, more)
        iterations, more, tried = iterations + now, 2 * more, tried + 1
        closest = shorter(closest, planner.closest)
        if count:
            bridged = True
            roadmap.insert(planner.path[:count], True)
    return answer(None)


_roadmaps: WeakKeyDictionary[RobotModel, dict[tuple, Roadmap]] = WeakKeyDictionary()
_lock = threading.Lock()


def roadmap_of(
    model: RobotModel, joint_names: tuple[str, ...], settings: PRMSettings = PRMSettings()
) -> Roadmap:
    """Return the PRM roadmap for a robot model, a group and settings. The first call creates it."""
    with _lock:
        kept = _roadmaps.setdefault(model, {})
        key = (joint_names, settings)
        if key not in kept:
            kept[key] = Roadmap(len(joint_names), settings)
        return kept[key]


@pipelines["native"].register("PRM")
def plan_prm(problem: Problem) -> PlannerResult:
    """Plan by PRM: find a path on the roadmap, prove that it is collision-free, and simplify it.

    Every query extends the roadmap.
    """
    roadmap = roadmap_of(problem.checker.model, problem.joint_names, problem.settings or PRMSettings())
    planner = NativePlanner(problem.checker)
    goals = np.vstack(problem.goals)
    with stop_flag(problem) as stop:
        while not roadmap.lock.acquire(timeout=POLL):
            if stop[0]:
                return unsolved_result("PRM", problem, 0, nearest_roots(problem.start, goals), {})
        try:
            found = plan_with_roadmap(
                roadmap, planner, problem.start, goals, problem.lower, problem.upper, problem.seed, stop
            )
        finally:
            roadmap.lock.release()
    statistics = {
        "plan_us": found.plan_s * 1e6,
        "vertices": float(found.vertices),
        "edges": float(found.edges),
        "vertex_checks": float(found.vertex_checks),
        "edge_checks": float(found.edge_checks),
        "iterations": float(found.iterations),
    }
    if found.waypoints is not None:
        return PlannerResult(found.waypoints, "", statistics, simplified=True)
    return unsolved_result("PRM", problem, found.iterations, found.closest, statistics)


@lru_cache(maxsize=1)
def warm_up_roadmap() -> None:
    """Compile the kernels of the planner PRM before their first use."""
    checker, a, b = small_problem()
    planner, roadmap, stop = NativePlanner(checker), Roadmap(1), np.zeros(1, np.int64)
    announce_compilation("PRM", query)
    plan_with_roadmap(roadmap, planner, a, b[None], *BOUNDS)
    roadmap.grow(checker, *BOUNDS, 1, stop)  # kernels for queries without a straight connection
    roadmap.insert(np.vstack([a, b]), True)
    prove_points(checker.handle, np.vstack([a, b]), roadmap.no_room, 0.0, 0)


settings_parsers[plan_prm] = settings_parser("PRM", PRMSettings)
first_use_hooks[plan_prm] = warm_up_roadmap
