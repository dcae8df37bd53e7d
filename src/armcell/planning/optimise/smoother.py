"""CHOMP after another planner: its path made smoother and led away from obstacles."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from armcell.planning.optimise.chomp import CHOMPSettings, descend
from armcell.planning.optimise.cost import ObstacleCost
from armcell.planning.optimise.smoothness import resampled
from armcell.planning.problem import Problem

Array = NDArray[np.float64]

SETTINGS = CHOMPSettings(max_iterations=100, smoothness_cost_weight=2.0)
AT_LEAST = 40  # iterations


def smoothed(problem: Problem, waypoints: Array, is_free: Callable[[Array], bool]) -> Array | None:
    """A smoother path (m, n) with the ends of waypoints (k, n); None where none that is free was found."""
    if len(waypoints) < 3:
        return None
    path = resampled(waypoints, SETTINGS.num_waypoints)
    lower, upper = np.minimum(problem.lower, path.min(0)), np.maximum(problem.upper, path.max(0))
    cost = ObstacleCost(problem.checker, SETTINGS.collision_clearance)
    return descend(
        cost, path, lower, upper, SETTINGS, is_free, lambda: problem.stopped, at_least=AT_LEAST
    ).free
