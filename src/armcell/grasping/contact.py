"""Contact between one gripper pad and an object."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armcell.core.checks import float_array

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PadContact:
    """Contact patch between an object and a gripper's soft finger pad, with surface friction and torsional
    friction.
    """

    point: Array  # (3,) [m] center of the patch
    normal: Array  # (3,) unit vector, points out of the object
    radius: float  # [m] radius of gyration of the patch; 0 for a point contact

    @staticmethod
    def of(row: Array) -> PadContact:
        """Create the contact between a gripper's pad and an object from one
        row (8,) of the array that `hand_fit_kernel.fit` returns.
        """
        row = float_array(row, (8,), "a row", finite=False)
        return PadContact(row[:3].copy(), row[3:6].copy(), float(row[7]))
