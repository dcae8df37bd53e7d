"""Compiled search for top-down poses of a parallel gripper on a height map."""

from __future__ import annotations

import numpy as np
from numba import njit

FEATURES = 10
MOST_ROWS, MOST_STEPS = 64, 256
POINT = 1e9  # slant of a side with only one point


@njit(cache=True)
def _height(heights, x0, y0, resolution, x, y):
    """Return the height at (x, y) on a height map, in the compiled kernel for top-down grasps; -1e9 outside
    the map.
    """
    i = int(np.floor((x - x0) / resolution + 0.5))
    j = int(np.floor((y - y0) / resolution + 0.5))
    if i < 0 or j < 0 or i >= heights.shape[0] or j >= heights.shape[1]:
        return -1e9
    return heights[i, j]


@njit(cache=True)
def _slope(x, y):
    """Return, in the compiled kernel for top-down grasps, the absolute slope of a piece's side on a height
    map: the median slope over all pairs of the side's points.

    The estimator (Theil and Sen) is robust against a few outliers, which cameras produce at edges.
    """
    n = len(x)
    if n < 2:
        return POINT
    slopes, k = np.empty(n * (n - 1) // 2), 0
    for i in range(n):
        for j in range(i):
            slopes[k] = (y[i] - y[j]) / (x[i] - x[j])
            k += 1
    return abs(np.median(slopes))


@njit(cache=True)
def search(heights, x0, y0, resolution, cells, turns, depths, floor, finger, palm, opens, rules):
    """Search a height map for all top-down poses at which a hand fits around a piece, in a compiled kernel.

    A pose is a cell, a rotation and a depth. The hand points down and closes along (cos a, sin a). On a
    height map, a piece is as wide at the fingertips as anywhere above them, because overhangs hide the space
    below.

    Args:
        heights: (nx, ny) [m] heights of the cells.
        x0, y0: center of the first cell [m].
        resolution: edge length of a cell [m].
        cells: (k, 2) cells that may be the center between the fingers.
        turns: (a,) rotations of the hand [rad].
        depths: (d,) depths of the fingertips below the height of the cell [m].
        floor: lowest height of the fingertips [m].
        finger: half width across the closing direction, thickness, length from tip to palm [m].
        palm: half sizes [m] along and across the closing direction.
        opens: largest opening of the fingers [m].
        rules: free space on each side of the piece, distance of the fingers above lower cells, minimum height
            of the piece above the fingertips [m].

    Returns:
        (m, FEATURES) one row per pose: cell, index in `turns`, height of the fingertips, shift of the center
        along the closing direction, width of the piece, opening [m], fraction of the fingers' width in
        contact, largest slant of a side, smallest height of a side above the fingertips, cell's height [m].
    """
    half, thick, length = finger[0], finger[1], finger[2]
    room, clear, engage = rules[0], rules[1], rules[2]
    rows = min(2 * int(np.ceil(half / resolution)) + 1, MOST_ROWS)
    reach = opens / 2 + thick
    steps = min(2 * int(np.ceil(2 * reach / resolution)) + 1, MOST_STEPS)
    mid = steps // 2
    window, top = np.empty((steps, rows)), np.empty(steps)
    at_across, at_along = np.empty(rows), np.empty(rows)
    found = np.empty((len(cells) * len(turns) * len(depths), FEATURES))
    count = 0
    for c in range(len(cells)):
        x = x0 + resolution * cells[c, 0]
        y = y0 + resolution * cells[c, 1]
        z = heights[cells[c, 0], cells[c, 1]]
        for a in range(len(turns)):
            ux, uy = np.cos(turns[a]), np.sin(turns[a])
            for s in range(steps):
                along = (s - mid) * resolution
                top[s] = -1e9
                for t in range(rows):
                    across = (t - rows // 2) * half / max(rows // 2, 1)
                    window[s, t] = _height(
                        heights,
                        x0,
                        y0,
                        resolution,
                        x + along * ux - across * uy,
                        y + along * uy + across * ux,
                    )
                    top[s] = max(top[s], window[s, t])
            last = 1e9
            for d in range(len(depths)):
                tip = max(floor, z - depths[d])
                if z < tip + engage or tip == last:
                    continue
                last = tip
                # --- extent of the piece in both closing directions, over the whole width of the fingers
                low, high = mid, mid
                while low > 0 and top[low] > tip - clear:
                    low -= 1
                while high < steps - 1 and top[high] > tip - clear:
                    high += 1
                if low == 0 or high == steps - 1 or low == mid or high == mid:
                    continue
                width = (high - low - 1) * resolution
                opening = min(width + 2 * room, opens)
                if width > opens - room or width <= 0:
                    continue
                shift = ((low + high) / 2 - mid) * resolution
                # --- free space for the open fingers and their closing motion
                free = True
                for side in (-1.0, 1.0):
                    outer = opening / 2 + thick
                    edge = (high - mid) * resolution if side > 0 else (low - mid) * resolution
                    near = edge if side > 0 else shift - outer
                    far = shift + outer if side > 0 else edge
                    s = int(np.floor(near / resolution + 0.5)) + mid
                    end = int(np.floor(far / resolution + 0.5)) + mid
                    if s < 0 or end >= steps:
                        free = False
                        break
                    while s <= end:
                        if top[s] > tip - clear:
                            free = False
                            break
                        s += 1
                    if not free:
                        break
                if not free:
                    continue
                # --- the palm must be above all cells below it
                under = tip + length - clear
                ok = True
                p = -palm[0]
                while ok and p <= palm[0]:
                    q = -palm[1]
                    while q <= palm[1]:
                        along, across = shift + p, q
                        if (
                            _height(
                                heights, x0, y0, resolution,
                                x + along * ux - across * uy, y + along * uy + across * ux,
                            )
                            > under
                        ):  # fmt: skip
                            ok = False
                            break
                        q += 2 * resolution
                    p += 2 * resolution
                if not ok:
                    continue
                # --- contact of the pads at the piece's widest point: fraction of their width, slant
                touching, slant, lowest = 1.0, 0.0, 1e9
                for side in (-1, 1):
                    edge = high - 1 if side > 0 else low + 1
                    met, n, tall = 0, 0, -1e9
                    for t in range(rows):
                        s, end = edge, low if side > 0 else high
                        while s != end and window[s, t] <= tip - clear:
                            s -= side
                        if s == end:
                            continue
                        at_across[n] = (t - rows // 2) * half / max(rows // 2, 1)
                        at_along[n] = s * resolution
                        n += 1
                        if abs(s - edge) <= 1:
                            met += 1
                            for inside in range(3):
                                at = s - side * inside
                                if 0 <= at < steps:
                                    tall = max(tall, window[at, t])
                    touching = min(touching, met / rows)
                    lowest = min(lowest, tall - tip)
                    slant = max(slant, _slope(at_across[:n], at_along[:n]))
                if lowest < engage:
                    continue
                row = found[count]
                row[0], row[1], row[2], row[3], row[4] = c, a, tip, shift, width
                row[5], row[6], row[7], row[8], row[9] = opening, touching, slant, lowest, z
                count += 1
    return found[:count]
