"""Where an arm's straight way in the joints' space comes near the other arm at work."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from armcell.collision.arms import CLEARANCE, Arms
from armcell.scene import PlanningScene
from armcell.tasks.arms.errands import Leg

Array = NDArray[np.float64]

SAMPLES = 16  # of a way
SAME = 3  # decimals [rad] to which positions are the same


class Meetings:
    """Asked often of the same ways: each is looked at once."""

    def __init__(self, scene: PlanningScene, groups: tuple[str, str]):
        self._arms = Arms(scene, groups)
        self._known: dict[tuple[int, bytes], tuple[float, float] | None] = {}

    def share(self, arm: int, leg: Leg, other: Leg) -> tuple[float, float] | None:
        """From which to which share of its way an arm (0 or 1) is near the other one where that works."""
        if leg.way is None or other.way is None:
            return None
        key = arm, np.round(np.concatenate([*leg.way, other.way[1]]), SAME).tobytes()
        if key not in self._known:
            self._known[key] = self._near(arm, leg.way, other.way[1])
        return self._known[key]

    def _near(self, arm: int, way: tuple[Array, Array], at: Array) -> tuple[float, float] | None:
        share = np.linspace(0.0, 1.0, SAMPLES)[:, None]
        moves, stands = way[0] + share * (way[1] - way[0]), np.tile(at, (SAMPLES, 1))
        points = np.hstack([moves, stands] if arm == 0 else [stands, moves])
        first = self._arms.first_near(points, clearance=CLEARANCE)
        if first < 0:
            return None
        edges = SAMPLES - 1
        last = edges - int(self._arms.first_near(points[::-1], clearance=CLEARANCE))
        return int(first) / edges, last / edges
