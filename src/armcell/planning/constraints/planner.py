"""The native planner on a manifold of constraints: buffers, seeds, rounds."""

# pyright: reportCallIssue=false
# Numba calls intrinsics without their typing context, and splices tuples into compiled calls.
from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from armcell.collision.kernel.checker import KernelChecker
from armcell.planning.constraints.description import Manifold
from armcell.planning.constraints.search import closest_at, constrained_rrt_connect, space_size
from armcell.planning.constraints.smooth import shorten
from armcell.planning.native.planner import NativePlanner, NativeSettings
from armcell.planning.native.rrt_connect import ITERATIONS
from armcell.planning.planners.native import planner_of

Array = NDArray[np.float64]

SETTINGS = NativeSettings(max_waypoints=4096)


class ConstrainedPlanner(NativePlanner):
    """`NativePlanner` whose trees and shortcuts stay on a manifold; borrows the trees of this thread's one.

    Args:
        rejection: throw away samples and edges that leave the tolerances instead of projecting them (to
            compare with: RRT-Connect as it is without constraints).
    """

    def __init__(self, native: NativePlanner, manifold: Manifold, rejection: bool = False):
        self.checker, self.settings, self.manifold = native.checker, SETTINGS, manifold
        self.reach, self.trees, self.found, self.room = native.reach, native.trees, native.found, native.room
        dof, m = manifold.dof, SETTINGS.max_waypoints
        self.path = np.zeros((m, dof))
        self.slack, self.ends = np.zeros(dof), np.zeros(space_size(dof))
        self.space, self.index = np.zeros((2 * m + 8) * dof + m), np.zeros(2 * m, np.int64)
        self.rejection = rejection
        self.bounds = (self.slack, self.slack)

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
        if not go_on:
            self.found[ITERATIONS] = 0
        self.bounds = (lower, upper)
        shift = np.random.default_rng(seed).random(len(start)) if seed else np.full(len(start), 0.5)
        nodes, parents, _, leaves, leaf_ints = self.trees
        delta = self.reach if self.rejection else self.manifold.step
        return constrained_rrt_connect(
            self.checker.handle, self.manifold.handle, start, goals, lower, upper, shift, self.reach, delta,
            step, self.manifold.allowance, not self.rejection, nodes, parents, leaves, leaf_ints, self.room,
            self.ends, self.found, stop,
            self.settings.max_iterations if iterations is None else iterations, self.path,
        )  # fmt: skip

    def shorten(self, count: int, stop: NDArray[np.int64]) -> int:
        """Shorten path[:count] on the manifold, in place; the new count, 0 if it cannot be proven."""
        m = self.manifold
        return shorten(
            self.checker.handle, m.handle, self.path, count, self.space, self.index, self.slack, *self.bounds,
            m.step, self.settings.step, m.allowance, stop,
        )  # fmt: skip

    @property
    def closest(self) -> Array | None:
        dof = self.manifold.dof
        at = closest_at(dof)
        return self.ends[at + 1 :][: 2 * dof].reshape(2, dof).copy() if np.isfinite(self.ends[at]) else None


def constrained(checker: KernelChecker, manifold: Manifold) -> ConstrainedPlanner:
    """A planner with this thread's trees."""
    return ConstrainedPlanner(planner_of(checker), manifold)
