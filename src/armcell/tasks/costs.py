"""Cost terms that rank the solutions of a task; lower is better.

Any function of a solution can be a cost term.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from armcell.core import Registry
from armcell.tasks.search import PartialSolution
from armcell.tasks.steps import CommandGripper, Dwell, Motion, ParallelMotions

Cost = Callable[[PartialSolution], float]
"""Cost of a solution; lower is better."""

costs: Registry[Cost] = Registry("cost term", "armcell.costs")
"""Cost terms by name, for `TaskSettings.cost`."""

GRIP = 0.5  # [s] assumed duration of a gripper motion
NEAR = 1e-3  # [m] smaller clearances cost the same


def motions(solution: PartialSolution) -> Iterator[Motion]:
    """Yield the arm motions in a task's solution, from which its cost is computed."""
    for step in solution.steps:
        motion = step.motion if isinstance(step, ParallelMotions) else step
        if isinstance(motion, Motion):
            yield motion


@costs.register("duration")
def duration(solution: PartialSolution) -> float:
    """Return the estimated execution time [s] of a task's solution, as a cost term."""
    seconds = 0.0
    for step in solution.steps:
        if isinstance(step, Motion | ParallelMotions):
            seconds += step.duration
        elif isinstance(step, CommandGripper):
            seconds += GRIP + step.settle
        elif isinstance(step, Dwell):
            seconds += step.duration
    return seconds


@costs.register("path_length")
def path_length(solution: PartialSolution) -> float:
    """Return the total length [rad] of the joint-space paths in a task's solution, as a cost term."""
    return float(
        sum(
            np.linalg.norm(np.diff(motion.trajectory.positions, axis=0), axis=1).sum()
            for motion in motions(solution)
        )
    )


@costs.register("clearance")
def clearance(solution: PartialSolution) -> float:
    """Return the inverse [1/m] of the smallest clearance during the
    motions of a task's solution, as a cost term.

    Without near bodies, the cost is 0.
    """
    kept = [motion.clearance for motion in motions(solution) if motion.clearance is not None]
    return 1.0 / max(min(kept), NEAR) if kept else 0.0


@costs.register("planning_time")
def planning_time(solution: PartialSolution) -> float:
    """Return the total wall-clock time [s] spent on planning the
    motions of a task's solution, as a cost term.
    """
    return sum(motion.planning_time for motion in motions(solution))


def weighted(*terms: tuple[float, Cost]) -> Cost:
    """Return a cost term for solutions of a task: the weighted sum of other cost terms.

    Example: `weighted((1.0, duration), (0.1, clearance))`
    """
    return lambda solution: sum(weight * term(solution) for weight, term in terms)
