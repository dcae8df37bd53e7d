"""Time-optimal parameterization of a path under joint and torque limits (Numba).

Reachability analysis (Pham and Pham, "A new approach to time-optimal path parameterization based on
reachability analysis", T-RO 2018): a backward pass finds the largest squared path speed x = ds/dt^2 from
which the end can still be reached; a forward pass takes the largest path acceleration u within this bound.
Constraints hold at both ends of every interval of the grid. A line without torque limits needs no grid: its
largest acceleration is the same everywhere, so the line is one interval that is solved exactly (speed up,
cruise, slow down). The tests compare the results with the toppra package.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from armcell.timing.path_pieces import LINE, coefficients

EPS = 1e-12
ANGLE_STEP = 0.06  # [rad] of turning per interval in a corner
MIN_CORNER = 8  # intervals in a corner
FAST = {"nnan", "nsz", "ninf"}  # no NaN or infinity gets here: limits and waypoints are checked
MIN_GRIDDED = 16  # intervals of a line with torque limits


@njit(cache=True)
def grid(kind, length, turn, line_step):
    """Divide the pieces of a path into intervals for TOPP (time-optimal path parameterization). Return the
    piece, start and end of each interval.

    Start and end are path parameters in the piece. Lines are divided only if line_step > 0.
    """
    count = np.ones(len(kind), np.int64)
    for p in range(len(kind)):
        if kind[p] != LINE:
            count[p] = max(int(np.ceil(turn[p] / ANGLE_STEP)), MIN_CORNER)
        elif line_step > 0.0:
            count[p] = max(int(np.ceil(length[p] / line_step)), MIN_GRIDDED)
    m = count.sum()
    piece, begin, end = np.empty(m, np.int64), np.empty(m), np.empty(m)
    i = 0
    for p in range(len(kind)):
        for c in range(count[p]):
            piece[i], begin[i], end[i] = p, length[p] * c / count[p], length[p] * (c + 1) / count[p]
            i += 1
    return piece, begin, end


@njit(cache=True, fastmath=FAST)
def _largest_x(center, half, slope, i, ds, reach, cap):
    """Return the largest squared path speed x in [0, cap] that satisfies all constraints of interval i of the
    path, for TOPP (time-optimal path parameterization).

    x is allowed if some u has |u - center + slope x| <= half in every row of interval i and
    0 <= x + 2 ds u <= reach. Newton's method on a convex piecewise linear function takes a few steps.
    """
    x = cap
    for _ in range(50):
        low, high = -x / (2.0 * ds), (reach - x) / (2.0 * ds)
        low_slope = high_slope = -1.0 / (2.0 * ds)
        for r in range(half.shape[1]):
            middle = center[i, r] - slope[i, r] * x
            upper, lower = middle + half[i, r], middle - half[i, r]
            high_slope = -slope[i, r] if upper < high else high_slope
            low_slope = -slope[i, r] if lower > low else low_slope
            high, low = min(upper, high), max(lower, low)
        if low - high <= 1e-11 * (abs(low) + abs(high)):
            return x
        if low_slope <= high_slope:
            return 0.0
        x -= (low - high) / (low_slope - high_slope)
        if x <= 0.0:
            return 0.0
    return x


@njit(cache=True)
def _row(alpha, beta, constant, limit, i, r, center, half, slope, cap):
    """Store one constraint for TOPP (time-optimal path parameterization) in the tables: |alpha u + beta x +
    constant| <= limit at interval i and row r, with path acceleration u and squared path speed x.

    Return the upper bound that the constraint sets on x, at most `cap`.
    """
    if abs(alpha) > EPS:
        inverse = 1.0 / alpha
        center[i, r], half[i, r], slope[i, r] = -constant * inverse, limit * abs(inverse), beta * inverse
        return cap
    center[i, r], half[i, r], slope[i, r] = 0.0, 1e18, 0.0
    if abs(beta) > EPS:
        return min(cap, (limit - constant * np.sign(beta)) / abs(beta))
    return cap


@njit(cache=True, fastmath=FAST)
def fastest(pieces, rests, piece, begin, end, velocity, acceleration, torque, torque_limit):
    """Compute the time-optimal motion along the pieces of a path by TOPP (time-optimal path
    parameterization), within joint limits and torque limits.

    The motion is at rest at both ends and at the end of each piece that `rests`.

    Args:
        pieces: arrays of the path's pieces, see `BlendedPath.arrays`.
        rests: (p,) whether the motion must rest at the end of each piece.
        piece, begin, end: the grid (m,), see `grid`.
        velocity, acceleration: limits (n,).
        torque: (m, 2, 3, n) coefficients of u, x and 1 in the joint torques at both ends of each interval;
            m = 0 for no torque limits.
        torque_limit: torque limits (n,).
    Returns:
        Intervals of constant path acceleration: piece (k,); path parameter in the piece, speed and
        acceleration at the start of the interval, each (k,); start times (k + 1,), with the end of the
        motion last.
    """
    kind, _, x, y, length, radius = pieces
    m, n = len(piece), len(velocity)
    gridded = len(torque) > 0
    rows = 4 * n if gridded else 2 * n
    center, half, slope = np.empty((m, rows)), np.empty((m, rows)), np.empty((m, rows))
    cap = np.full(m + 1, 1e18)  # of x, at the grid points
    most, line_cap = np.empty(m), np.empty(m)  # largest |u| and x on straight intervals
    d0, c0, d1, c1 = np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    dc = dd = ec = ed = 0.0
    for i in range(m):
        p, ds = piece[i], end[i] - begin[i]
        da, db, ea, eb = dc, dd, ec, ed
        if i == 0 or piece[i - 1] != p:
            _, _, da, db, ea, eb = coefficients(kind[p], length[p], radius[p], begin[i])
        _, _, dc, dd, ec, ed = coefficients(kind[p], length[p], radius[p], end[i])
        slow0 = slow1 = 1e9
        most[i] = 1e18
        for k in range(n):
            d0[k], c0[k] = da * x[p, k] + db * y[p, k], ea * x[p, k] + eb * y[p, k]
            d1[k], c1[k] = dc * x[p, k] + dd * y[p, k], ec * x[p, k] + ed * y[p, k]
            slow0 = min(slow0, velocity[k] / max(abs(d0[k]), EPS))
            slow1 = min(slow1, velocity[k] / max(abs(d1[k]), EPS))
        cap[i], cap[i + 1] = min(cap[i], slow0 * slow0), min(cap[i + 1], slow1 * slow1)
        if kind[p] == LINE and not gridded:
            line_cap[i] = slow0 * slow0
            for k in range(n):
                most[i] = min(most[i], acceleration[k] / max(abs(d0[k]), EPS))
            continue
        for k in range(n):
            a = acceleration[k]
            cap[i] = _row(d0[k], c0[k], 0.0, a, i, 2 * k, center, half, slope, cap[i])
            cap[i] = _row(d1[k] + 2.0 * ds * c1[k], c1[k], 0.0, a, i, 2 * k + 1, center, half, slope, cap[i])
        if gridded:
            for k in range(n):
                r, limit = 2 * n + 2 * k, torque_limit[k]
                t0, t1 = torque[i, 0], torque[i, 1]
                cap[i] = _row(t0[0, k], t0[1, k], t0[2, k], limit, i, r, center, half, slope, cap[i])
                cap[i] = _row(t1[0, k] + 2.0 * ds * t1[1, k], t1[1, k], t1[2, k], limit, i, r + 1,
                              center, half, slope, cap[i])  # fmt: skip
    cap[0] = cap[m] = 0.0
    for i in range(m - 1):
        if rests[piece[i]] and piece[i + 1] != piece[i]:
            cap[i + 1] = 0.0
    reach = np.empty(m + 1)
    reach[m] = 0.0
    for i in range(m - 1, -1, -1):
        ds = end[i] - begin[i]
        if kind[piece[i]] == LINE and not gridded:
            reach[i] = min(cap[i], reach[i + 1] + 2.0 * most[i] * ds)
        else:
            reach[i] = _largest_x(center, half, slope, i, ds, reach[i + 1], cap[i])

    out_piece, out_s = np.empty(3 * m, np.int64), np.empty(3 * m)
    out_v, out_u, out_t = np.empty(3 * m), np.empty(3 * m), np.empty(3 * m + 1)
    count, t, now = 0, 0.0, 0.0
    steps, ends = np.empty(3), np.empty(3)
    for i in range(m):
        ds = end[i] - begin[i]
        if kind[piece[i]] == LINE and not gridded:
            a = most[i]
            then = min(reach[i + 1], now + 2.0 * a * ds)
            peak = min(line_cap[i], (now + then) / 2.0 + a * ds)
            steps[0], steps[2] = (peak - now) / (2.0 * a), (peak - then) / (2.0 * a)
            steps[1] = ds - steps[0] - steps[2]
            ends[0], ends[1], ends[2] = peak, peak, then
        else:
            low, high = -1e18, (reach[i + 1] - now) / (2.0 * ds)
            for r in range(rows):
                middle = center[i, r] - slope[i, r] * now
                low, high = max(low, middle - half[i, r]), min(high, middle + half[i, r])
            then = min(max(now + 2.0 * ds * max(low, high), 0.0), reach[i + 1])
            steps[0], steps[1], steps[2] = ds, 0.0, 0.0
            ends[0] = then
        s = begin[i]
        for part in range(3):
            if steps[part] <= EPS * ds:
                continue
            v0, v1 = np.sqrt(now), np.sqrt(ends[part])
            out_piece[count], out_s[count], out_v[count], out_t[count] = piece[i], s, v0, t
            out_u[count] = (ends[part] - now) / (2.0 * steps[part])
            t += 2.0 * steps[part] / max(v0 + v1, 1e-9)
            s += steps[part]
            now = ends[part]
            count += 1
        now = then
    out_t[count] = t
    return out_piece[:count], out_s[:count], out_v[:count], out_u[:count], out_t[: count + 1]
