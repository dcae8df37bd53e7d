"""A bin seen from above: a map of heights, and what lies in it as pieces."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from armcell.collision import robot_mask
from armcell.core import CameraImage, HeightMap
from armcell.perception.cloud import organised
from armcell.perception.segment import clusters
from armcell.scene import PlanningScene

F64 = NDArray[np.float64]

ROBOT_PADDING = 0.03  # [m] around the robot, whose points do not count


def height_map(
    image: CameraImage,
    scene: PlanningScene,
    low: tuple[float, float],
    high: tuple[float, float],
    floor: float,
    resolution: float = 0.003,
) -> HeightMap:
    """The highest point that a picture shows in each cell, without the robot.

    Args:
        image: with depth.
        scene: the robot as it stood when the picture was taken.
        low, high: corners of the rectangle [m, world x and y].
        floor: [m, world z] nothing is lower; what the picture shows lower is there too.
        resolution: [m] edge of a cell.
    """
    assert image.depth is not None
    points = organised(image.depth, image.pinhole).reshape(-1, 3)
    points = image.T_world_camera.apply(points[np.isfinite(points[:, 0])])
    shape = tuple(int(np.ceil((b - a) / resolution)) + 1 for a, b in zip(low, high, strict=True))
    cells = np.round((points[:, :2] - low) / resolution).astype(np.int64)
    inside = np.all((cells >= 0) & (cells < shape), axis=1)
    points, cells = points[inside], cells[inside]
    others = ~robot_mask(scene, points, ROBOT_PADDING)
    heights = np.full(shape, -np.inf)
    np.maximum.at(heights, (cells[others, 0], cells[others, 1]), points[others, 2])
    seen = np.isfinite(heights)
    heights = np.maximum(_filled(heights), floor)
    return HeightMap(heights, seen, (float(low[0]), float(low[1])), resolution)


def _filled(heights: F64) -> F64:
    """Cells without a height get the highest of their neighbours', from the rim inwards."""
    from scipy.ndimage import grey_dilation

    found = heights.copy()
    for _ in range(max(found.shape)):
        empty = ~np.isfinite(found)
        if not empty.any() or empty.all():
            break
        found[empty] = grey_dilation(found, size=(3, 3), mode="nearest")[empty]
    return found


def pieces(
    seen: HeightMap, where: NDArray[np.bool_], above: float, step: float = 0.010, smallest: int = 8
) -> NDArray[np.int64]:
    """Numbers (nx, ny) of what lies apart, -1 where nothing does: a step in height parts two things.

    Args:
        where: (nx, ny) the cells that are looked at.
        above: [m, world z] what is lower is the floor.
        step: [m] between neighbouring cells' tops within one piece.
        smallest: [cells] pieces of fewer are noise.
    """
    nx, ny = seen.heights.shape
    index = np.stack(np.meshgrid(np.arange(nx), np.arange(ny), indexing="ij"), -1).reshape(-1, 2)
    points = seen.at(index).reshape(nx, ny, 3)
    labels = np.full(nx * ny, -1)
    wanted = where & seen.seen & (seen.heights > above)
    for k, cells in enumerate(clusters(points, wanted, step, smallest)):
        labels[cells] = k
    return labels.reshape(nx, ny)
