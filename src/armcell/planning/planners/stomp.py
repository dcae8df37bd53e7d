"""STOMP: a planner that combines noisy paths, weighted by their cost, to the next path.

Kalakrishnan, Chitta, Theodorou, Pastor, Schaal, "STOMP: Stochastic trajectory optimization for motion
planning", ICRA 2011.
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
    optimize_from_many_starts,
    path_validity,
    smooth_metric,
)

Array = NDArray[np.float64]

SHARPNESS = 10.0  # sharpness of the weights (the paper's h)
COOLING = 0.97  # factor of the noise from one iteration to the next


@dataclass(frozen=True)
class STOMPSettings:
    """Settings of the planner STOMP.

    Names follow MoveIt's stomp parameters where it has them.
    """

    num_timesteps: int = 24  # waypoints between the ends
    num_iterations: int = 30  # iterations per initial path
    num_rollouts: int = 16  # noisy paths per iteration
    max_starts: int = 1000  # initial paths: the straight line, then lines with smooth random detours
    stddev: float = 0.5  # [rad or m] initial standard deviation of the noise
    control_cost_weight: float = 0.02  # pull toward the straight line per iteration
    collision_clearance: float = 0.03  # [m] distance beyond the padding below which obstacles cost
    detour: float = 0.5  # [rad or m] size of the random detours


def optimize_stomp(
    cost: ObstacleCost, path: Array, lower: Array, upper: Array, settings: STOMPSettings,
    is_free: Callable[[Array], bool], stopped: Callable[[], bool], rng: np.random.Generator,
) -> OptimizationResult:  # fmt: skip
    """Optimize a path (m, n) by STOMP until it is collision-free; the ends of the path stay fixed."""
    path = path.copy()
    m, n = path.shape
    line = path[0] + np.linspace(0.0, 1.0, m)[:, None] * (path[-1] - path[0])
    inverse, root = smooth_metric(m - 2)
    smoothing = inverse / inverse.max(axis=0) / (m - 2)  # each column's largest is 1 / m, as in the paper
    total = np.inf
    for iteration in range(settings.num_iterations):
        if stopped():
            return OptimizationResult(path, None, iteration, total, np.nan)
        noise = (
            settings.stddev * COOLING**iteration * root @ rng.normal(size=(settings.num_rollouts, m - 2, n))
        )
        rollouts = np.repeat(path[None], settings.num_rollouts + 1, axis=0)
        rollouts[1:, 1:-1] += noise
        np.clip(rollouts, lower, upper, out=rollouts)
        noise = rollouts[1:, 1:-1] - path[1:-1]
        costs = cost.of_paths(rollouts)
        total = float(costs[0].sum())
        if is_free(path):
            return OptimizationResult(path, path, iteration, total, np.nan)
        best = 1 + int(np.argmin(costs[1:].sum(axis=1)))
        if costs[best].sum() == 0.0 and is_free(rollouts[best]):
            return OptimizationResult(rollouts[best], rollouts[best], iteration + 1, 0.0, np.nan)
        S = costs[1:, 1:-1]
        span = S.max(axis=0) - S.min(axis=0)
        weight = np.exp(-SHARPNESS * (S - S.min(axis=0)) / np.maximum(span, 1e-9))
        weight[:, span <= 0] = 0.0  # all rollouts cost the same
        weight /= np.maximum(weight.sum(axis=0), 1e-12)
        update = smoothing @ np.einsum("km,kmn->mn", weight, noise)
        path[1:-1] += update - settings.control_cost_weight * (path - line)[1:-1]
        np.clip(path, lower, upper, out=path)
    return OptimizationResult(path, path if is_free(path) else None, settings.num_iterations, total, np.nan)


pipelines["stomp"] = Registry("planner of pipeline 'stomp'", GROUP)


@pipelines["stomp"].register("STOMP")
def stomp(problem: Problem) -> PlannerResult:
    """Plan a rough path by STOMP (stochastic trajectory optimization for motion planning).

    The pipeline simplifies the path.
    """
    settings: STOMPSettings = problem.settings or STOMPSettings()
    cost = ObstacleCost(problem.checker, settings.collision_clearance)

    def optimize(path: Array, rng: np.random.Generator) -> OptimizationResult:
        return optimize_stomp(
            cost,
            path,
            problem.lower,
            problem.upper,
            settings,
            path_validity(problem),
            lambda: problem.stopped,
            rng,
        )

    return optimize_from_many_starts(
        "STOMP", problem, optimize, settings.num_timesteps, settings.max_starts, settings.detour, done=False
    )


settings_parsers[stomp] = settings_parser("STOMP", STOMPSettings)
