"""Moving averages of motions over a time window: smoothing, samples and their peak values (Numba).

Piecewise linear motions: the average keeps every speed limit. Its acceleration is the change of speed
over the window, divided by the window, so a long enough window keeps every acceleration limit. At a
corner, the average deviates from the pieces by at most window * (change of speed) / 8. Between its
points the average is exactly quadratic, so cubic interpolation is exact.

The fastest motion along a path switches its acceleration abruptly. A moving average over a window w
keeps every velocity and acceleration limit (an average of values within a limit is within it), bounds
the jerk by 2 a / w and deviates from the path by at most a w^2 / 24. The averaged motion is longer by
w.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from armcell.core import InputError, JointTrajectory
from armcell.timing.path_pieces import LINE, coefficients

Array = NDArray[np.float64]

SAME = 1e-7  # [s] times with a smaller difference count as equal
GROWTH = 1.15
GAUSS = np.sqrt(0.6)  # nodes and weights of Gauss-Legendre quadrature with three points


def smooth_by_moving_average(
    joint_names: tuple[str, ...], times: ArrayLike, points: ArrayLike, acceleration: ArrayLike,
    longest: float = 4.0,
) -> JointTrajectory:  # fmt: skip
    """Smooth a piecewise linear motion by a moving average, and return it as a trajectory within the
    acceleration limits.

    The trajectory is as fast as the given motion and takes one averaging window longer. Its time 0 is half a
    window before the start of the given motion.

    Args:
        joint_names: names of the n joints.
        times, points: (k,) increasing times [s] and (k, n) positions of the given motion.
        acceleration: (n,) limits [rad/s^2].
        longest: maximum length of the window [s].
    Raises:
        InputError: no window up to `longest` keeps the limits, because the given motion is too fast.
    """
    t, p = np.asarray(times, dtype=float), np.asarray(points, dtype=float)
    limit = np.asarray(acceleration, dtype=float)
    t = t - t[0]
    speeds = np.diff(p, axis=0) / np.diff(t)[:, None] if len(t) > 1 else np.zeros((0, p.shape[1]))
    window = max(float(np.max(np.abs(speeds) / limit, initial=0.0)), 0.01)
    while window <= longest:
        found = _averaged(t, p, speeds, window)
        change = np.abs(np.diff(found[2], axis=0)) / np.maximum(np.diff(found[0])[:, None], 1e-12)
        if np.all(change <= limit * (1 + 1e-9)):
            return JointTrajectory(joint_names, found[0], found[1], found[2])
        window *= GROWTH
    raise InputError(f"no window up to {longest:g} s keeps the acceleration limits")


def _averaged(t: Array, p: Array, speeds: Array, window: float) -> tuple[Array, Array, Array]:
    knots = np.unique(np.concatenate([t, t + window]))
    knots = knots[np.concatenate([[True], np.diff(knots) > SAME])]
    area = np.concatenate(
        [np.zeros((1, p.shape[1])), np.cumsum((p[1:] + p[:-1]) / 2 * np.diff(t)[:, None], axis=0)]
    )

    def integral(x: Array) -> Array:
        """Return the integral of a piecewise linear motion from time 0 to `x`; a moving average is the
        difference of two such integrals.
        """
        k = np.clip(np.searchsorted(t, x, side="right") - 1, 0, len(t) - 1)
        e = np.clip(x, t[0], t[-1]) - t[k]
        v = speeds[np.minimum(k, len(speeds) - 1)] if len(speeds) else np.zeros((len(x), p.shape[1]))
        inside = area[k] + p[k] * e[:, None] + v * (e**2)[:, None] / 2
        outside = np.where((x < t[0])[:, None], p[0], p[-1]) * (x - np.clip(x, t[0], t[-1]))[:, None]
        return inside + outside

    def position(x: Array) -> Array:
        return np.column_stack([np.interp(x, t, column) for column in p.T])

    q = (integral(knots) - integral(knots - window)) / window
    v = (position(knots) - position(knots - window)) / window
    q[0], q[-1] = p[0], p[-1]
    v[0] = v[-1] = 0.0
    return knots, q, v


@njit(cache=True)
def _motion_at(times, pieces, motion):
    """Sample a motion at given times, as the input of moving averages. Return three arrays (m, n): the time
    integral of the position, the position, and the velocity.

    The times increase. Positions are relative to the first point, and the integral begins at time 0. The
    motion is at rest before its start and after its end.
    """
    kind, origin, x, y, length, radius = pieces
    piece, s0, v0, u, t0 = motion
    m, n, last = len(times), origin.shape[1], len(piece) - 1
    area, position, velocity = np.zeros((m, n)), np.zeros((m, n)), np.zeros((m, n))
    a0, b0, _, _, _, _ = coefficients(kind[0], length[0], radius[0], 0.0)
    first, total = np.empty(n), np.zeros(n)
    for i in range(n):
        first[i] = origin[0, i] + a0 * x[0, i] + b0 * y[0, i]
    t, k = 0.0, 0
    for j in range(m):
        if times[j] <= 0.0:
            continue
        until = min(times[j], t0[last + 1])
        while True:
            p, stop = piece[k], min(until, t0[k + 1])
            if stop > t:
                e, h = t - t0[k], stop - t
                f = e + h
                a = b = 0.0
                if kind[p] == LINE:
                    a = h * (s0[k] + v0[k] * (e + f) / 2.0 + u[k] * (e * e + e * f + f * f) / 6.0)
                else:
                    for node in range(3):
                        g = (e + f + (node - 1) * GAUSS * h) / 2.0
                        at = s0[k] + g * (v0[k] + g * u[k] / 2.0)
                        ca, cb, _, _, _, _ = coefficients(kind[p], length[p], radius[p], at)
                        weight = h * (8.0 if node == 1 else 5.0) / 18.0
                        a += weight * ca
                        b += weight * cb
                for i in range(n):
                    total[i] += h * (origin[p, i] - first[i]) + a * x[p, i] + b * y[p, i]
                t = stop
            if k == last or t0[k + 1] > until:
                break
            k += 1
        e = until - t0[k]
        at, v = s0[k] + e * (v0[k] + e * u[k] / 2.0), v0[k] + e * u[k]
        over = times[j] - until
        if over > 0.0:
            v = 0.0
        p = piece[k]
        a, b, da, db, _, _ = coefficients(kind[p], length[p], radius[p], at)
        for i in range(n):
            position[j, i] = origin[p, i] - first[i] + a * x[p, i] + b * y[p, i]
            velocity[j, i] = v * (da * x[p, i] + db * y[p, i])
            area[j, i] = total[i] + over * position[j, i]
    return area, position, velocity


@njit(cache=True)
def _difference(now, then, shift, factor):
    """Compute a moving average in place from the integrals `now` and `then` at the two ends of the window.
    Each now[i] becomes (now[i] - then[i - shift]) * `factor`.

    `then` is zero before its first row and may be the same array as `now`.
    """
    for i in range(len(now) - 1, shift - 1, -1):
        now[i] = (now[i] - then[i - shift]) * factor
    for i in range(min(shift, len(now))):
        now[i] *= factor


@njit(cache=True)
def sample_moving_average(start, goal, pieces, motion, step, window):
    """Sample a motion after smoothing by a moving average over `window` [s]; return a point every `step` [s].

    The last interval is 0.5 to 1.5 steps long.

    Args:
        start, goal: first and last point (n,) of the path.
        pieces: arrays of the path's pieces, see `BlendedPath.arrays`.
        motion: intervals of constant path acceleration, see `topp.fastest`.
    Returns:
        Times (k,), positions, velocities and accelerations (k, n).
    """
    n = len(start)
    total = motion[4][-1] + window
    k = max(round(total / step), 1) + 1
    times, earlier = np.empty(k), np.empty(k)
    for j in range(k):
        times[j] = total if j == k - 1 else j * step
        earlier[j] = times[j] - window
    q, v, a = _motion_at(times, pieces, motion)
    shift = round(window / step)
    then_q, then_v, then_a = q, v, a
    if abs(shift * step - window) > 1e-9:  # else the window's other end is an earlier point
        shift = 0
        then_q, then_v, then_a = _motion_at(earlier, pieces, motion)
    # Integral, position and velocity become position, velocity and acceleration, the last points first.
    _difference(q.ravel(), then_q.ravel(), shift * n, 1.0 / window)
    _difference(v.ravel(), then_v.ravel(), shift * n, 1.0 / window)
    _difference(a.ravel(), then_a.ravel(), shift * n, 1.0 / window)
    for j in range(1, k - 1):
        for c in range(n):
            q[j, c] += start[c]
    for c in range(n):
        q[0, c], q[k - 1, c] = start[c], goal[c]
        v[0, c] = v[k - 1, c] = a[0, c] = a[k - 1, c] = 0.0
    return times, q, v, a


@njit(cache=True)
def _largest_cubic(b0, b1, b2, b3):
    """Return the largest absolute value of a cubic in Bernstein form on [0, 1]. It bounds the peaks of a
    motion smoothed by a moving average.
    """
    best = max(abs(b0), abs(b3))
    d0, d1, d2 = b1 - b0, b2 - b1, b3 - b2  # its derivative / 3
    p, r = d0 - 2.0 * d1 + d2, d1 - d0  # p t^2 + 2 r t + d0 = 0
    inside = r * r - p * d0
    if inside < 0.0:
        return best
    w = -(r + np.copysign(np.sqrt(inside), r))
    for top, bottom in ((w, p), (d0, w)):
        if bottom != 0.0:
            t = top / bottom
            if 0.0 < t < 1.0:
                s = 1.0 - t
                at = s * s * s * b0 + 3.0 * s * t * (s * b1 + t * b2) + t * t * t * b3
                best = max(best, abs(at))
    return best


@njit(cache=True)
def peaks(times, q, v, a, velocity, acceleration):
    """Return the peaks of a motion smoothed by a moving average: the largest ratios |velocity| / limit and
    |acceleration| / limit.

    The ratios hold at any time of the quintic interpolation.

    The Bernstein coefficients of each interval's velocity (degree 4) and acceleration (degree 3) enclose
    the values. If coefficients exceed a limit, velocities are bounded more tightly, and the maximum of the
    acceleration is computed exactly.
    """
    peak_v = peak_a = 0.0
    per_v, per_a = 1.0 / velocity, 1.0 / acceleration
    for j in range(len(times) - 1):
        h = times[j + 1] - times[j]
        five_h, four_h = 5.0 / h, 4.0 / h
        for c in range(q.shape[1]):
            v0, v1, a0, a1 = v[j, c], v[j + 1, c], a[j, c], a[j + 1, c]
            b1, b3 = v0 + h * a0 / 4, v1 - h * a1 / 4
            b2 = five_h * (q[j + 1, c] - q[j, c]) - 2 * (v0 + v1) + h * (a1 - a0) / 4
            worst = max(abs(v0), abs(b1), abs(b2), abs(b3), abs(v1)) * per_v[c]
            if worst > peak_v:
                if worst > 1.0:  # halved once
                    m0, m1, m2, m3 = (v0 + b1) / 2, (b1 + b2) / 2, (b2 + b3) / 2, (b3 + v1) / 2
                    n0, n1, n2 = (m0 + m1) / 2, (m1 + m2) / 2, (m2 + m3) / 2
                    worst = max(abs(v0), abs(m0), abs(n0), abs(n1), abs(n2), abs(m3), abs(v1)) * per_v[c]
                peak_v = max(peak_v, worst)
            c1, c2 = four_h * (b2 - b1), four_h * (b3 - b2)
            worst = max(abs(a0), abs(c1), abs(c2), abs(a1)) * per_a[c]
            if worst > peak_a:
                if worst > 1.0:
                    worst = _largest_cubic(a0, c1, c2, a1) * per_a[c]
                peak_a = max(peak_a, worst)
    return peak_v, peak_a
