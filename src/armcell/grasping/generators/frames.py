"""Construction of tcp poses from approach and closing directions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def tcp_pose(closing: Array, approach: Array, at: Array) -> Array:
    """Return the frame of a grasp, T_object_tcp (4, 4), from its closing direction and its approach
    direction.

    Both are orthogonal unit vectors (3,); the tcp is at a point (3,) [m].
    """
    T = np.eye(4)
    T[:3, 0] = np.cross(closing, approach)
    T[:3, 1], T[:3, 2], T[:3, 3] = closing, approach, at
    return T


def directions_around(axis: Array, count: int, first: Array) -> Array:
    """Return unit approach directions (count, 3) for grasp frames, distributed evenly around an axis.

    The first direction is the one nearest to `first` (3,).
    """
    start = first - (first @ axis) * axis
    if np.linalg.norm(start) < 1e-6:  # `first` is parallel to the axis: use any perpendicular direction
        start = np.eye(3)[int(np.argmin(np.abs(axis)))]
        start = start - (start @ axis) * axis
    start = start / np.linalg.norm(start)
    side = np.cross(axis, start)
    angle = 2 * np.pi * np.arange(count) / count
    return np.cos(angle)[:, None] * start + np.sin(angle)[:, None] * side
