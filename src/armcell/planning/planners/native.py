"""The native RRT-Connect as a planner of the pipeline; what all native planners share."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armcell.collision.kernel.checker import KernelChecker
from armcell.planning.native.planner import NativePlanner, NativeSettings
from armcell.planning.parameters import settings_of
from armcell.planning.problem import Answer, Problem, pipelines, settings_makers

POLL = 0.002  # [s] how often the watcher looks whether to stop
FINE = 0.01  # [rad] between the samples that look for what blocks a connection


@pipelines["native"].register("RRTConnect")
def rrt_connect(problem: Problem) -> Answer:
    """A path proven free and already shortened."""
    planner = planner_of(problem.checker, problem.settings)
    with stopping(problem) as stop:
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
        return Answer(answer.waypoints, "", statistics, simplified=True)
    return unsolved("RRTConnect", problem, answer.iterations, answer.closest, statistics)


settings_makers[rrt_connect] = settings_of("RRTConnect", NativeSettings)


def unsolved(
    planner: str, problem: Problem, iterations: int, closest: NDArray[np.float64] | None, statistics: dict
) -> Answer:
    """An answer without a path, with what was tried: how near the trees came, and what was in the way.

    Args:
        closest: (2, dof) the ends of the shortest connection between the trees that failed.
        statistics: gets `closest_approach_rad`, and `blocked_by` (contacts) where it is known.
    """
    if problem.cancel.is_set():
        return Answer(None, f"{planner}: cancelled after {iterations} iterations", statistics)
    text = f"{planner}: no path found after {iterations} iterations"
    if closest is not None:
        gap = float(np.linalg.norm(closest[1] - closest[0]))
        statistics["closest_approach_rad"] = gap
        text += f"; the trees from start and goal came within {gap:.2f} rad of each other"
        if contacts := _in_the_way(problem, closest):
            statistics["blocked_by"] = contacts
            text += f", there {contacts[0].describe()}"
    return Answer(None, text, statistics)


def _in_the_way(problem: Problem, closest: NDArray[np.float64]) -> list:
    """The contacts at the first configuration on a failed connection that is not free."""
    a, b = closest
    for t in np.linspace(0.0, 1.0, max(int(np.linalg.norm(b - a) / FINE), 2)):
        q = a + t * (b - a)
        if not problem.checker.is_free(q):
            return problem.checker.exact.contacts(q)
    return []


_of_thread = threading.local()


def planner_of(checker: KernelChecker, settings: NativeSettings | None = None) -> NativePlanner:
    """This thread's planner for that many joints: its trees are large. One with other settings is new."""
    if settings not in (None, NativeSettings()):
        return NativePlanner(checker, settings)
    kept: dict[int, NativePlanner] = _of_thread.__dict__.setdefault("planners", {})
    dof = len(checker.joint_names)
    if dof not in kept:
        kept[dof] = NativePlanner(checker)
    kept[dof].checker = checker
    return kept[dof]


@contextmanager
def stopping(problem: Problem) -> Iterator[NDArray[np.int64]]:
    """A flag for the compiled search, set when the problem's time is up or it is cancelled."""
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
