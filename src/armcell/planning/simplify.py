"""Shorter paths, for planners that do not shorten theirs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from armcell.planning.planners.native import planner_of, stopping
from armcell.planning.problem import Problem

Array = NDArray[np.float64]


def simplify(problem: Problem, waypoints: Array) -> Array | None:
    """A path (k, n) at most as long, with the same ends and every edge proven free; None: some edge is not.

    Args:
        waypoints: (m, n), edges checked at samples or not at all.
    """
    planner = planner_of(problem.checker)
    with stopping(problem) as stop:
        return planner.shortened(waypoints, stop)
