"""The native planner for Python: buffers, seeds, evidence; and its registration."""

# pyright: reportCallIssue=false
# Numba calls intrinsics without their typing context, and splices tuples into compiled calls.
from __future__ import annotations

import time
from dataclasses import dataclass

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
    ) -> tuple[int, int, int]:
        """One search; fills `path` and returns waypoints, iterations, nodes."""
        c, s = self.checker, self.settings
        shift = np.random.default_rng(seed).random(len(start)) if seed else np.full(len(start), 0.5)
        return rrt_connect(
            *c.arrays,
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
            s.max_iterations,
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
        c, stop = self.checker, np.zeros(1, np.int64) if stop is None else stop
        plan_s = certify_s = simplify_s = 0.0
        iterations = nodes = 0
        for round_ in range(rounds):
            t0 = time.thread_time()
            step = self.settings.step / 2**round_
            count, more, nodes = self.search(start, goals, lower, upper, seed + 7919 * round_, stop, step)
            iterations += more
            t1 = time.thread_time()
            plan_s += t1 - t0
            if count == 0:
                break
            raw = self.path[:count].copy()
            count = simplify(*c.arrays, self.path, count, self.space, self.index, self.slack, PADDED)
            simplify_s += time.thread_time() - t1
            if count == 0:
                continue
            return NativeAnswer(
                self.path[:count].copy(), raw, plan_s, simplify_s, certify_s, iterations, nodes
            )
        return NativeAnswer(None, None, plan_s, simplify_s, certify_s, iterations, nodes)
