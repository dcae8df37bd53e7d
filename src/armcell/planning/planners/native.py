"""The native RRT-Connect as a planner of the pipeline."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray

from armcell.collision.kernel.checker import KernelChecker
from armcell.planning.native.planner import NativePlanner
from armcell.planning.problem import Answer, Problem, pipelines

POLL = 0.002  # [s] how often the watcher looks whether to stop


@pipelines["native"].register("RRTConnect")
def rrt_connect(problem: Problem) -> Answer:
    """A path proven free and already shortened."""
    planner = _planner(problem.checker)
    with _stopping(problem) as stop:
        answer = planner.plan(
            problem.start, np.vstack(problem.goals), problem.lower, problem.upper, problem.seed, stop
        )
    statistics = {
        "iterations": float(answer.iterations),
        "nodes": float(answer.nodes),
        "plan_us": answer.plan_s * 1e6,
        "simplify_us": answer.simplify_s * 1e6,
        "certify_us": answer.certify_s * 1e6,
    }
    if answer.waypoints is not None:
        return Answer(answer.waypoints, "", statistics, simplified=True)
    reason = "cancelled" if problem.cancel.is_set() else "no path found"
    return Answer(None, f"RRTConnect: {reason} after {answer.iterations} iterations", statistics)


_of_thread = threading.local()


def _planner(checker: KernelChecker) -> NativePlanner:
    """This thread's planner for that many joints: its trees are large."""
    kept: dict[int, NativePlanner] = _of_thread.__dict__.setdefault("planners", {})
    dof = len(checker.joint_names)
    if dof not in kept:
        kept[dof] = NativePlanner(checker)
    kept[dof].checker = checker
    return kept[dof]


@contextmanager
def _stopping(problem: Problem) -> Iterator[NDArray[np.int64]]:
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
