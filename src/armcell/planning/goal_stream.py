"""Goal positions beyond the first ones, worked out while a search runs that has not reached those."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from armcell.collision.kernel.checker import KernelChecker
from armcell.planning.goal_regions import candidates, is_region
from armcell.planning.question import Question

Array = NDArray[np.float64]

DISTINCT = 1e-2  # [rad or m] goals nearer than this to each other, in every joint, count as the same


def stream(
    question: Question, checker: KernelChecker, known: Sequence[Array], seed: int
) -> Iterator[Array] | None:
    """Free positions (n,), not yet known, that reach one of the request's goals; None: no more than these do.

    Nothing is computed before the first is asked for. The goals take turns.
    """
    regions = [goal for goal in question.request.goals if is_region(goal)]
    if not regions:
        return None

    def new_ones() -> Iterator[Array]:
        rng, given = np.random.default_rng([seed, 1]), list(known)
        sources = [
            candidates(question.scene, question.request.group, goal, rng, question.deadline)
            for goal in regions
        ]
        while sources:
            for source in list(sources):
                for q in source:
                    new = all(np.max(np.abs(q - k)) > DISTINCT for k in given)
                    if new and checker.is_free(q) and not question.forbids(q):
                        given.append(q)
                        yield q
                        break
                else:
                    sources.remove(source)

    return new_ones()
