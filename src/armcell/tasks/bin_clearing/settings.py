"""Settings of the bin clearing task."""

from __future__ import annotations

from dataclasses import dataclass

from armcell.core.checks import checked, require
from armcell.grasping import TopDownGraspSettings


@dataclass(frozen=True)
@checked()
class BinClearingSettings:
    """Settings for clearing a bin with a camera. All lengths are in meters."""

    force: float = 30.0  # [N] per finger, because weights are unknown
    lift: float = 0.15  # lift height above the grasp
    above_floor: float = 0.007  # lower points belong to the floor
    resolution: float = 0.003  # cell size of the height map
    hand_room: float = 0.12  # mapped margin around the bin, for the back of the hand
    gap: float = 0.012  # between the held object and the surface below when the fingers open
    spot_radius: float = 0.05  # radius of the low area around a release point
    pile: float = 0.10  # above the tray's floor; the tray is full if all points are higher
    most_misses: int = 8  # maximum number of failed picks in a row
    most_picks: int = 60
    thinnest: float = 0.0015  # fingers closer together are empty
    max_age: float = 0.5  # [s] maximum age of an image
    grasps: TopDownGraspSettings = TopDownGraspSettings()

    def __post_init__(self) -> None:
        for name in ("force", "lift", "above_floor", "resolution", "gap", "spot_radius", "pile", "max_age"):
            require(getattr(self, name) > 0, f"{name} is {getattr(self, name):g}, it must be positive")
        for name in ("most_misses", "most_picks"):
            require(getattr(self, name) >= 1, f"{name} is {getattr(self, name)}, it must be at least 1")
