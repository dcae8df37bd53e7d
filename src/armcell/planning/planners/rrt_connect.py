"""RRT-Connect, the default planner, and functions that all native planners share."""

# pyright: reportCallIssue=false
# Numba calls intrinsics without their typing context, and splices tuples into compiled calls.
from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armcell.collision.kernel.block import PADDED
from armcell.collision.kernel.checker import KernelChecker
from armcell.collision.kernel.simd import L
from armcell.planning.planners.native.rrt_connect import (
    FOUND,
    ITERATIONS,
    NODES_1,
    UNLIMITED,
    Query,
    closest_at,
    rrt_connect,
    space_size,
)
from armcell.planning.planners.native.simplify import simplify_path
from armcell.planning.planners.native.tree import FAR, new_trees
from armcell.planning.planners.problem import PlannerResult, Problem
from armcell.planning.planners.registry import pipelines, settings_parser, settings_parsers

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RRTConnectSettings:
    """Settings of RRT-Connect, the default planner."""

    range: float | None = None  # [rad] longest edge of the trees; None or 0: 14 / joints, at most 2
    step: float = 1 / 32  # [rad] between validity checks while searching
    max_nodes: int = 60_000  # per tree
    max_iterations: int = 100_000_000  # normally the time limit ends the search first
    max_waypoints: int = 512
    slice: int = 1000  # iterations between streamed goals


@dataclass(frozen=True, eq=False)
class NativeResult:
    """Result of the planner RRT-Connect, or of a planner built on it: waypoints (k, dof) that are proven
    collision-free, or None.

    Times are seconds of this thread's CPU time.
    """

    waypoints: Array | None
    raw: Array | None = None  # path before simplification
    plan_s: float = 0.0
    simplify_s: float = 0.0
    certify_s: float = 0.0
    iterations: int = 0
    nodes: int = 0
    streamed: int = 0  # goals added during the search
    closest: Array | None = None  # (2, dof): ends of the shortest failed connection; only without a path


class NativePlanner:
    """The planner RRT-Connect for one collision checker. It searches a path and then simplifies it.

    The planner keeps its trees between calls. Use one instance per thread.
    """

    def __init__(self, checker: KernelChecker, settings: RRTConnectSettings = RRTConnectSettings()):
        self.checker, self.settings = checker, settings
        dof = len(checker.joint_names)
        self.reach = settings.range or min(2.0, 14.0 / dof)
        self.trees = new_trees(dof, settings.max_nodes)
        self.path = np.zeros((settings.max_waypoints, dof))
        self.space = np.zeros(len(self.path) * (6 * dof + 8))
        self.index = np.zeros(4 * len(self.path), np.int64)
        self.ends = np.zeros(space_size(dof))
        self.found = np.zeros(FOUND, np.int64)
        self.slack = np.zeros(dof)

    def search(
        self,
        start: Array,
        goals: Array,
        lower: Array,
        upper: Array,
        seed: int,
        stop: NDArray[np.int64],
        step: float,
        iterations: int | None = None,
        go_on: bool = False,
    ) -> tuple[int, int, int]:
        """Run one search by RRT-Connect, or continue the last one, and write the path to `self.path`.

        With `go_on`, the last search continues for another `iterations`.

        Returns:
            Waypoints (0: none yet), iterations and nodes so far.
        """
        s = self.settings
        if not go_on:
            self.found[ITERATIONS] = 0
        shift = np.random.default_rng(seed).random(len(start)) if seed else np.full(len(start), 0.5)
        return rrt_connect(
            self.checker.handle,
            Query(start, goals, lower, upper, shift, self.reach, step),
            self.trees,
            self.ends,
            self.found,
            stop,
            s.max_iterations if iterations is None else iterations,
            self.path,
        )

    def add_goal(self, q: Array, number: int) -> None:
        """Add another goal to a running RRT-Connect search, as a further root of the goal tree.

        The goal becomes row `number` of the goals.
        """
        trees = self.trees
        i = trees.capacity + self.found[NODES_1]
        block = trees.nodes[i // L * L * len(q) :][: L * len(q)].reshape(len(q), L)
        if i % L == 0:
            block[:] = FAR
        block[:, i % L] = q
        trees.parents[i], trees.radii[i] = -1 - number, UNLIMITED
        self.found[NODES_1] += 1

    def shorten(self, count: int, stop: NDArray[np.int64]) -> int:
        """Prove that the path through the waypoints path[:count] of the planner RRT-Connect is
        collision-free, and shorten it in place.

        Return the new count, or 0 if a proof fails.
        """
        c = self.checker
        return simplify_path(c.handle, self.path, count, self.space, self.index, self.slack, PADDED, stop)

    def shortened(self, waypoints: Array, stop: NDArray[np.int64]) -> Array | None:
        """Let the planner RRT-Connect shorten a path (m, dof), and return waypoints (k, dof) that are proven
        collision-free.

        Return None if an edge cannot be proven.
        """
        most = len(self.path)
        pieces = []
        for first in range(0, max(len(waypoints) - 1, 1), most - 1):  # simplify a long path piece by piece
            piece = waypoints[first : first + most]
            self.path[: len(piece)] = piece
            count = self.shorten(len(piece), stop)
            if count == 0:
                return None
            pieces.append(self.path[(1 if first else 0) : count].copy())
        return np.vstack(pieces)

    @property
    def closest(self) -> Array | None:
        """Closest approach of the two trees in the last RRT-Connect search: the two configurations (2, dof)
        that were nearest to each other.

        See `NativeResult`.
        """
        dof = len(self.slack)
        at = closest_at(dof)
        return self.ends[at + 1 :].reshape(2, dof).copy() if np.isfinite(self.ends[at]) else None

    def plan(
        self,
        start: Array,
        goals: Array,
        lower: Array,
        upper: Array,
        seed: int = 0,
        stop: NDArray[np.int64] | None = None,
        rounds: int = 5,
        more_goals: Iterator[Array] | None = None,
    ) -> NativeResult:
        """Plan a path by RRT-Connect in which every edge is proven collision-free.

        The result has no waypoints if none was found.

        Args:
            goals: (g, dof). stop: an int64 array (1,); another thread that writes to it ends the search.
            rounds: maximum number of searches for another path if a path cannot be proven.
            more_goals: yields one more goal (dof,) whenever a slice of the search has not found a path.
        """
        stop = np.zeros(1, np.int64) if stop is None else stop
        answer, closest = NativeResult(None), nearest_roots(start, goals)
        given = len(goals)
        for round_ in range(rounds):
            t0 = time.thread_time()
            ask = (lower, upper, seed + 7919 * round_, stop, self.settings.step / 2**round_)
            if more_goals is None:
                count, iterations, nodes = self.search(start, goals, *ask)
            else:
                count, iterations, nodes, goals = self._in_slices(start, goals, ask, more_goals)
            t1 = time.thread_time()
            closest = shorter(closest, self.closest)
            raw = self.path[:count].copy()
            if count:
                count = self.shorten(count, stop)
            t2 = time.thread_time()
            answer = replace(
                answer,
                plan_s=answer.plan_s + t1 - t0,
                simplify_s=answer.simplify_s + t2 - t1,
                iterations=answer.iterations + iterations,
                nodes=nodes,
                streamed=len(goals) - given,
            )
            if count:
                return replace(answer, waypoints=self.path[:count].copy(), raw=raw)
            if stop[0] or len(raw) == 0:
                break
        return replace(answer, closest=closest)

    def _in_slices(
        self, start: Array, goals: Array, ask: tuple, more_goals: Iterator[Array]
    ) -> tuple[int, int, int, Array]:
        """Run RRT-Connect in several slices of iterations, and add one more goal after each slice.

        Return the search result and all goals.
        """
        stop, left, go_on = ask[3], self.settings.max_iterations, False
        iterations = 0
        while True:
            before = iterations
            count, iterations, nodes = self.search(
                start, goals, *ask, iterations=min(self.settings.slice, left), go_on=go_on
            )
            left -= iterations - before
            full = iterations - before < self.settings.slice  # stopped, or out of memory
            if count or stop[0] or left <= 0 or full:
                return count, iterations, nodes, goals
            go_on = True
            if (goal := next(more_goals, None)) is not None:
                goals = np.vstack([goals, goal])
                self.add_goal(goal, len(goals) - 1)


def nearest_roots(start: Array, goals: Array) -> Array:
    """Return the start and its nearest goal as an array (2, dof).
    This is the first pair of roots that RRT-Connect can connect.

    This pair is the closest approach of the trees before any search.
    """
    return np.stack([start, goals[np.argmin(np.linalg.norm(goals - start, axis=1))]])


def shorter(known: Array, other: Array | None) -> Array:
    """Return the shorter of two connections (2, dof) between the trees of RRT-Connect, measured in joint
    space [rad].
    """
    if other is None or np.linalg.norm(known[1] - known[0]) <= np.linalg.norm(other[1] - other[0]):
        return known
    return other


POLL = 0.002  # [s] period of the watcher
FINE = 0.01  # [rad] between samples of a blocked connection


@pipelines["native"].register("RRTConnect")
def plan_rrt_connect(problem: Problem) -> PlannerResult:
    """Plan by RRT-Connect, and return a simplified path in which every edge is proven collision-free."""
    planner = planner_of(problem.checker, problem.settings)
    with stop_flag(problem) as stop:
        answer = planner.plan(
            problem.start, np.vstack(problem.goals), problem.lower, problem.upper, problem.seed, stop,
            more_goals=problem.more_goals,
        )  # fmt: skip
    statistics: dict[str, Any] = {
        "iterations": float(answer.iterations),
        "nodes": float(answer.nodes),
        "plan_us": answer.plan_s * 1e6,
        "simplify_us": answer.simplify_s * 1e6,
        "certify_us": answer.certify_s * 1e6,
    }
    if problem.more_goals is not None:
        statistics["streamed_goals"] = float(answer.streamed)
    if answer.waypoints is not None:
        return PlannerResult(answer.waypoints, "", statistics, simplified=True)
    return unsolved_result("RRTConnect", problem, answer.iterations, answer.closest, statistics)


settings_parsers[plan_rrt_connect] = settings_parser("RRTConnect", RRTConnectSettings)


def unsolved_result(
    planner: str, problem: Problem, iterations: int, closest: NDArray[np.float64] | None, statistics: dict
) -> PlannerResult:
    """Create the result of an RRT-Connect search that found no path.

    The result reports how near the trees came and which contacts blocked them.

    Args:
        closest: (2, dof) ends of the shortest connection between the trees that failed.
        statistics: receives `closest_approach_rad`, and `blocked_by` (contacts) if it is known.
    """
    seconds, nodes = time.monotonic() - problem.began, statistics.get("nodes")
    statistics.setdefault("iterations", float(iterations))
    if problem.cancel.is_set():
        return PlannerResult(None, f"{planner}: cancelled after {seconds:.2f} s", statistics)
    text = f"{planner}: no path found in {seconds:.2f} s"
    if nodes is not None:
        text += f" ({nodes:.0f} configurations reached)"
    if closest is not None:
        gap = float(np.linalg.norm(closest[1] - closest[0]))
        statistics["closest_approach_rad"] = gap
        text += f"; the trees from start and goal came within {gap:.2f} rad of each other"
        if contacts := _in_the_way(problem, closest):
            statistics["blocked_by"] = contacts
            text += f", there {contacts[0].describe()}"
    return PlannerResult(None, text, statistics)


def _in_the_way(problem: Problem, closest: NDArray[np.float64]) -> list:
    """Find the contacts that kept the two RRT-Connect trees apart, at the first configuration in collision
    on their shortest failed connection.
    """
    a, b = closest
    for t in np.linspace(0.0, 1.0, max(int(np.linalg.norm(b - a) / FINE), 2)):
        q = a + t * (b - a)
        if not problem.checker.is_free(q):
            return problem.checker.exact.contacts(q)
    return []


_of_thread = threading.local()


def planner_of(checker: KernelChecker, settings: RRTConnectSettings | None = None) -> NativePlanner:
    """Return the current thread's planner RRT-Connect for a collision checker.

    Each thread reuses one planner per number of joints, because the trees of a planner are large.
    Settings other than the default create a new planner.
    """
    if settings not in (None, RRTConnectSettings()):
        return NativePlanner(checker, settings)
    kept: dict[int, NativePlanner] = _of_thread.__dict__.setdefault("planners", {})
    dof = len(checker.joint_names)
    if dof not in kept:
        kept[dof] = NativePlanner(checker)
    kept[dof].checker = checker
    return kept[dof]


@contextmanager
def stop_flag(problem: Problem) -> Iterator[NDArray[np.int64]]:
    """Provide a stop flag for RRT-Connect and other compiled searches, which is set at the deadline or when
    the request is canceled.
    """
    stop, done = np.zeros(1, np.int64), threading.Event()

    def watch() -> None:
        while not done.wait(POLL):
            if problem.cancel.is_set() or time.monotonic() > problem.deadline:
                stop[0] = 1
                return

    watcher = threading.Thread(target=watch, name="armcell-planner-watch", daemon=True)
    watcher.start()
    try:
        yield stop
    finally:
        done.set()
        watcher.join()


def simplify(problem: Problem, waypoints: Array) -> Array | None:
    """Let the planner RRT-Connect simplify a path (m, n) that another planner found. The first and last
    waypoints do not change.

    Return None if an edge cannot be proven.

    Args:
        waypoints: (m, n); edges checked at samples or not at all.
    """
    planner = planner_of(problem.checker)
    with stop_flag(problem) as stop:
        return planner.shortened(waypoints, stop)
