"""`Grasp` and `Rejection`: the results of grasp planning."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armcell.core import SE3
from armcell.core.checks import checked
from armcell.grasping.contact import PadContact

Array = NDArray[np.float64]

FAILED = (  # by the number of checks that a rejected candidate passed
    "have nothing between the pads",
    "are too wide",
    "let the hand touch the object or its support",
    "slip off",
    "need more force",
)
APPROACH, SHORTEST_APPROACH = 0.10, 0.03  # [m] desired and minimum


@dataclass(frozen=True, eq=False)
@checked()
class Grasp:
    """Grasp candidate: a pose of the tcp, which approaches along its z axis while the gripper closes along
    its y axis.

    The hand approaches along +z of the TCP and retreats along -z. The approach is `approach` [m] long if
    there is enough free space, and at least `shortest_approach` [m]. With a suction gripper the width is 0,
    and there is a contact for each cup that seals.
    """

    name: str
    T_object_tcp: SE3
    width: float  # [m] width of the object between the pads
    opening: float  # [m] finger opening before the approach
    force: float  # [N] per finger or cup
    score: float = 0.0  # higher scores are tried first
    approach: float = APPROACH
    shortest_approach: float = SHORTEST_APPROACH
    contacts: tuple[PadContact, ...] = ()  # of the pads at +y and -y, or of the cups; TCP frame


@dataclass(frozen=True)
class Rejection:
    """A grasp candidate that was rejected, with the reason."""

    name: str
    reason: str
    passed: int = 0  # number of passed checks
    excess: float = np.inf  # excess over the limit of the failed check


def nearest_miss(rejected: list[Rejection]) -> Rejection | None:
    """Return the `Rejection` of the grasp candidate that passed the most checks, or None.

    Among equals, the candidate with the smallest excess wins.
    """
    return min(rejected, key=rejection_sort_key, default=None)


def why_none(rejected: list[Rejection], covered: float) -> str:
    """Explain in one line, from the list of rejections, why an object has no grasp candidate.

    Args:
        covered: share of the surface that was tried, from 0 to 1.
    """
    counts = Counter(min(r.passed, len(FAILED) - 1) for r in rejected)
    kinds = ", ".join(f"{counts[k]} {FAILED[k]}" for k in sorted(counts, reverse=True))
    tried = f"{100 * covered:.0f} % of the surface was tried"
    if not rejected:
        return f"no grasp: {tried}, no two sides oppose each other within the opening"
    return f"no grasp: {tried}; of {len(rejected)} candidates {kinds}"


def rejection_sort_key(rejection: Rejection) -> tuple[int, float]:
    """Return the sort key of a `Rejection`: candidates that passed more checks come first, then those that
    failed the next check by less.
    """
    return -rejection.passed, rejection.excess
