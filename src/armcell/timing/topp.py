"""Time-optimal parameterisation of a path under velocity and acceleration limits (Numba).

Reachability analysis on a grid (Pham and Pham, "A new approach to time-optimal path parameterization
based on reachability analysis", T-RO 2018): a backward pass finds the largest squared path speed from
which the end can still be reached, a forward pass takes the largest acceleration within it. Constraints
are held at both ends of every interval. Checked against the toppra package in the tests.
"""

from __future__ import annotations

import numpy as np
from numba import njit

EPS = 1e-12


@njit(cache=True)
def _rows(d0, c0, d1, c1, ds, limit, alpha, beta, gamma):
    """alpha u + beta x <= gamma for the joints at both ends of an interval; returns the row count."""
    m = 0
    n = len(limit)
    for k in range(n):
        for sign in (1.0, -1.0):
            alpha[m], beta[m], gamma[m] = sign * d0[k], sign * c0[k], limit[k]
            m += 1
            alpha[m] = sign * (d1[k] + 2.0 * ds * c1[k])
            beta[m], gamma[m] = sign * c1[k], limit[k]
            m += 1
    return m


@njit(cache=True)
def _largest_x(alpha, beta, gamma, m, cap):
    """Largest x in [0, cap] for which some u meets all rows (x = 0 always does)."""
    best = cap
    for i in range(m):
        if abs(alpha[i]) < EPS:
            if beta[i] > EPS:
                best = min(best, gamma[i] / beta[i])
            continue
        if alpha[i] < 0.0:
            continue
        for j in range(m):  # upper bound i against lower bound j
            if alpha[j] >= -EPS:
                continue
            # u <= (gamma_i - beta_i x) / alpha_i and u >= (gamma_j - beta_j x) / alpha_j
            slope = beta[i] / alpha[i] - beta[j] / alpha[j]
            if slope > EPS:
                best = min(best, (gamma[i] / alpha[i] - gamma[j] / alpha[j]) / slope)
    return max(best, 0.0)


@njit(cache=True)
def _u_range(alpha, beta, gamma, m, x):
    low, high = -1e18, 1e18
    for i in range(m):
        room = gamma[i] - beta[i] * x
        if alpha[i] > EPS:
            high = min(high, room / alpha[i])
        elif alpha[i] < -EPS:
            low = max(low, room / alpha[i])
    return low, high


@njit(cache=True)
def speeds(s, tangent, curvature_right, curvature_left, stop, velocity, acceleration):
    """Squared path speed x (g,) at each grid point, zero at both ends and at stops.

    Args:
        s: path length at the grid points (g,), increasing.
        tangent: dq/ds (g, n); curvature_right/left: d2q/ds2 just after and just before (g, n).
        stop: grid points where the motion must stand still (g,).
        velocity, acceleration: limits (n,).
    """
    g, n = tangent.shape
    cap = np.empty(g)
    for i in range(g):
        c = 1e18
        for k in range(n):
            if abs(tangent[i, k]) > EPS:
                c = min(c, velocity[k] / abs(tangent[i, k]))
        cap[i] = 0.0 if stop[i] else c * c
    cap[0] = cap[g - 1] = 0.0
    rows = 4 * n + 2
    alpha, beta, gamma = np.empty(rows), np.empty(rows), np.empty(rows)
    reach = np.empty(g)
    reach[g - 1] = 0.0
    for i in range(g - 2, -1, -1):
        ds = s[i + 1] - s[i]
        m = _rows(
            tangent[i],
            curvature_right[i],
            tangent[i + 1],
            curvature_left[i + 1],
            ds,
            acceleration,
            alpha,
            beta,
            gamma,
        )
        alpha[m], beta[m], gamma[m] = 2.0 * ds, 1.0, reach[i + 1]  # x + 2 ds u <= reach
        m += 1
        alpha[m], beta[m], gamma[m] = -2.0 * ds, -1.0, 0.0  # x + 2 ds u >= 0
        m += 1
        reach[i] = _largest_x(alpha, beta, gamma, m, cap[i])
    x = np.empty(g)
    x[0] = 0.0
    for i in range(g - 1):
        ds = s[i + 1] - s[i]
        m = _rows(
            tangent[i],
            curvature_right[i],
            tangent[i + 1],
            curvature_left[i + 1],
            ds,
            acceleration,
            alpha,
            beta,
            gamma,
        )
        low, high = _u_range(alpha, beta, gamma, m, x[i])
        u = max(low, min(high, (reach[i + 1] - x[i]) / (2.0 * ds)))
        x[i + 1] = min(max(x[i] + 2.0 * ds * u, 0.0), reach[i + 1])
    return x
