"""A path that gets shorter for as long as there is time: AORRTC with simplification between its rounds.

What AORRTC finds has to be shorter than the best path as it is found, before anything shortens it. Early on
that is rare, and a few quick first paths from other samples, shortened, gain more: each round begins with
some.
"""

# pyright: reportCallIssue=false
# Numba calls intrinsics without their typing context, and splices tuples into compiled calls.
from __future__ import annotations

import time
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from armcell.collision.kernel.simd import L
from armcell.planning.native.aorrtc import aorrtc
from armcell.planning.native.compiling import announce
from armcell.planning.native.leaves import new_leaves
from armcell.planning.native.planner import NativePlanner
from armcell.planning.native.rrt_connect import FOUND
from armcell.planning.native.tree import new_trees

Array = NDArray[np.float64]

SHORTEST = 1e-4
"""A path longer than the straight line by less than this share is as short as any."""


@dataclass(frozen=True)
class AnytimeSettings:
    """Settings of the anytime planner. Only a budget of iterations gives the same path for the same seed."""

    max_iterations: int = 1_000_000_000  # of the search, all rounds
    gain: float = 1e-3  # a round must find a path that is shorter by this share
    least_gain: float = 1e-4  # what counts as shorter when the path is polished
    round_iterations: int = 2000  # of a round after an improvement; twice as many after each without one
    max_nodes: int = 16_384  # per tree and round (a multiple of 16); then the round begins anew
    restarts: int = 8  # other first paths in such a round: shortened, one may be better than any so far
    polish: int = 3  # attempts in a row to shorten a new path locally that may fail before the next round


@dataclass(frozen=True, eq=False)
class AnytimeAnswer:
    """The shortest path found, every edge proven free, or None.

    Attributes:
        history: (seconds of wall time, iterations, cost [rad]) at every improvement, the first path's first.
        closest: see `NativeAnswer`.
    """

    waypoints: Array | None
    history: list[tuple[float, int, float]] = field(default_factory=list)
    iterations: int = 0
    nodes: int = 0
    rounds: int = 0
    closest: Array | None = None


class AnytimePlanner:
    """Improves the paths of a native planner. One per thread."""

    def __init__(self, first: NativePlanner, settings: AnytimeSettings = AnytimeSettings()):
        self.first, self.settings = first, settings
        dims = len(first.slack) + 1
        self.trees = (*new_trees(dims, settings.max_nodes), *new_leaves(dims, settings.max_nodes))
        self.room = np.zeros(L, np.float32)
        self.space = np.zeros(4 * dims)
        self.found = np.zeros(FOUND, np.int64)

    def plan(
        self, start: Array, goals: Array, lower: Array, upper: Array, seed: int = 0,
        stop: NDArray[np.int64] | None = None,
    ) -> AnytimeAnswer:  # fmt: skip
        """The shortest path found until `stop` is set, the iterations are used up or it cannot be shorter.

        Args:
            goals: (g, dof). stop: an int64 array (1,) that another thread writes to.
        """
        began, stop = time.monotonic(), np.zeros(1, np.int64) if stop is None else stop
        announce("AORRTC", aorrtc)
        answer = self.first.plan(start, goals, lower, upper, seed, stop)
        if answer.waypoints is None:
            return AnytimeAnswer(None, [], answer.iterations, answer.nodes, 0, answer.closest)
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
            count, more, nodes = self._round(roots, lower, upper, bound, random, stop, min(left, limit))
            iterations, rounds, most = iterations + more, rounds + 1, max(most, nodes)
            count = self.first.shorten(count, stop) if count else 0
            if count and length(self.first.path[:count]) < length(best):
                improved = True
                keep(self.first.path[:count].copy())
            limit = settings.round_iterations if improved else 2 * limit
        return AnytimeAnswer(best, history, iterations, most, rounds)

    def _round(self, roots, lower, upper, bound, random, stop, iterations) -> tuple[int, int, int]:
        first = self.first
        return aorrtc(
            first.checker.handle, roots, lower, upper, bound, first.reach, first.settings.step, *self.trees,
            self.room, self.space, random, self.found, stop, iterations, first.path,
        )  # fmt: skip

    def _polished(self, path: Array, rng: np.random.Generator, stop: NDArray[np.int64]) -> Array | None:
        """The path with its edges cut at random places and shortened again, or None if it got too long."""
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
    """[rad], the sum of the edges' norms in joint space."""
    return float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())
