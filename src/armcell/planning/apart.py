"""Room between the arms of a group of several: how much of it start and goals allow, and a checker for it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armcell.collision.arms import nearest_between, sides_of
from armcell.collision.kernel.checker import KernelChecker
from armcell.core import Contact
from armcell.scene import PlanningScene

Array = NDArray[np.float64]

LESS = 1e-3  # [m] less than there is at a start or goal is kept where it is nearer than what is wanted


@dataclass(frozen=True, eq=False)
class Room:
    """What arms keep from each other between a start and goals.

    Attributes:
        distance: [m], 0 where they only do not touch.
        goals: those (n,) that are at least as far apart.
        words: why it is less than what was asked for.
    """

    distance: float
    goals: tuple[Array, ...]
    words: str
    sides: dict[str, int]

    def kept_by(self, checker: KernelChecker) -> KernelChecker:
        """A checker like this one that keeps it."""
        return checker.keeping_apart(self.sides, self.distance)


def room_between(
    scene: PlanningScene,
    arms: Sequence[str],
    checker: KernelChecker,
    start: Array,
    goals: Sequence[Array],
    wanted: float,
) -> Room | None:
    """The room between arms (by group) that a free start and goals (n,) allow, at most `wanted` [m].

    None where there are no two arms, or none is wanted.
    """
    if len(arms) < 2 or wanted <= 0:
        return None
    sides = sides_of(scene, tuple(arms))
    roomy = checker.keeping_apart(sides, wanted)
    far = tuple(g for g in goals if roomy.is_free(g))
    if far and roomy.is_free(start):
        return Room(wanted, far, "", sides)

    def between(q: Array) -> tuple[float, Contact | None]:
        contact = nearest_between(checker.exact, sides, q)
        return (np.inf if contact is None else contact.distance), contact

    ends = [("start", *between(start))]
    there = [between(g) for g in goals]
    if not far:
        best = max(range(len(goals)), key=lambda i: there[i][0])
        ends.append(("goal", *there[best]))
    end, least, contact = min(ends, key=lambda e: e[1])
    distance = float(np.clip(least - LESS, 0.0, wanted))
    words = "" if contact is None else (
        f"the arms keep {1000 * distance:.0f} mm apart, not {1000 * wanted:.0f}: at the {end} "
        f"{contact.body_a} and {contact.body_b} are {1000 * contact.distance:.0f} mm apart"
    )  # fmt: skip
    roomy = checker.keeping_apart(sides, distance)
    return Room(distance, tuple(g for g in goals if roomy.is_free(g)) or tuple(goals), words, sides)
