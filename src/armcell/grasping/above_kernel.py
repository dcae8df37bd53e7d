"""Compiled: where a parallel hand fits from straight above, on a map of heights."""

from __future__ import annotations

import numpy as np
from numba import njit

FEATURES = 10
MOST_ROWS, MOST_STEPS = 64, 256
POINT = 1e9  # slant of what has no side, only a point


@njit(cache=True)
def _height(heights, x0, y0, resolution, x, y):
    """Of the cell at a point; outside of the map nothing is."""
    i = int(np.floor((x - x0) / resolution + 0.5))
    j = int(np.floor((y - y0) / resolution + 0.5))
    if i < 0 or j < 0 or i >= heights.shape[0] or j >= heights.shape[1]:
        return -1e9
    return heights[i, j]


@njit(cache=True)
def _slope(x, y):
    """Of a line through points: the median of the pairs' slopes (Theil and Sen), which a few points off the
    line, as cameras see them at edges, do not turn."""
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
    """Every place, turn and depth at which the hand fits around something.

    The hand points down and closes along (cos a, sin a). Seen from above a thing is as wide at the height of
    the tips as it is anywhere higher: what overhangs hides what is below.

    Args:
        heights: (nx, ny) [m]; x0, y0, resolution: of the map.
        cells: (k, 2) where the middle between the fingers may be.
        turns: (a,) [rad]; depths: (d,) [m] of the tips below the top at the cell.
        floor: [m] that the tips stay above.
        finger: half width across the closing direction, thickness, length from tip to palm [m].
        palm: half sizes [m] along and across the closing direction.
        opens: [m] at most.
        rules: room beside the thing on each side, how far the fingers stay above what is below them, least
            height of the thing above the tips [m].

    Returns:
        (m, FEATURES): cell, turn index, tip height, shift of the middle along the closing direction, width,
        opening [m], share of the fingers' width in contact, largest slant of a side, least height of a side
        above the tips, top at the cell [m].
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
                # --- how far the thing goes both ways, across the whole width of the fingers
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
                # --- the open fingers, and the way they close
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
                # --- the palm above everything
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
                # --- what the pads meet: where the thing is widest, over how much of their width, how slanted
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
