"""Settings of the bin clearing task."""

from __future__ import annotations

from dataclasses import dataclass

from armcell.core.checks import checked, require
from armcell.grasping import DragSettings, PushSettings, TopDownGraspSettings
from armcell.tasks.settings import Speed

_POSITIVE = (
    "force", "lift", "above_floor", "resolution", "beside", "gap", "spot_radius", "touched", "pile",
    "max_age", "push_force", "press_force",
)  # fmt: skip


@dataclass(frozen=True)
@checked()
class BinClearingSettings:
    """Settings for clearing a bin with a camera. All lengths are in meters."""

    force: float = 30.0  # [N] per finger, because weights are unknown
    lift: float = 0.15  # lift height above the grasp
    above_floor: float = 0.007  # lower points belong to the floor
    resolution: float = 0.003  # cell size of the height map
    hand_room: float = 0.12  # mapped margin around the bin, for the back of the hand
    beside: float = 0.16  # margin of the table around bin and tray that is searched for pieces
    gap: float = 0.012  # between the held object and the surface below when the fingers open
    spot_radius: float = 0.05  # radius of the low area around a release point
    touched: float = 0.15  # radius around a grasp in which it may have moved pieces since the last image
    pile: float = 0.10  # above the tray's floor; the tray is full if all points are higher
    most_misses: int = 8  # maximum number of failed picks in a row, if few pieces are visible
    tries_per_piece: int = 2  # failed picks in a row per visible piece, if many are visible
    most_picks: int = 60
    most_pushes: int = 8  # maximum number of pushes in a row without a pick
    thinnest: float = 0.0005  # fingers closer together hold sheet metal or nothing: the force decides
    max_age: float = 0.5  # [s] maximum age of an image
    grasps: TopDownGraspSettings = TopDownGraspSettings()
    tilts: tuple[float, ...] = (0.26, 0.52, 0.70)  # [rad] of approaches, if no vertical one is possible
    push: Speed = Speed(0.15, 0.2)  # speed of pushes off a wall
    push_force: float = 40.0  # [N] on the hand, at which a push ends
    pushes: PushSettings = PushSettings()
    press: Speed = Speed(0.03, 0.1)  # speed at which a fingertip presses on a piece before a drag
    press_force: float = 15.0  # [N] at which the press ends
    drags: DragSettings = DragSettings()

    def __post_init__(self) -> None:
        for name in _POSITIVE:
            require(getattr(self, name) > 0, f"{name} is {getattr(self, name):g}, it must be positive")
        for name in ("most_misses", "tries_per_piece", "most_picks"):
            require(getattr(self, name) >= 1, f"{name} is {getattr(self, name)}, it must be at least 1")
        require(self.most_pushes >= 0, f"most_pushes is {self.most_pushes}, it must not be negative")
