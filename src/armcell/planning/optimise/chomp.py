"""CHOMP: a path descends the functional of obstacles and smoothness, in the metric of smooth paths.

Ratliff, Zucker, Bagnell, Srinivasa, "CHOMP: Gradient optimization techniques for efficient motion planning",
ICRA 2009; Zucker et al., IJRR 2013.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armcell.planning.optimise.cost import ObstacleCost
from armcell.planning.optimise.smoothness import smooth_metric

Array = NDArray[np.float64]

LOOK = 4  # iterations between two looks whether the path is free
HOPEFUL = -0.006  # [m] of the spheres' smallest distance: they reach beyond the solids, by up to 10 mm


@dataclass(frozen=True)
class CHOMPSettings:
    """Names and meaning as in MoveIt's chomp_planning.yaml where it has them."""

    num_waypoints: int = 40  # between the ends
    max_iterations: int = 120  # from one first path
    max_starts: int = 1000  # first paths: the straight line, then lines with smooth random detours
    collision_clearance: float = 0.05  # [m] beyond the padding from which on being near costs something
    smoothness_cost_weight: float = 0.1
    obstacle_cost_weight: float = 1.0
    learning_rate: float = 0.02
    joint_update_limit: float = 0.1  # [rad or m] of any joint in one iteration
    detour: float = 0.5  # [rad or m] of the random detours


@dataclass(frozen=True, eq=False)
class Descent:
    """`free` is the first path (m, n) that was found free, or None; `path` the last one."""

    path: Array
    free: Array | None
    iterations: int
    cost: float
    distance: float  # [m] the smallest of the spheres, of the last path


def descend(
    cost: ObstacleCost, path: Array, lower: Array, upper: Array, settings: CHOMPSettings,
    is_free: Callable[[Array], bool], stopped: Callable[[], bool], at_least: int = 0,
) -> Descent:  # fmt: skip
    """Descend from a path (m, n), whose ends stay.

    Args:
        lower, upper: (n,) of the joints.
        is_free: whether a path may be returned. stopped: whether to give up.
        at_least: iterations before a free path ends the descent: more make it smoother.
    """
    path = path.copy()
    line = path[0] + np.linspace(0.0, 1.0, len(path))[:, None] * (path[-1] - path[0])
    inverse, _ = smooth_metric(len(path) - 2)
    value, least, free = np.inf, -np.inf, None
    for iteration in range(settings.max_iterations):
        if stopped():
            return Descent(path, free, iteration, value, least)
        value, gradient, least = cost.gradient(path)
        if iteration >= at_least and iteration % LOOK == 0 and least > HOPEFUL and is_free(path):
            return Descent(path, path, iteration, value, least)
        # The metric times the smoothness gradient is the way from the smoothest path, the straight line.
        step = settings.smoothness_cost_weight * (path - line)[1:-1]
        step += settings.obstacle_cost_weight * inverse @ gradient[1:-1]
        step *= settings.learning_rate
        largest = float(np.max(np.abs(step)))
        step *= min(1.0, settings.joint_update_limit / max(largest, 1e-12))
        path[1:-1] -= step
        within_limits(path, lower, upper, inverse)
    return Descent(path, path if is_free(path) else None, settings.max_iterations, value, least)


def within_limits(path: Array, lower: Array, upper: Array, inverse: Array) -> None:
    """Bring a path (m, n) within limits in place: smoothly, the worst waypoint of each joint first."""
    for j in range(path.shape[1]):
        for _ in range(10):
            inner = path[1:-1, j]
            over = np.maximum(inner - upper[j], 0.0) - np.maximum(lower[j] - inner, 0.0)
            k = int(np.argmax(np.abs(over)))
            if over[k] == 0.0:
                break
            inner -= over[k] / inverse[k, k] * inverse[:, k]
    np.clip(path, lower, upper, out=path)


def first_path(
    start: Array, goal: Array, count: int, lower: Array, upper: Array, number: int, detour: float,
    rng: np.random.Generator,
) -> Array:  # fmt: skip
    """The straight line (count + 2, n) for number 0; else with a smooth random detour, larger and larger."""
    t = np.linspace(0.0, 1.0, count + 2)[:, None]
    path = start + t * (goal - start)
    if number > 0:
        size = detour * min(0.6 + 0.2 * number, 3.0)
        for k in (1, 2):
            path = path + size / k * np.sin(np.pi * k * t) * rng.normal(size=len(start))
    return np.clip(path, lower, upper)
