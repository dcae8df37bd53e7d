"""Functions that the planners CHOMP and STOMP share.

Initial paths, smoothness metric, limits, repeated starts.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from armcell.planning.planners.problem import PlannerResult, Problem

Array = NDArray[np.float64]


@lru_cache(maxsize=16)
def smooth_metric(count: int) -> tuple[Array, Array]:
    """Return the inverse (count, count) of the smoothness metric for trajectory optimization, and a matrix
    square root (Cholesky factor) of the inverse.

    The metric is the squared acceleration of a path with both ends fixed and at rest. The inverse is scaled
    to a largest element of 1; the root times white noise is smooth noise.
    """
    K = np.zeros((count + 2, count))
    for i in range(count + 2):  # second differences; the path rests beyond its ends
        for j, weight in ((i - 2, 1.0), (i - 1, -2.0), (i, 1.0)):
            if 0 <= j < count:
                K[i, j] += weight
    inverse = np.linalg.inv(K.T @ K)
    inverse /= inverse.max()
    return inverse, np.linalg.cholesky(inverse + 1e-12 * np.eye(count))


def resample_path(path: Array, count: int) -> Array:
    """Resample a path (k, n) to count + 2 equally spaced waypoints, for trajectory optimization."""
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    at = np.linspace(0.0, way[-1], count + 2)
    return np.column_stack([np.interp(at, way, path[:, j]) for j in range(path.shape[1])])


def path_validity(problem: Problem) -> Callable[[Array], bool]:
    """Return a function that tests whether a path (m, n) from CHOMP or STOMP is valid.
    The waypoints must be collision-free with padding. The whole path must be proven collision-free.
    """
    checker = problem.checker

    def is_free(path: Array) -> bool:
        return all(checker.is_free(q) for q in path) and bool(checker.certify(path, evidence=False).free)

    return is_free


def optimize_from_many_starts(
    name: str,
    problem: Problem,
    optimize: Callable[[Array, np.random.Generator], OptimizationResult],
    count: int,
    starts: int,
    detour: float,
    done: bool,
) -> PlannerResult:
    """Optimize initial paths by CHOMP or STOMP, first a straight one, then random detours, until one becomes
    collision-free.

    Args:
        done: whether the path keeps its shape and is not simplified later.
    """
    rng, iterations, number, last = np.random.default_rng(problem.seed), 0, 0, None
    while number < starts and not problem.stopped:
        goal = problem.goals[number % len(problem.goals)]
        turn = number // len(problem.goals)  # every goal's straight line first
        path = initial_path(problem.start, goal, count, problem.lower, problem.upper, turn, detour, rng)
        last = optimize(path, rng)
        iterations, number = iterations + last.iterations, number + 1
        if last.free is not None:
            statistics = {"iterations": float(iterations), "starts": float(number)}
            return PlannerResult(last.free, "", statistics, simplified=done)
    statistics = {"iterations": float(iterations), "starts": float(number)}
    if problem.cancel.is_set():
        return PlannerResult(None, f"{name}: cancelled after {iterations} iterations", statistics)
    text = f"{name}: no free path after {iterations} iterations from {number} first paths"
    if last is not None:
        statistics["cost"] = last.cost
    return PlannerResult(None, text, statistics)


@dataclass(frozen=True, eq=False)
class OptimizationResult:
    """Result of optimizing a trajectory by CHOMP or STOMP.

    `free` is the first free path (m, n) or None, `path` the last path.
    """

    path: Array
    free: Array | None
    iterations: int
    cost: float
    distance: float  # [m] smallest distance of the spheres on the last path


def clamp_path(path: Array, lower: Array, upper: Array, inverse: Array) -> None:
    """Bring an optimized path (m, n) within the joint limits by smooth changes, in place.

    The worst waypoint of each joint is corrected first.
    """
    for j in range(path.shape[1]):
        for _ in range(10):
            inner = path[1:-1, j]
            over = np.maximum(inner - upper[j], 0.0) - np.maximum(lower[j] - inner, 0.0)
            k = int(np.argmax(np.abs(over)))
            if over[k] == 0.0:
                break
            inner -= over[k] / inverse[k, k] * inverse[:, k]
    np.clip(path, lower, upper, out=path)


def initial_path(
    start: Array, goal: Array, count: int, lower: Array, upper: Array, number: int, detour: float,
    rng: np.random.Generator,
) -> Array:  # fmt: skip
    """Create an initial path (count + 2, n) for trajectory optimization, either straight or with a random
    detour.

    The size of the detour grows with `number`.
    """
    t = np.linspace(0.0, 1.0, count + 2)[:, None]
    path = start + t * (goal - start)
    if number > 0:
        size = detour * min(0.6 + 0.2 * number, 3.0)
        for k in (1, 2):
            path = path + size / k * np.sin(np.pi * k * t) * rng.normal(size=len(start))
    return np.clip(path, lower, upper)
