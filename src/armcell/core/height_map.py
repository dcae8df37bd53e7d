"""Height map of a scene seen from above."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.core.checks import checked, float_array
from armcell.core.errors import InputError


@dataclass(frozen=True, eq=False)
@checked()
class HeightMap:
    """Height map: a grid of heights [m] over a rectangle of the world, as a camera sees it from above.

    Unseen cells have the height of the highest seen neighbor, because hidden objects may be there.
    """

    heights: NDArray[np.float64]  # (nx, ny) [m, world z]
    seen: NDArray[np.bool_]  # (nx, ny)
    origin: tuple[float, float]  # [m, world] center of the first cell
    resolution: float  # [m]

    def at(self, cells: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return the centers of the given cells of a height map as points (n, 3) [m, world frame], each at
        the height of its cell.
        """
        cells = float_array(cells, (None, 2), "cells").astype(np.int64)
        if ((cells < 0) | (cells >= self.heights.shape)).any():
            raise InputError(f"a cell is outside a map of {self.heights.shape} cells")
        found = np.empty((len(cells), 3))
        found[:, :2] = np.asarray(self.origin) + self.resolution * cells
        found[:, 2] = self.heights[cells[:, 0], cells[:, 1]]
        return found

    def cells_within(self, low: ArrayLike, high: ArrayLike) -> NDArray[np.bool_]:
        """Return a mask (nx, ny) of the cells in a height map whose centers are inside a rectangle [m, world
        frame].
        """
        low, high = float_array(low, (2,), "low"), float_array(high, (2,), "high")
        nx, ny = self.heights.shape
        x = self.origin[0] + self.resolution * np.arange(nx)
        y = self.origin[1] + self.resolution * np.arange(ny)
        inside_x, inside_y = (x >= low[0]) & (x <= high[0]), (y >= low[1]) & (y <= high[1])
        return inside_x[:, None] & inside_y[None, :]
