"""Cache of conflicts between an arm's straight joint-space motions and the other arm."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from armcell.collision.arms import CLEARANCE, Arms
from armcell.scene import PlanningScene
from armcell.tasks.arms.tour_cost import TourSegment

Array = NDArray[np.float64]

SAMPLES = 16  # per motion
DECIMALS = 3  # [rad] positions that agree to these decimals share a cache entry


class ConflictCache:
    """Cache that evaluates each pair of a motion and a pose of the other arm once."""

    def __init__(self, scene: PlanningScene, groups: tuple[str, str]):
        self._arms = Arms(scene, groups)
        self._known: dict[tuple[int, bytes], tuple[float, float] | None] = {}

    def share(self, arm: int, segment: TourSegment, other: TourSegment) -> tuple[float, float] | None:
        """Return the part of an arm's motion (from, to in 0..1) that is close to the other arm.

        The other arm is at its working pose.

        Args:
            arm: index of the moving arm, 0 or 1.
        """
        if segment.motion_ends is None or other.motion_ends is None:
            return None
        working = other.motion_ends[1]
        key = arm, np.round(np.concatenate([*segment.motion_ends, working]), DECIMALS).tobytes()
        if key not in self._known:
            self._known[key] = self._near(arm, segment.motion_ends, working)
        return self._known[key]

    def _near(self, arm: int, ends: tuple[Array, Array], working: Array) -> tuple[float, float] | None:
        share = np.linspace(0.0, 1.0, SAMPLES)[:, None]
        moving, resting = ends[0] + share * (ends[1] - ends[0]), np.tile(working, (SAMPLES, 1))
        points = np.hstack([moving, resting] if arm == 0 else [resting, moving])
        first = self._arms.first_too_close(points, clearance=CLEARANCE)
        if first < 0:
            return None
        edges = SAMPLES - 1
        last = edges - int(self._arms.first_too_close(points[::-1], clearance=CLEARANCE))
        return int(first) / edges, last / edges
