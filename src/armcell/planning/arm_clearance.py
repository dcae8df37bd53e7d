"""Clearance between the arms of a multi-arm group: the achievable distance and its checker."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armcell.collision.inter_arm_checker import nearest_between, sides_of
from armcell.collision.kernel.checker import KernelChecker
from armcell.core import Contact
from armcell.scene import PlanningScene

Array = NDArray[np.float64]

SPARE = 1e-3  # [m] subtracted from the distance at a start or goal that is smaller than the wanted clearance


@dataclass(frozen=True, eq=False)
class ArmClearance:
    """Clearance [m] that the arms of a multi-arm group must keep from each other during a motion.

    Attributes:
        distance: [m]; 0 means that the arms only do not touch.
        goals: goal positions (n,) at which the arms are at least `distance` apart.
        note: why `distance` is smaller than requested; empty if it is not.
        sides: by link or object, the number of the arm it belongs to.
    """

    distance: float
    goals: tuple[Array, ...]
    note: str
    sides: dict[str, int]

    def apply_to(self, checker: KernelChecker) -> KernelChecker:
        """Return a copy of a collision checker that also requires the clearance between the arms of a
        group.
        """
        return checker.with_clearance_between(self.sides, self.distance)


def achievable_arm_clearance(
    scene: PlanningScene,
    arms: Sequence[str],
    checker: KernelChecker,
    start: Array,
    goals: Sequence[Array],
    wanted: float,
) -> ArmClearance | None:
    """Compute the largest clearance between the arms of a group at which the start and at least one of the
    goals (n,) are still valid.

    Returns:
        The clearance, at most `wanted` [m]; None for fewer than two arms or a zero `wanted`.
    """
    if len(arms) < 2 or wanted <= 0:
        return None
    sides = sides_of(scene, tuple(arms))
    wide = checker.with_clearance_between(sides, wanted)
    far = tuple(g for g in goals if wide.is_free(g))
    if far and wide.is_free(start):
        return ArmClearance(wanted, far, "", sides)

    def between(q: Array) -> tuple[float, Contact | None]:
        contact = nearest_between(checker.exact, sides, q)
        return (np.inf if contact is None else contact.distance), contact

    ends = [("start", *between(start))]
    there = [between(g) for g in goals]
    if not far:
        best = max(range(len(goals)), key=lambda i: there[i][0])
        ends.append(("goal", *there[best]))
    end, least, contact = min(ends, key=lambda e: e[1])
    distance = float(np.clip(least - SPARE, 0.0, wanted))
    note = "" if contact is None else (
        f"the arms keep {1000 * distance:.0f} mm apart, not {1000 * wanted:.0f}: at the {end} "
        f"{contact.body_a} and {contact.body_b} are {1000 * contact.distance:.0f} mm apart"
    )  # fmt: skip
    wide = checker.with_clearance_between(sides, distance)
    return ArmClearance(distance, tuple(g for g in goals if wide.is_free(g)) or tuple(goals), note, sides)
