"""Shorter paths: straight-line shortcuts with a fixed budget, so the same seed gives the same path."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

from armcell.planning.problem import Problem

Array = NDArray[np.float64]

CHECK_STEP = 0.02  # [rad]


def simplify(problem: Problem, waypoints: Array, rng: np.random.Generator, rounds: int = 60) -> Array:
    """A path at most as long, with the same ends.

    First vertices are dropped greedily, then random points on the path are joined by straight lines
    (Geraerts and Overmars, "Creating high-quality paths for motion planning", IJRR 2007).
    """
    path = _drop_vertices(problem, [w.copy() for w in waypoints])
    failures = 0
    for _ in range(rounds):
        if len(path) < 3 or failures > 20 or problem.stopped:
            break
        failures = 0 if _random_shortcut(problem, path, rng) else failures + 1
    return np.array(_drop_vertices(problem, path))


def _drop_vertices(problem: Problem, path: list[Array]) -> list[Array]:
    """Join each vertex with the farthest later one that a free straight line reaches."""
    result, i = [path[0]], 0
    while i < len(path) - 1:
        j = len(path) - 1
        while j > i + 1 and not problem.checker.edge_is_free(path[i], path[j], CHECK_STEP):
            j -= 1
        result.append(path[j])
        i = j
    return result


def _random_shortcut(problem: Problem, path: list[Array], rng: np.random.Generator) -> bool:
    lengths = np.array([np.linalg.norm(b - a) for a, b in itertools.pairwise(path)])
    ends = np.concatenate([[0.0], np.cumsum(lengths)])
    s, t = np.sort(rng.uniform(0.0, ends[-1], 2))
    i, j = (int(np.clip(np.searchsorted(ends, x, side="right") - 1, 0, len(lengths) - 1)) for x in (s, t))
    if i == j:
        return False
    a = path[i] + (path[i + 1] - path[i]) * (s - ends[i]) / max(lengths[i], 1e-12)
    b = path[j] + (path[j + 1] - path[j]) * (t - ends[j]) / max(lengths[j], 1e-12)
    if (t - s) - np.linalg.norm(b - a) < 1e-3 or not problem.checker.edge_is_free(a, b, CHECK_STEP):
        return False
    path[i + 1 : j + 1] = [a, b]
    return True
