"""The native planner for Python: buffers, seeds, evidence; and its registration."""

# pyright: reportCallIssue=false
# Numba calls intrinsics without their typing context, and splices tuples into compiled calls.
from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from armcell.collision.kernel.block import PADDED
from armcell.collision.kernel.checker import KernelChecker
from armcell.collision.kernel.simd import L
from armcell.planning.native.rrt_connect import rrt_connect
from armcell.planning.native.smooth import simplify
from armcell.planning.native.tree import new_trees

Array = NDArray[np.float64]


@dataclass(frozen=True)
class NativeSettings:
    """Settings of the native planner."""

    reach: float | None = None  # [rad] longest edge of the trees; None: 14 / joints, at most 2
    step: float = 1 / 32  # [rad] between validity checks while searching
    max_nodes: int = 60_000  # per tree
    max_iterations: int = 100_000_000  # the time limit comes first
    max_waypoints: int = 512
    detour: float = 1.45  # times the straight line: a longer path is searched for once more


@dataclass(frozen=True, eq=False)
class NativeAnswer:
    """Waypoints (k, dof) proven free, or None; times in seconds of this thread's CPU."""

    waypoints: Array | None
    raw: Array | None = None  # before simplification
    plan_s: float = 0.0
    simplify_s: float = 0.0
    certify_s: float = 0.0
    iterations: int = 0
    nodes: int = 0


class NativePlanner:
    """Plans for one checker; keeps its trees between calls. One per thread."""

    def __init__(self, checker: KernelChecker, settings: NativeSettings = NativeSettings()):
        self.checker, self.settings = checker, settings
        dof = len(checker.joint_names)
        self.reach = settings.reach or min(2.0, 14.0 / dof)
        self.trees = new_trees(dof, settings.max_nodes)
        self.path = np.zeros((settings.max_waypoints, dof))
        self.room = np.zeros(4 * L, np.float32)
        self.space = np.zeros(len(self.path) * (6 * dof + 8))
        self.index = np.zeros(4 * len(self.path), np.int64)
        self.ends = np.zeros(5 * dof)
        self.found = np.zeros(4, np.int64)
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
        max_iterations: int | None = None,
    ) -> tuple[int, int, int]:
        """One search; fills `path` and returns waypoints, iterations, nodes."""
        s = self.settings
        shift = np.random.default_rng(seed).random(len(start)) if seed else np.full(len(start), 0.5)
        return rrt_connect(
            self.checker.handle,
            start,
            goals,
            lower,
            upper,
            shift,
            self.reach,
            step,
            *self.trees,
            self.room,
            self.ends,
            self.found,
            stop,
            max_iterations or s.max_iterations,
            self.path,
        )

    def plan(
        self,
        start: Array,
        goals: Array,
        lower: Array,
        upper: Array,
        seed: int = 0,
        stop: NDArray[np.int64] | None = None,
        rounds: int = 5,
    ) -> NativeAnswer:
        """A path whose every edge is proven free, or None.

        Args:
            goals: (g, dof). stop: an int64 array (1,); another thread that writes to it ends the search.
            rounds: how often a path that cannot be proven is replaced by another one.
        """
        stop = np.zeros(1, np.int64) if stop is None else stop
        best = NativeAnswer(None)
        straight = float(np.min(np.linalg.norm(goals - start, axis=1)))
        for round_ in range(rounds):
            detour = best.waypoints is not None  # found, but a long way round: look once more, not for long
            t0 = time.thread_time()
            count, iterations, nodes = self.search(
                start, goals, lower, upper, seed + 7919 * round_, stop, self.settings.step / 2**round_,
                2 * best.iterations + 100 if detour else None,
            )  # fmt: skip
            t1 = time.thread_time()
            raw = self.path[:count].copy()
            if count:
                count = simplify(
                    self.checker.handle, self.path, count, self.space, self.index, self.slack, PADDED
                )
            t2 = time.thread_time()
            best = replace(
                best,
                plan_s=best.plan_s + t1 - t0,
                simplify_s=best.simplify_s + t2 - t1,
                iterations=best.iterations + iterations,
                nodes=nodes,
            )
            if count and (not detour or _length(self.path[:count]) < _length(best.waypoints)):
                best = replace(best, waypoints=self.path[:count].copy(), raw=raw)
            if detour or stop[0] or len(raw) == 0:
                break
            if best.waypoints is not None and _length(best.waypoints) <= self.settings.detour * straight:
                break
        return best


def _length(path: Array | None) -> float:
    return np.inf if path is None else float(np.sqrt((np.diff(path, axis=0) ** 2).sum(axis=1)).sum())
