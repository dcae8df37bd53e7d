"""Goal positions beyond the first ones, worked out while a search runs that has not reached those."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from armcell.collision.kernel.checker import KernelChecker
from armcell.core import SE3, SO3, PlanRequest, PoseGoal
from armcell.kinematics import IKSolver, ik_solver
from armcell.scene import PlanningScene

Array = NDArray[np.float64]

DISTINCT = 1e-2  # [rad or m] goals nearer than this to each other, in every joint, count as the same
SHARE = 0.9  # of the tolerances is used, the rest is for the solver's own
ATTEMPTS = 500  # random references per pose


def stream(
    scene: PlanningScene, request: PlanRequest, checker: KernelChecker, known: Sequence[Array]
) -> Iterator[Array] | None:
    """Free positions (n,), not yet known, that reach one of the request's pose goals; None: it has none.

    Nothing is computed before the first is asked for. The goals take turns.
    """
    poses = [goal for goal in request.goals if isinstance(goal, PoseGoal)]
    if not poses:
        return None
    rng = np.random.default_rng([request.seed, 1])
    given = list(known)

    def new_ones() -> Iterator[Array]:
        sources = [candidates(scene, request.group, goal, rng) for goal in poses]
        while sources:
            for source in list(sources):
                for q in source:
                    if all(np.max(np.abs(q - k)) > DISTINCT for k in given) and checker.is_free(q):
                        given.append(q)
                        yield q
                        break
                else:
                    sources.remove(source)

    return new_ones()


def candidates(scene: PlanningScene, group: str, goal: PoseGoal, rng: np.random.Generator) -> Iterator[Array]:
    """Positions (n,) within limits that reach a pose goal, in turns: the pose itself, by every solution and
    their equivalents by whole turns; a random pose within its tolerances, from a random reference."""
    ik = ik_solver(scene.model, group, goal.link)
    exact = ik.solutions(goal.T_world_link, scene.positions, rng, equivalents=True)
    for _ in range(ATTEMPTS):
        yield from islice(exact, 1)
        reference = scene.positions.copy()
        reference[ik.columns] = _random(ik, rng)
        yield from ik.nearest(_within(goal, rng), reference, rng, among=1)


def _random(ik: IKSolver, rng: np.random.Generator) -> Array:
    return rng.uniform(
        np.where(np.isfinite(ik.lower), ik.lower, -np.pi), np.where(np.isfinite(ik.upper), ik.upper, np.pi)
    )


def _within(goal: PoseGoal, rng: np.random.Generator) -> SE3:
    """A pose within the tolerances, uniform in the ball of positions and in that of rotation vectors."""

    def in_ball(radius: float) -> Array:
        direction = rng.normal(size=3)
        return direction / np.linalg.norm(direction) * radius * rng.random() ** (1 / 3)

    T = goal.T_world_link
    offset = in_ball(SHARE * goal.position_tolerance)
    turn = SO3.exp(in_ball(SHARE * goal.orientation_tolerance))
    return SE3(turn @ T.rotation, T.translation + offset)
