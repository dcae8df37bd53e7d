"""Broad phase of collision checking: boxes around all geometries, and gaps between boxes.

The functions are compiled by Numba.
"""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True)
def world_boxes(Ts, link, center, R_half, is_static, out_center, out_half):
    """Compute axis-aligned bounding boxes in the world frame for collision
    geometries that move with their links (broad phase).

    Args:
        Ts: T_world_link (links, 4, 4).
        link: link of each geometry (g,).
        center: box center in the link frame (g, 3) [m].
        R_half: columns are the box's half axes in the link frame (g, 3, 3) [m].
        is_static: geometries whose box is already in `out_*` (g,).
    """
    for g in range(len(link)):
        if is_static[g]:
            continue
        T = Ts[link[g]]
        for i in range(3):
            out_center[g, i] = (
                T[i, 3] + T[i, 0] * center[g, 0] + T[i, 1] * center[g, 1] + T[i, 2] * center[g, 2]
            )
            h = 0.0
            for k in range(3):
                h += abs(T[i, 0] * R_half[g, 0, k] + T[i, 1] * R_half[g, 1, k] + T[i, 2] * R_half[g, 2, k])
            out_half[g, i] = h


@njit(cache=True)
def box_gaps(pairs, center, half, out):
    """Compute the gap [m] between the bounding boxes of each pair (p, 2) in the broad phase.
    The gap is 0 where boxes overlap.

    The distance is never above the true one.
    """
    for p in range(len(pairs)):
        a, b = pairs[p, 0], pairs[p, 1]
        total = 0.0
        for i in range(3):
            gap = abs(center[a, i] - center[b, i]) - half[a, i] - half[b, i]
            if gap > 0.0:
                total += gap * gap
        out[p] = np.sqrt(total)
