"""CHOMP: gradient descent of a path's obstacle and smoothness cost in a smoothness metric.

Ratliff, Zucker, Bagnell, Srinivasa, "CHOMP: Gradient optimization techniques for efficient motion
planning", ICRA 2009; Zucker et al., IJRR 2013. Also available as a smoothing step after another planner.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armcell.core import Registry
from armcell.planning.planners.obstacle_cost import ObstacleCost
from armcell.planning.planners.problem import PlannerResult, Problem
from armcell.planning.planners.registry import GROUP, pipelines, settings_parser, settings_parsers
from armcell.planning.planners.trajectory_optimization import (
    OptimizationResult,
    clamp_path,
    optimize_from_many_starts,
    path_validity,
    resample_path,
    smooth_metric,
)

Array = NDArray[np.float64]

LOOK = 4  # iterations between checks whether the path is free
HOPEFUL = -0.006  # [m] smallest sphere distance for a check: spheres exceed the solids by up to 10 mm


@dataclass(frozen=True)
class CHOMPSettings:
    """Settings of the planner CHOMP.

    Names and meanings follow MoveIt's chomp_planning.yaml where it has them.
    """

    num_waypoints: int = 40  # between the path's ends
    max_iterations: int = 120  # per initial path
    max_starts: int = 1000  # initial paths: the straight line, then lines with smooth random detours
    collision_clearance: float = 0.05  # [m] distance beyond the padding below which obstacles cost
    smoothness_cost_weight: float = 0.1
    obstacle_cost_weight: float = 1.0
    learning_rate: float = 0.02
    joint_update_limit: float = 0.1  # [rad or m] of any joint in one iteration
    detour: float = 0.5  # [rad or m] size of the random detours


def optimize_chomp(
    cost: ObstacleCost, path: Array, lower: Array, upper: Array, settings: CHOMPSettings,
    is_free: Callable[[Array], bool], stopped: Callable[[], bool], at_least: int = 0,
) -> OptimizationResult:  # fmt: skip
    """Optimize a path (m, n) with fixed ends by CHOMP, a gradient descent on smoothness and obstacle cost.

    Args:
        lower, upper: (n,) joint limits.
        is_free: returns whether a path may be returned. stopped: returns whether to give up.
        at_least: iterations before a free path ends the descent; more iterations make it smoother.
    """
    path = path.copy()
    line = path[0] + np.linspace(0.0, 1.0, len(path))[:, None] * (path[-1] - path[0])
    inverse, _ = smooth_metric(len(path) - 2)
    value, least, free = np.inf, -np.inf, None
    for iteration in range(settings.max_iterations):
        if stopped():
            return OptimizationResult(path, free, iteration, value, least)
        value, gradient, least = cost.gradient(path)
        if iteration >= at_least and iteration % LOOK == 0 and least > HOPEFUL and is_free(path):
            return OptimizationResult(path, path, iteration, value, least)
        # The metric times the smoothness gradient is the offset from the smoothest path, the straight line.
        step = settings.smoothness_cost_weight * (path - line)[1:-1]
        step += settings.obstacle_cost_weight * inverse @ gradient[1:-1]
        step *= settings.learning_rate
        largest = float(np.max(np.abs(step)))
        step *= min(1.0, settings.joint_update_limit / max(largest, 1e-12))
        path[1:-1] -= step
        clamp_path(path, lower, upper, inverse)
    return OptimizationResult(path, path if is_free(path) else None, settings.max_iterations, value, least)


SETTINGS = CHOMPSettings(max_iterations=100, smoothness_cost_weight=2.0)
AT_LEAST = 40  # iterations


def smooth_with_chomp(problem: Problem, waypoints: Array, is_free: Callable[[Array], bool]) -> Array | None:
    """Smooth the waypoints (k, n) of another planner by CHOMP, and return a path (m, n).

    Return None if no free path was found.
    """
    if len(waypoints) < 3:
        return None
    path = resample_path(waypoints, SETTINGS.num_waypoints)
    lower, upper = np.minimum(problem.lower, path.min(0)), np.maximum(problem.upper, path.max(0))
    cost = ObstacleCost(problem.checker, SETTINGS.collision_clearance)
    return optimize_chomp(
        cost, path, lower, upper, SETTINGS, is_free, lambda: problem.stopped, at_least=AT_LEAST
    ).free


pipelines["chomp"] = Registry("planner of pipeline 'chomp'", GROUP)


@pipelines["chomp"].register("CHOMP")
def chomp(problem: Problem) -> PlannerResult:
    """Plan a smooth path with the optimizer CHOMP, which keeps the path at a distance from obstacles."""
    settings: CHOMPSettings = problem.settings or CHOMPSettings()
    cost = ObstacleCost(problem.checker, settings.collision_clearance)

    def optimize(path: Array, rng: np.random.Generator) -> OptimizationResult:
        return optimize_chomp(
            cost,
            path,
            problem.lower,
            problem.upper,
            settings,
            path_validity(problem),
            lambda: problem.stopped,
        )

    return optimize_from_many_starts(
        "CHOMP", problem, optimize, settings.num_waypoints, settings.max_starts, settings.detour, done=True
    )


settings_parsers[chomp] = settings_parser("CHOMP", CHOMPSettings)
