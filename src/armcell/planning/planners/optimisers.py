"""CHOMP and STOMP as planners: from straight lines, then from lines with random detours, till one is free."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from armcell.core import Registry
from armcell.planning.optimise.chomp import CHOMPSettings, Descent, descend, first_path
from armcell.planning.optimise.cost import ObstacleCost
from armcell.planning.optimise.stomp import STOMPSettings, improve
from armcell.planning.parameters import settings_of
from armcell.planning.problem import Answer, Problem, pipelines, settings_makers

Array = NDArray[np.float64]

pipelines["chomp"] = Registry("planner of pipeline 'chomp'")
pipelines["stomp"] = Registry("planner of pipeline 'stomp'")


@pipelines["chomp"].register("CHOMP")
def chomp(problem: Problem) -> Answer:
    """A smooth path kept away from obstacles, or how far it came."""
    settings: CHOMPSettings = problem.settings or CHOMPSettings()
    cost = ObstacleCost(problem.checker, settings.collision_clearance)

    def optimise(path: Array, rng: np.random.Generator) -> Descent:
        return descend(
            cost, path, problem.lower, problem.upper, settings, free(problem), lambda: problem.stopped
        )

    return _from_many_starts(
        "CHOMP", problem, optimise, settings.num_waypoints, settings.max_starts, settings.detour, done=True
    )


@pipelines["stomp"].register("STOMP")
def stomp(problem: Problem) -> Answer:
    """A path found by weighing noisy ones, or how far it came. It is rough: the pipeline shortens it."""
    settings: STOMPSettings = problem.settings or STOMPSettings()
    cost = ObstacleCost(problem.checker, settings.collision_clearance)

    def optimise(path: Array, rng: np.random.Generator) -> Descent:
        return improve(
            cost, path, problem.lower, problem.upper, settings, free(problem), lambda: problem.stopped, rng
        )

    return _from_many_starts(
        "STOMP", problem, optimise, settings.num_timesteps, settings.max_starts, settings.detour, done=False
    )


settings_makers[chomp] = settings_of("CHOMP", CHOMPSettings)
settings_makers[stomp] = settings_of("STOMP", STOMPSettings)


def free(problem: Problem) -> Callable[[Array], bool]:
    """Whether a path (m, n) is free with padding at samples, and proven free of contact."""
    checker = problem.checker

    def is_free(path: Array) -> bool:
        return all(checker.is_free(q) for q in path) and bool(checker.certify(path, evidence=False).free)

    return is_free


def _from_many_starts(
    name: str, problem: Problem, optimise: Callable[[Array, np.random.Generator], Descent], count: int,
    starts: int, detour: float, done: bool,
) -> Answer:  # fmt: skip
    """Args: done: whether the path keeps its shape, and is not shortened."""
    rng, iterations, number, last = np.random.default_rng(problem.seed), 0, 0, None
    while number < starts and not problem.stopped:
        goal = problem.goals[number % len(problem.goals)]
        turn = number // len(problem.goals)  # every goal's straight line first
        path = first_path(problem.start, goal, count, problem.lower, problem.upper, turn, detour, rng)
        last = optimise(path, rng)
        iterations, number = iterations + last.iterations, number + 1
        if last.free is not None:
            statistics = {"iterations": float(iterations), "starts": float(number)}
            return Answer(last.free, "", statistics, simplified=done)
    statistics = {"iterations": float(iterations), "starts": float(number)}
    if problem.cancel.is_set():
        return Answer(None, f"{name}: cancelled after {iterations} iterations", statistics)
    text = f"{name}: no free path after {iterations} iterations from {number} first paths"
    if last is not None:
        statistics["cost"] = last.cost
    return Answer(None, text, statistics)
