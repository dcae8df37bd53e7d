"""Numbers of clearing a bin."""

from __future__ import annotations

from dataclasses import dataclass

from armcell.core.checks import checked, require
from armcell.grasping import AboveSettings


@dataclass(frozen=True)
@checked()
class ClearSettings:
    """Of clearing a bin by what a camera sees. Lengths in metres."""

    force: float = 30.0  # [N] per finger: nothing is known of weights
    lift: float = 0.20  # from the bin
    above_floor: float = 0.007  # what rises less is the floor
    resolution: float = 0.003  # of the map of heights
    hand_room: float = 0.12  # around the bin that the map shows too: where the hand's back will be
    gap: float = 0.012  # between what is held and what is under it when the fingers open
    spot_radius: float = 0.05  # around the middle of a place that shall be low
    pile: float = 0.10  # above the tray's floor: where it is higher everywhere, the tray is full
    most_misses: int = 8  # picks in a row that bring nothing
    most_picks: int = 60
    thinnest: float = 0.0015  # fingers closer together hold nothing
    max_age: float = 0.5  # [s] of a picture
    grasps: AboveSettings = AboveSettings()

    def __post_init__(self) -> None:
        for name in ("force", "lift", "above_floor", "resolution", "gap", "spot_radius", "pile", "max_age"):
            require(getattr(self, name) > 0, f"{name} is {getattr(self, name):g}, it must be positive")
        for name in ("most_misses", "most_picks"):
            require(getattr(self, name) >= 1, f"{name} is {getattr(self, name)}, it must be at least 1")
