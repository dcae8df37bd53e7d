"""The box that the tip is to stay in."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.core import InputError, PlanRequest
from armcell.planning.placed import Placed
from armcell.scene import PlanningScene

Array = NDArray[np.float64]

STEP = 0.02  # [rad] between the places at which a motion is looked at


class Workspace:
    """A request's box, in the world, for the origin of the group's tip (not for the rest of the arm).

    Raises:
        InputError: not two corners, or the low one is not below the high one; a group without a tip.
    """

    def __init__(self, scene: PlanningScene, request: PlanRequest):
        corners = np.asarray(request.workspace, dtype=float)
        if corners.shape != (2, 3) or np.any(np.isnan(corners)):
            raise InputError("the workspace needs a low and a high corner, three numbers [m] each")
        if np.any(corners[0] >= corners[1]):
            axis = "xyz"[int(np.argmax(corners[0] >= corners[1]))]
            raise InputError(f"the workspace is empty: along {axis} its low corner is not below the high one")
        self.low, self.high = corners
        self.tip = Placed(scene, request.group)

    def excess(self, q: ArrayLike) -> float:
        """How far [m] outside the tip is at positions q (n,); 0 inside."""
        at = self.tip.pose(q).translation
        return float(np.linalg.norm(np.maximum(np.maximum(self.low - at, at - self.high), 0.0)))

    def describe(self, q: ArrayLike) -> str:
        """Where the tip is, in words."""
        low, high, at = (
            ", ".join(f"{v:.3g}" for v in p) for p in (self.low, self.high, self.tip.pose(q).translation)
        )
        return (
            f"{self.tip.name} at ({at}) is {self.excess(q) * 1000:.0f} mm outside the workspace "
            f"from ({low}) to ({high})"
        )

    def left_at(self, positions: ArrayLike) -> Array | None:
        """The first positions (n,) of a motion (k, n) where the tip is outside, or None."""
        points = np.asarray(positions, dtype=float)
        for a, b in itertools.pairwise(points):
            for t in np.linspace(
                0.0, 1.0, max(int(np.ceil(np.max(np.abs(b - a)) / STEP)), 1), endpoint=False
            ):
                if self.excess(a + t * (b - a)) > 0.0:
                    return a + t * (b - a)
        return points[-1] if self.excess(points[-1]) > 0.0 else None
