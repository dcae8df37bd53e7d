"""The three kinds of path pieces, each in a plane: line, arc and spline (Numba).

A piece is q(s) = origin + a(s) x + b(s) y.
"""

from __future__ import annotations

import numpy as np
from numba import njit

LINE, ARC, SPLINE = 0, 1, 2

MIN_EDGE = 1e-6  # [rad] shorter edges are dropped
STRAIGHT = 1e-5  # [rad] smaller turns are no corners
REVERSAL = np.pi - 1e-3  # [rad] larger turns cannot be rounded
HALF_STEP = 0.09375  # integral of the smooth step 3 z^2 - 2 z^3 over its first half


@njit(cache=True)
def coefficients(kind, length, radius, s):
    """Evaluate the coordinates (a, b) of a line, arc or spline in its plane at path parameter s.
    Also return their first and second derivatives with respect to s.

    A line has (a, b) = (s, 0), an arc (r cos(s/r), r sin(s/r)). A spline turns its derivative from x to y by
    a smooth step, q' = (1 - w) x + w y with w = 3 z^2 - 2 z^3, z = s / length: its second derivative is
    continuous with the adjacent lines.
    """
    if kind == LINE:
        return s, 0.0, 1.0, 0.0, 0.0, 0.0
    if kind == ARC:
        c, n = np.cos(s / radius), np.sin(s / radius)
        return radius * c, radius * n, -n, c, -c / radius, -n / radius
    z = s / length
    w = z * z * (3.0 - 2.0 * z)
    area = length * z * z * z * (1.0 - 0.5 * z)
    slope = 6.0 * z * (1.0 - z) / length
    return s - area, area, 1.0 - w, w, -slope, slope


@njit(cache=True)
def distinct(points):
    """Return a mask that drops each point (k, n) of a path within `MIN_EDGE` of the previous kept point.

    The last point is kept, unless all points are within `MIN_EDGE` of the first point.
    """
    k, n = points.shape
    keep = np.zeros(k, np.bool_)
    keep[0] = True
    last = 0
    for i in range(1, k):
        d2 = 0.0
        for j in range(n):
            d2 += (points[i, j] - points[last, j]) ** 2
        if d2 > MIN_EDGE * MIN_EDGE:
            keep[i] = True
            last = i
    if last > 0 and not keep[k - 1]:
        keep[last] = False
        keep[k - 1] = True
    return keep


@njit(cache=True)
def build(points, deviation, smooth):
    """Build the pieces (lines, arcs and splines) of a path that passes through distinct points (k, n) or
    rounds the corners at these points.

    The rounded corners deviate from the points by at most `deviation` (k,).

    Returns:
        The number of pieces p, and for at most 2k pieces: kind, origin, x, y, length, radius, turning angle
        [rad], and whether the motion must stop at the end of the piece.
    """
    k, n = points.shape
    most = 2 * k
    kind, turn = np.zeros(most, np.int64), np.zeros(most)
    length, radius = np.zeros(most), np.full(most, np.inf)
    origin, x, y = np.zeros((most, n)), np.zeros((most, n)), np.zeros((most, n))
    stop = np.zeros(most, np.bool_)
    unit, edge = np.empty((k, n)), np.empty(k)
    for i in range(k - 1):
        total = 0.0
        for j in range(n):
            unit[i, j] = points[i + 1, j] - points[i, j]
            total += unit[i, j] ** 2
        edge[i] = np.sqrt(total)
        for j in range(n):
            unit[i, j] /= edge[i]
    p, cut = 0, 0.0  # cut: length that the corner at the start of the edge takes from the edge
    for i in range(k - 1):
        u, v = unit[i], unit[i + 1]
        reach, angle, chord = 0.0, 0.0, 0.0
        if i < k - 2:
            for j in range(n):
                chord += (v[j] - u[j]) ** 2
            chord = np.sqrt(chord)  # 2 sin(angle / 2)
            angle = 2.0 * np.arcsin(min(chord / 2.0, 1.0))
            if STRAIGHT <= angle <= REVERSAL and deviation[i + 1] > 0.0:
                # The corner may use half of each neighboring edge.
                if smooth:
                    reach = deviation[i + 1] / (2.0 * HALF_STEP * chord)
                else:
                    reach = deviation[i + 1] / np.tan(angle / 4.0)
                reach = min(reach, edge[i] / 2.0, edge[i + 1] / 2.0)
        straight = edge[i] - cut - reach
        if straight > 1e-12:
            kind[p], length[p] = LINE, straight
            for j in range(n):
                origin[p, j] = points[i, j] + cut * u[j]
                x[p, j] = u[j]
            p += 1
        cut = reach
        if reach > 0.0:
            turn[p] = angle
            if smooth:
                kind[p], length[p] = SPLINE, 2.0 * reach
                for j in range(n):
                    origin[p, j] = points[i + 1, j] - reach * u[j]
                    x[p, j] = u[j]
                    y[p, j] = v[j]
            else:
                r = reach / np.tan(angle / 2.0)
                kind[p], length[p], radius[p] = ARC, angle * r, r
                away = r / np.cos(angle / 2.0)
                for j in range(n):
                    origin[p, j] = points[i + 1, j] + away * (v[j] - u[j]) / chord
                    x[p, j] = (points[i + 1, j] - reach * u[j] - origin[p, j]) / r
                    y[p, j] = u[j]
            p += 1
        elif angle > 4.5e-5:
            stop[p - 1] = True
    return p, kind, origin, x, y, length, radius, turn, stop


@njit(cache=True)
def evaluate(kind, origin, x, y, length, radius, piece, s):
    """Evaluate the pieces of a path (lines, arcs, splines) at path parameters s (m,); return points (m, n)
    and their first and second derivatives.
    """
    m, n = len(s), origin.shape[1]
    point, first, second = np.empty((m, n)), np.empty((m, n)), np.empty((m, n))
    for i in range(m):
        p = piece[i]
        a, b, da, db, ea, eb = coefficients(kind[p], length[p], radius[p], s[i])
        for j in range(n):
            point[i, j] = origin[p, j] + a * x[p, j] + b * y[p, j]
            first[i, j] = da * x[p, j] + db * y[p, j]
            second[i, j] = ea * x[p, j] + eb * y[p, j]
    return point, first, second


@njit(cache=True)
def chords(kind, origin, x, y, length, radius, turn, sagitta):
    """Sample points (m, n) along the pieces of a path. Straight lines between these points deviate from the
    path by at most `sagitta` [rad].
    """
    p, n = origin.shape
    count = np.ones(p, np.int64)
    total = 1
    for i in range(p):
        if kind[i] != LINE:
            # A chord of length c differs by at most c^2 / 8 times the largest curvature.
            bend = 1.0 / radius[i] if kind[i] == ARC else 3.0 * np.sin(turn[i] / 2.0) / length[i]
            count[i] = max(int(np.ceil(length[i] * np.sqrt(bend / (8.0 * sagitta)))), 2)
        total += count[i]
    out = np.empty((total, n))
    at = 0
    for i in range(p):
        for c in range(0 if i == 0 else 1, count[i] + 1):
            a, b, _, _, _, _ = coefficients(kind[i], length[i], radius[i], length[i] * c / count[i])
            for j in range(n):
                out[at, j] = origin[i, j] + a * x[i, j] + b * y[i, j]
            at += 1
    return out
