"""EST (expansive space trees), a planner that grows a tree from its most isolated nodes.

Source: Hsu, Latombe, Motwani, "Path planning in expansive configuration spaces", IJCGA 9 (1999). As in
OMPL's `geometric::EST`, neighbors are within a third of the range, and crowded samples are mostly rejected.
OMPL's Python wheel has no EST.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armcell.core.checks import require
from armcell.planning.planners.problem import PlannerResult, Problem
from armcell.planning.planners.registry import pipelines, settings_parser, settings_parsers
from armcell.planning.planners.rrt_connect import unsolved_result

Array = NDArray[np.float64]

RANGE_SHARE = 0.2  # share of the space's diagonal, if no range is given
CHECK_STEP = 1 / 32  # [rad] between validity checks along an edge; the result is certified afterwards


@dataclass(frozen=True)
class ESTSettings:
    """Settings of the planner EST, with the names and defaults that OMPL uses."""

    range: float | None = None  # [rad] longest edge; None, or 0 as in MoveIt's files: a fifth of the diagonal
    goal_bias: float = 0.05  # share of the extensions that aim at a goal
    max_nodes: int = 50_000

    def __post_init__(self) -> None:
        require(self.goal_bias <= 1, f"goal_bias is {self.goal_bias:g}, it must be at most 1")


class _Tree:
    """Search tree of the planner EST: nodes with their parents and the number of their neighbors."""

    def __init__(self, root: Array, size: int, radius: float):
        self._q = np.empty((size, len(root)))
        self._neighbors, self._parents = np.zeros(size), np.full(size, -1)
        self._q[0], self.size, self._radius = root, 1, radius

    def near(self, q: Array) -> NDArray[np.bool_]:
        return ((self._q[: self.size] - q) ** 2).sum(axis=1) <= self._radius**2

    def add(self, q: Array, parent: int) -> None:
        close, i = self.near(q), self.size
        self._neighbors[:i] += close
        self._q[i], self._parents[i], self._neighbors[i] = q, parent, close.sum()
        self.size += 1

    def draw(self, rng: np.random.Generator) -> int:
        """Draw a random node of the EST search tree; nodes with fewer neighbors are more likely."""
        chances = np.cumsum(1.0 / (self._neighbors[: self.size] + 1.0))
        return int(np.searchsorted(chances, rng.random() * chances[-1]))

    def __getitem__(self, i: int) -> Array:
        return self._q[i]

    def path_to(self, i: int) -> list[Array]:
        """Return the path from the root of the EST search tree to a node."""
        path = []
        while i >= 0:
            path.append(self._q[i].copy())
            i = int(self._parents[i])
        return path[::-1]


@pipelines["native"].register("EST")
def est(problem: Problem) -> PlannerResult:
    """Plan by EST (expansive space trees), and return the first path that is found.

    The pipeline simplifies and certifies the path.
    """
    s: ESTSettings = problem.settings or ESTSettings()
    reach = s.range or RANGE_SHARE * float(np.linalg.norm(problem.upper - problem.lower))
    rng = np.random.default_rng(problem.seed)
    tree, free = _Tree(problem.start, s.max_nodes, reach / 3), problem.checker.edge_is_free
    iterations, closest, gap = 0, None, np.inf
    while not problem.stopped and tree.size < s.max_nodes:
        iterations += 1
        i = tree.draw(rng)
        aimed = rng.random() < s.goal_bias
        if aimed:
            q = problem.goals[int(rng.integers(len(problem.goals)))]
        else:
            low, high = np.maximum(tree[i] - reach, problem.lower), np.minimum(tree[i] + reach, problem.upper)
            q = rng.uniform(low, high)
            if rng.random() > 1.0 / (tree.near(q).sum() + 1.0):
                continue
        if free(tree[i], q, CHECK_STEP):
            if aimed:
                path = np.array([*tree.path_to(i), q])
                return PlannerResult(path, "", {"iterations": float(iterations), "nodes": float(tree.size)})
            tree.add(q, i)
        elif aimed and np.linalg.norm(q - tree[i]) < gap:
            gap, closest = float(np.linalg.norm(q - tree[i])), np.array([tree[i], q])
    return unsolved_result("EST", problem, iterations, closest, {"nodes": float(tree.size)})


_make = settings_parser("EST", ESTSettings)


def _settings(parameters: Mapping[str, Any]) -> ESTSettings:
    return _make({key: value for key, value in parameters.items() if key != "range" or value != 0})


_settings.defaults = _make.defaults  # type: ignore[attr-defined]
settings_parsers[est] = _settings
