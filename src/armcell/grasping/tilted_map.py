"""Height map of a heap as the hand sees it along a slanted approach."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from armcell.core import SE3, SO3, HeightMap

Array = NDArray[np.float64]


def slanted_views(seen: HeightMap, tilt: float, directions: int) -> list[SE3]:
    """Return the frames of the slanted approaches over a height map: T_world_view, whose z axes lean from the
    vertical by `tilt` [rad] in directions that are distributed evenly. With a tilt of 0, one frame: the
    world's.
    """
    if tilt == 0.0:
        return [SE3.identity()]
    half = 0.5 * seen.resolution * (np.array(seen.heights.shape) - 1)
    middle = np.array([*(np.asarray(seen.origin) + half), 0.0])
    angles = 2 * np.pi * np.arange(directions) / directions
    return [SE3(SO3.exp((tilt * np.cos(a), tilt * np.sin(a), 0.0)), middle) for a in angles]


def tilted_map(
    seen: HeightMap, labels: NDArray[np.int64], T_world_view: SE3
) -> tuple[HeightMap, NDArray[np.int64]]:
    """Return a height map and its labels as they look along the z axis of a frame, in this frame.

    Each cell of the map counts as a column that is filled down to its lowest neighbor, as hidden space must:
    the tilted map shows the tops of the columns and their free sides.

    Args:
        labels: (nx, ny) piece number of each cell, -1 for none.
    """
    points, label, visible = _surface(seen, labels)
    at = T_world_view.inverse().apply(points)
    low = at[:, :2].min(0)
    cells = np.round((at[:, :2] - low) / seen.resolution).astype(np.int64)
    order = np.argsort(at[:, 2], kind="stable")  # the highest point of a cell is written last
    i, j = cells[order].T
    shape = tuple(int(n) + 1 for n in cells.max(0))
    heights = np.full(shape, -np.inf)
    heights[i, j] = at[order, 2]
    numbers, shown = np.full(shape, -1), np.zeros(shape, bool)
    numbers[i, j], shown[i, j] = label[order], visible[order]
    heights = _without_holes(heights)
    return HeightMap(heights, shown, (float(low[0]), float(low[1])), seen.resolution), numbers


def _surface(
    seen: HeightMap, labels: NDArray[np.int64]
) -> tuple[Array, NDArray[np.int64], NDArray[np.bool_]]:
    """Return points (n, 3) [m, world] on the tops and the free sides of a height map's columns, with the
    piece number of each point, and whether the camera has seen its column.
    """
    from scipy.ndimage import grey_erosion

    step = seen.resolution
    cells = np.argwhere(np.isfinite(seen.heights))
    i, j = cells.T
    drop = (seen.heights - grey_erosion(seen.heights, size=(3, 3), mode="nearest"))[i, j]
    count = 1 + np.floor(drop / step).astype(np.int64)
    points = np.repeat(seen.at(cells), count, axis=0)
    below = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    points[:, 2] -= step * below
    return points, np.repeat(labels[i, j], count), np.repeat(seen.seen[i, j], count)


def _without_holes(heights: Array) -> Array:
    """Fill the single empty cells that the turned grid leaves in a tilted map, each with its highest
    neighbor.
    """
    from scipy.ndimage import grey_dilation

    empty = ~np.isfinite(heights)
    return np.where(empty, grey_dilation(heights, size=(3, 3), mode="nearest"), heights)
