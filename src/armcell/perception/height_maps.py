"""Height map of a bin seen from above, and its segmentation into pieces."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from armcell.collision import robot_mask
from armcell.core import CameraImage, HeightMap
from armcell.perception.cloud import clusters, organized_cloud
from armcell.scene import PlanningScene

F64 = NDArray[np.float64]

ROBOT_PADDING = 0.03  # [m] margin around the robot; points within it are ignored


def height_map(
    image: CameraImage,
    scene: PlanningScene,
    low: tuple[float, float],
    high: tuple[float, float],
    floor: float,
    resolution: float = 0.003,
) -> HeightMap:
    """Compute the height map of a bin from a depth image: each cell has the height of its highest visible
    point.

    Points on the robot are ignored.

    Args:
        image: image with depth.
        scene: the robot's state at the time of the image.
        low, high: corners of the rectangle [m, world x and y].
        floor: [m, world z] lower bound of the heights; lower points are raised to it.
        resolution: [m] edge length of a cell.
    """
    assert image.depth is not None
    points = organized_cloud(image.depth, image.pinhole).reshape(-1, 3)
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
    """Fill the empty cells of a height map from the rim inward: each empty cell gets the height of its
    highest neighbor.
    """
    from scipy.ndimage import grey_dilation

    found = heights.copy()
    for _ in range(max(found.shape)):
        empty = ~np.isfinite(found)
        if not empty.any() or empty.all():
            break
        found[empty] = grey_dilation(found, size=(3, 3), mode="nearest")[empty]
    return found


def label_pieces(
    seen: HeightMap, where: NDArray[np.bool_], above: float, step: float = 0.010, smallest: int = 8
) -> NDArray[np.int64]:
    """Segment the height map (nx, ny) of a bin: label each separate piece with a number. Cells outside all
    pieces get -1.

    A height step between neighboring cells separates two pieces.

    Args:
        where: (nx, ny) cells to segment.
        above: [m, world z] lower points belong to the floor.
        step: [m] maximum height step between neighboring cells of a piece.
        smallest: [cells] smaller pieces are noise.
    """
    nx, ny = seen.heights.shape
    index = np.stack(np.meshgrid(np.arange(nx), np.arange(ny), indexing="ij"), -1).reshape(-1, 2)
    points = seen.at(index).reshape(nx, ny, 3)
    labels = np.full(nx * ny, -1)
    wanted = where & seen.seen & (seen.heights > above)
    for k, cells in enumerate(clusters(points, wanted, step, smallest)):
        labels[cells] = k
    return labels.reshape(nx, ny)
