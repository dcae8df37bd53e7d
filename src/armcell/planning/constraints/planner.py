"""Native RRT-Connect planner on a constraint manifold, and the warm-up of its kernels."""

# pyright: reportCallIssue=false
# Numba calls intrinsics without their typing context, and splices tuples into compiled calls.
from __future__ import annotations

import logging
import time
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from armcell.collision.kernel.checker import KernelChecker
from armcell.core import SE3, Box, Constraints, PositionConstraint
from armcell.model import load_robot
from armcell.planning.constraints.manifold import ConstraintManifold
from armcell.planning.constraints.rrt_connect import (
    Steps,
    closest_at,
    constrained_rrt_connect,
    space_size,
)
from armcell.planning.constraints.simplify import shorten
from armcell.planning.planners.native.rrt_connect import ITERATIONS, Query
from armcell.planning.planners.registry import announce_compilation
from armcell.planning.planners.rrt_connect import NativePlanner, RRTConnectSettings, planner_of
from armcell.scene import PlanningScene

Array = NDArray[np.float64]

SETTINGS = RRTConnectSettings(max_waypoints=4096)


class ConstrainedPlanner(NativePlanner):
    """Planner for path constraints: a `NativePlanner` whose search trees and shortcuts stay on the constraint
    manifold.

    The planner reuses the trees of the current thread's planner.

    Args:
        rejection: reject samples and edges that leave the tolerances instead of projecting them (plain
            RRT-Connect, for comparison).
    """

    def __init__(self, native: NativePlanner, manifold: ConstraintManifold, rejection: bool = False):
        self.checker, self.settings, self.manifold = native.checker, SETTINGS, manifold
        self.reach, self.trees, self.found = native.reach, native.trees, native.found
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
        delta = self.reach if self.rejection else self.manifold.step
        return constrained_rrt_connect(
            self.checker.handle, self.manifold.handle,
            Query(start, goals, lower, upper, shift, self.reach, step), delta, self.manifold.allowance,
            not self.rejection, self.trees, self.ends, self.found, stop,
            self.settings.max_iterations if iterations is None else iterations, self.path,
        )  # fmt: skip

    def shorten(self, count: int, stop: NDArray[np.int64]) -> int:
        """Shorten a path (path[:count]) on the constraint manifold in place.

        Return the new count, or 0 if a proof fails.
        """
        m = self.manifold
        rules = Steps(*self.bounds, self.slack, m.step, self.settings.step, m.allowance, True)
        return shorten(self.checker.handle, m.handle, self.path, count, self.space, self.index, rules, stop)

    @property
    def closest(self) -> Array | None:
        dof = self.manifold.dof
        at = closest_at(dof)
        return self.ends[at + 1 :][: 2 * dof].reshape(2, dof).copy() if np.isfinite(self.ends[at]) else None


def constrained_planner(checker: KernelChecker, manifold: ConstraintManifold) -> ConstrainedPlanner:
    """Create a planner for path constraints that uses the search trees of the current thread."""
    return ConstrainedPlanner(planner_of(checker), manifold)


logger = logging.getLogger(__name__)


@lru_cache(maxsize=1)
def warm_up_constraints() -> float:
    """Compile all kernels for planning with path constraints before their first use, and return the duration
    [s].
    """
    began = time.monotonic()
    announce_compilation("RRTConnect with path constraints", constrained_rrt_connect)
    model = load_robot("parallel_gripper")
    scene, group = PlanningScene.of(model), "gripper"
    finger = next(j.child for j in model.joints.values() if j.name in model.group(group).joint_names)
    anywhere = PositionConstraint(((Box(1.0, 1.0, 1.0), SE3.identity()),), finger)
    checker = KernelChecker(scene, model.group(group).joint_names)
    manifold = ConstraintManifold(scene, group, Constraints(positions=(anywhere,)))
    a, b = np.array([0.01]), np.array([0.04])
    manifold.values(a)
    manifold.first_unproven_edge(np.vstack([a, b]))
    manifold.project(a, a, b)
    constrained_planner(checker, manifold).plan(a, b[None], np.array([0.0]), np.array([0.05]))
    seconds = time.monotonic() - began
    if seconds > 2.0:
        logger.info("compiled planning with path constraints in %.0f s; it is kept for later runs", seconds)
    return seconds
