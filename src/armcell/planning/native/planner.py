"""The native planner for Python: buffers, seeds, evidence; and its registration."""

# pyright: reportCallIssue=false
# Numba calls intrinsics without their typing context, and splices tuples into compiled calls.
from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from armcell.collision.kernel.block import PADDED
from armcell.collision.kernel.checker import KernelChecker
from armcell.collision.kernel.simd import L
from armcell.planning.native.leaves import new_leaves
from armcell.planning.native.rrt_connect import (
    FOUND,
    ITERATIONS,
    NODES_1,
    UNLIMITED,
    closest_at,
    rrt_connect,
    space_size,
)
from armcell.planning.native.smooth import simplify
from armcell.planning.native.tree import FAR, new_trees

Array = NDArray[np.float64]


@dataclass(frozen=True)
class NativeSettings:
    """Settings of the native planner."""

    reach: float | None = None  # [rad] longest edge of the trees; None: 14 / joints, at most 2
    step: float = 1 / 32  # [rad] between validity checks while searching
    max_nodes: int = 60_000  # per tree
    max_iterations: int = 100_000_000  # the time limit comes first
    max_waypoints: int = 512
    detour: float = 1.45  # times the straight line: a longer path is searched for once more,
    detour_iterations: int = 8000  # if it was found within so many
    slice: int = 1000  # iterations between goals that are streamed


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
    streamed: int = 0  # goals that came while it searched
    closest: Array | None = None  # (2, dof): the nearest that a connection of the trees came, where it failed


class NativePlanner:
    """Plans for one checker; keeps its trees between calls. One per thread."""

    def __init__(self, checker: KernelChecker, settings: NativeSettings = NativeSettings()):
        self.checker, self.settings = checker, settings
        dof = len(checker.joint_names)
        self.reach = settings.reach or min(2.0, 14.0 / dof)
        self.trees = (*new_trees(dof, settings.max_nodes), *new_leaves(dof, settings.max_nodes))
        self.path = np.zeros((settings.max_waypoints, dof))
        self.room = np.zeros(4 * L, np.float32)
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
        """One search, or another `iterations` of the last one; fills `path`.

        Returns:
            Waypoints (0: none yet), iterations and nodes so far.
        """
        s = self.settings
        if not go_on:
            self.found[ITERATIONS] = 0
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
            s.max_iterations if iterations is None else iterations,
            self.path,
        )

    def add_goal(self, q: Array, number: int) -> None:
        """Give the search that goes on another root: row `number` of its goals from now on."""
        nodes, parents, radii = self.trees[:3]
        i = len(parents) // 2 + self.found[NODES_1]
        block = nodes[i // L * L * len(q) :][: L * len(q)].reshape(len(q), L)
        if i % L == 0:
            block[:] = FAR
        block[:, i % L] = q
        parents[i], radii[i] = -1 - number, UNLIMITED
        self.found[NODES_1] += 1

    def shorten(self, count: int, stop: NDArray[np.int64]) -> int:
        """Prove path[:count] and shorten it in place; the new count, 0 if it cannot be proven."""
        c = self.checker
        return simplify(c.handle, self.path, count, self.space, self.index, self.slack, PADDED, stop)

    def shortened(self, waypoints: Array, stop: NDArray[np.int64]) -> Array | None:
        """A path (k, dof) at most as long, every edge proven; None if one of (m, dof) cannot be proven."""
        most = len(self.path)
        pieces = []
        for first in range(0, max(len(waypoints) - 1, 1), most - 1):  # of a long path: piece by piece
            piece = waypoints[first : first + most]
            self.path[: len(piece)] = piece
            count = self.shorten(len(piece), stop)
            if count == 0:
                return None
            pieces.append(self.path[(1 if first else 0) : count].copy())
        return np.vstack(pieces)

    @property
    def closest(self) -> Array | None:
        """(2, dof) of the last search, see `NativeAnswer`."""
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
    ) -> NativeAnswer:
        """A path whose every edge is proven free, or None.

        Args:
            goals: (g, dof). stop: an int64 array (1,); another thread that writes to it ends the search.
            rounds: how often a path that cannot be proven is replaced by another one.
            more_goals: asked for one more goal (dof,) whenever a slice of the search has not found a path.
        """
        stop = np.zeros(1, np.int64) if stop is None else stop
        best = NativeAnswer(None)
        given, straight = len(goals), float(np.min(np.linalg.norm(goals - start, axis=1)))
        for round_ in range(rounds):
            detour = best.waypoints is not None  # found, but a long way round: look once more, not for long
            t0 = time.thread_time()
            ask = (lower, upper, seed + 7919 * round_, stop, self.settings.step / 2**round_)
            if more_goals is None or detour:
                most = 2 * best.iterations + 100 if detour else None
                count, iterations, nodes = self.search(start, goals, *ask, iterations=most)
            else:
                count, iterations, nodes, goals = self._in_slices(start, goals, ask, more_goals)
            t1 = time.thread_time()
            raw = self.path[:count].copy()
            if count:
                count = self.shorten(count, stop)
            t2 = time.thread_time()
            best = replace(
                best,
                plan_s=best.plan_s + t1 - t0,
                simplify_s=best.simplify_s + t2 - t1,
                iterations=best.iterations + iterations,
                nodes=nodes,
                streamed=len(goals) - given,
            )
            if count and (not detour or _length(self.path[:count]) < _length(best.waypoints)):
                best = replace(best, waypoints=self.path[:count].copy(), raw=raw)
            if detour or stop[0] or len(raw) == 0:
                break
            if best.waypoints is not None and (
                best.iterations > self.settings.detour_iterations
                or _length(best.waypoints) <= self.settings.detour * straight
            ):
                break
        return best if best.waypoints is not None else replace(best, closest=self.closest)

    def _in_slices(
        self, start: Array, goals: Array, ask: tuple, more_goals: Iterator[Array]
    ) -> tuple[int, int, int, Array]:
        """`search`, with another goal after each slice; also returns all goals so far."""
        stop, left, go_on = ask[3], self.settings.max_iterations, False
        iterations = 0
        while True:
            before = iterations
            count, iterations, nodes = self.search(
                start, goals, *ask, iterations=min(self.settings.slice, left), go_on=go_on
            )
            left -= iterations - before
            full = iterations - before < self.settings.slice  # stopped, or out of room
            if count or stop[0] or left <= 0 or full:
                return count, iterations, nodes, goals
            go_on = True
            if (goal := next(more_goals, None)) is not None:
                goals = np.vstack([goals, goal])
                self.add_goal(goal, len(goals) - 1)


def _length(path: Array | None) -> float:
    return np.inf if path is None else float(np.sqrt((np.diff(path, axis=0) ** 2).sum(axis=1)).sum())
