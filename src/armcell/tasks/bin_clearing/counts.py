"""Counters of bin clearing, and what the arms remember of their attempts."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armcell.grasping import HeapGrasp
from armcell.tasks.bin_clearing.work_regions import RegionView


@dataclass
class BinClearingCounts:
    """Counters of `clear_bin` for picks and failures. Arms that clear one bin side by side share them."""

    picks: int = 0  # closed grasps
    put: int = 0  # objects released over the tray
    missed: int = 0  # closed without an object, or lost during the lift
    dropped: int = 0  # lost in transit
    unplanned: int = 0  # looks without a reachable grasp
    pushes: int = 0  # pushes of a piece off a wall
    in_a_row: int = 0  # failures since the last success
    avoid: list[HeapGrasp] = field(default_factory=list)  # failed grasps
    pushed: list[tuple[float, float, float]] = field(default_factory=list)  # x, y [m], direction [rad]
    dragged: list[tuple[float, float]] = field(default_factory=list)  # x, y [m] of the contact
    left: dict[str, str] = field(default_factory=dict)  # regions set aside, with the number of pieces in each
    last_view: RegionView | None = None  # of the bin; None after an attempt that may have moved any piece
    touched: list[NDArray[np.float64]] = field(default_factory=list)  # x, y [m] of the grasps since then

    def as_dict(self) -> dict[str, Any]:
        return {k: v for k, v in self.__dict__.items() if isinstance(v, int) and k != "in_a_row"}
