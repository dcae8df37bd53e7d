"""What one pad of a gripper meets."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armcell.core.checks import float_array

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PadContact:
    """A patch of contact as a soft finger: friction along the surface and torsion about its normal."""

    point: Array  # (3,) [m] middle of the patch
    normal: Array  # (3,) unit, out of the object
    radius: float  # [m] of gyration of the patch; 0 is a point

    @staticmethod
    def of(row: Array) -> PadContact:
        """From a row (8,) of `kernel.fit`."""
        row = float_array(row, (8,), "a row", finite=False)
        return PadContact(row[:3].copy(), row[3:6].copy(), float(row[7]))
