"""Cost terms that rank the solutions of a task; lower is better.

Any function of a solution can be a cost term.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from armcell.core import Registry
from armcell.tasks.search import PartialSolution
from armcell.tasks.steps import Dwell, Grip, Motion, Together

Cost = Callable[[PartialSolution], float]
"""Cost of a solution; lower is better."""

costs: Registry[Cost] = Registry("cost term", "armcell.costs")
"""Cost terms by name, for `TaskSettings.cost`."""

GRIP = 0.5  # [s] assumed duration of a gripper motion
NEAR = 1e-3  # [m] smaller clearances cost the same


def motions(solution: PartialSolution) -> Iterator[Motion]:
    """Yield the arm motions of a task's solution, to compute its cost."""
    for step in solution.steps:
        motion = step.motion if isinstance(step, Together) else step
        if isinstance(motion, Motion):
            yield motion


@costs.register("duration")
def duration(solution: PartialSolution) -> float:
    """Cost term: the estimated execution time [s] of a task's solution."""
    seconds = 0.0
    for step in solution.steps:
        if isinstance(step, Motion | Together):
            seconds += step.duration
        elif isinstance(step, Grip):
            seconds += GRIP + step.settle
        elif isinstance(step, Dwell):
            seconds += step.duration
    return seconds


@costs.register("path_length")
def path_length(solution: PartialSolution) -> float:
    """Cost term: the total length [rad] of the joint-space paths of a task's solution."""
    return float(
        sum(
            np.linalg.norm(np.diff(motion.trajectory.positions, axis=0), axis=1).sum()
            for motion in motions(solution)
        )
    )


@costs.register("clearance")
def clearance(solution: PartialSolution) -> float:
    """Cost term: the inverse of the smallest clearance [1/m] of a task solution's motions.

    Without near bodies, the cost is 0.
    """
    kept = [motion.clearance for motion in motions(solution) if motion.clearance is not None]
    return 1.0 / max(min(kept), NEAR) if kept else 0.0


@costs.register("planning_time")
def planning_time(solution: PartialSolution) -> float:
    """Cost term: the total planning time [s, wall clock] of a task solution's motions."""
    return sum(motion.planning_time for motion in motions(solution))


def weighted(*terms: tuple[float, Cost]) -> Cost:
    """Cost term of a task's solutions: a weighted sum of other cost terms.

    Example: `weighted((1.0, duration), (0.1, clearance))`
    """
    return lambda solution: sum(weight * term(solution) for weight, term in terms)
