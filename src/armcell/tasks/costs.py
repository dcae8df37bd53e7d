"""What a plan costs: terms to rank solutions by, lower is better. Any function of a draft is one too."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from armcell.core import Registry
from armcell.tasks.search import Draft
from armcell.tasks.steps import Dwell, Grip, Motion, Together

Cost = Callable[[Draft], float]
"""Of a draft's steps; lower is better."""

costs: Registry[Cost] = Registry("cost term")
"""By name, for settings."""

GRIP = 0.5  # [s] that a gripper is taken to drive
NEAR = 1e-3  # [m] nearer than this costs no more


def motions(draft: Draft) -> Iterator[Motion]:
    """The arm motions of a draft."""
    for step in draft.steps:
        motion = step.motion if isinstance(step, Together) else step
        if isinstance(motion, Motion):
            yield motion


@costs.register("duration")
def duration(draft: Draft) -> float:
    """Time [s] that performing it takes, about."""
    seconds = 0.0
    for step in draft.steps:
        if isinstance(step, Motion | Together):
            seconds += step.duration
        elif isinstance(step, Grip):
            seconds += GRIP + step.settle
        elif isinstance(step, Dwell):
            seconds += step.duration
    return seconds


@costs.register("path_length")
def path_length(draft: Draft) -> float:
    """Way [rad] of the joints together, as their path is long."""
    return float(
        sum(
            np.linalg.norm(np.diff(motion.trajectory.positions, axis=0), axis=1).sum()
            for motion in motions(draft)
        )
    )


@costs.register("clearance")
def clearance(draft: Draft) -> float:
    """One over the least distance [1/m] that a motion keeps; 0 where nothing is near."""
    kept = [motion.clearance for motion in motions(draft) if motion.clearance is not None]
    return 1.0 / max(min(kept), NEAR) if kept else 0.0


@costs.register("planning_time")
def planning_time(draft: Draft) -> float:
    """Time [s, wall clock] that its motions took to plan."""
    return sum(motion.planning_time for motion in motions(draft))


def weighted(*terms: tuple[float, Cost]) -> Cost:
    """A sum of terms: `weighted((1.0, duration), (0.1, clearance))`."""
    return lambda draft: sum(weight * term(draft) for weight, term in terms)
