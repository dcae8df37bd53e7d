"""Jerk-limited timing of a path without deviation from the path (Numba).

Corners are splines with continuous curvature (`BlendedPath(..., smooth=True)`). The motion passes them at
a constant speed, at which velocity, acceleration and jerk of every joint have closed forms. On the lines
between corners, the path speed changes by ramps of bounded acceleration and jerk (the double-S profile;
Biagiotti and Melchiorri, "Trajectory Planning for Automatic Machines and Robots", section 3.4). Between
two points of the trajectory each joint therefore moves by a polynomial of degree four at most, which the
quintic interpolation reproduces exactly: the limits hold at all times, and the motion keeps the path up to
rounding.

For straight moves the result is the fastest jerk-limited motion, which tests check against ruckig. In
general it is not: the problem is not convex, and no solver finds the exact optimum. Ruckig itself plans
from state to state: joints leave the path, and its community edition sends waypoints to a server.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from armcell.core import InputError, JointTrajectory
from armcell.timing.blend import BlendedPath
from armcell.timing.moving_average import peaks
from armcell.timing.parameterize import TimingSettings, checked_limits, zero_length_trajectory
from armcell.timing.path_pieces import LINE, coefficients

Array = NDArray[np.float64]

MIN_PHASE = 1e-3
"""[s] Minimum duration of a ramp's phases and of cruising on a line. In shorter phases the jerk, a third
difference of positions, loses its precision."""

MIN_GAP = 2e-4  # [s] between trajectory points
EPS = 1e-12


@njit(cache=True)
def _ramp(dv, a, j):
    """Compute the timing of a jerk-limited speed change dv >= 0: how long the acceleration changes, and how
    long it is constant.

    Both durations increase with dv. If a phase would be shorter than MIN_PHASE, the ramp becomes gentler.
    """
    if dv <= 0.0:
        return 0.0, 0.0
    if dv <= a * a / j:
        return max(np.sqrt(dv / j), MIN_PHASE), 0.0
    flat = dv / a - a / j
    if flat >= MIN_PHASE:
        return a / j, flat
    return (np.sqrt(MIN_PHASE**2 + 4.0 * dv / j) - MIN_PHASE) / 2.0, MIN_PHASE


@njit(cache=True)
def _distance(v0, v1, a, j):
    change, flat = _ramp(abs(v1 - v0), a, j)
    return (v0 + v1) / 2.0 * (2.0 * change + flat)


@njit(cache=True)
def _fastest(v0, v1, a, j, length, most):
    """Return the highest speed that a jerk-limited motion can reach on a line of the given length, on which
    it accelerates from v0 and slows down to v1. The result is at least max(v0, v1) and at most `most`.

    If v1 < 0, the line may end at the highest speed.
    """
    low, high = max(v0, v1), most
    v = most
    for _ in range(60):
        end = v if v1 < 0.0 else v1
        if _distance(v0, v, a, j) + _distance(v, end, a, j) + v * MIN_PHASE <= length:
            low = v
        else:
            high = v
        v = (low + high) / 2.0
    return low


@njit(cache=True)
def _ramp_phases(piece, s, v0, v1, a, j, at, out):
    """Append the phases of a jerk-limited speed change to `out`. Return the number of phases in `out`, and
    the path parameter s at the end of the speed change.

    The up to three phases are (piece, s, v, a, jerk, duration).
    """
    change, flat = _ramp(abs(v1 - v0), a, j)
    if change == 0.0:
        return at, s
    jerk = (v1 - v0) / (change * (change + flat))
    v, acc = v0, 0.0
    for phase in range(3):
        t = flat if phase == 1 else change
        k = 0.0 if phase == 1 else jerk if phase == 0 else -jerk
        if t == 0.0:
            continue
        if phase == 2:
            acc = jerk * change
        out[at, 0], out[at, 1], out[at, 2], out[at, 3], out[at, 4], out[at, 5] = piece, s, v, acc, k, t
        s += t * (v + t * (acc / 2.0 + t * k / 6.0))
        v += t * (acc + t * k / 2.0)
        acc += t * k
        at += 1
    return at, s


@njit(cache=True)
def phases(kind, x, y, length, rests, velocity, acceleration, jerk):
    """Compute the phases of constant jerk in a jerk-limited motion along a path. Return an array (k, 6) with
    one row per phase.

    The columns are piece, path parameter in the piece, speed, acceleration, jerk and duration.
    """
    m, n = x.shape
    most, acc, jer = np.full(m, 1e18), np.full(m, 1e18), np.full(m, 1e18)
    for p in range(m):
        for k in range(n):
            if kind[p] == LINE:
                d = max(abs(x[p, k]), EPS)
                most[p] = min(most[p], velocity[k] / d)
                acc[p] = min(acc[p], acceleration[k] / d)
                jer[p] = min(jer[p], jerk[k] / d)
            else:  # constant speed v: |q'| v, |q''| v^2 and |q'''| v^3 at their largest
                d, c = max(abs(x[p, k]), abs(y[p, k]), EPS), max(abs(y[p, k] - x[p, k]), EPS)
                most[p] = min(most[p], velocity[k] / d, np.sqrt(acceleration[k] * length[p] / (1.5 * c)))
                most[p] = min(most[p], np.cbrt(jerk[k] * length[p] ** 2 / (6.0 * c)))
        jer[p] = min(jer[p], acc[p] / MIN_PHASE)
    # Speed at the joints between pieces: constant in a corner, variable on a line.
    speed = np.full(m + 1, 1e18)
    speed[0] = speed[m] = 0.0
    for p in range(m):
        speed[p], speed[p + 1] = min(speed[p], most[p]), min(speed[p + 1], most[p])
        if rests[p]:
            speed[p + 1] = 0.0
    for p in range(m - 1, -1, -1):
        if kind[p] != LINE:
            speed[p] = min(speed[p], speed[p + 1])
        elif speed[p] > speed[p + 1]:
            speed[p] = _fastest(speed[p + 1], -1.0, acc[p], jer[p], length[p], speed[p])
    for p in range(m):
        if kind[p] != LINE:
            speed[p + 1] = min(speed[p], speed[p + 1])
        elif speed[p + 1] > speed[p]:
            speed[p + 1] = _fastest(speed[p], -1.0, acc[p], jer[p], length[p], speed[p + 1])
    out, at = np.empty((7 * m, 6)), 0
    for p in range(m):
        v0, v1 = speed[p], speed[p + 1]
        s, peak = 0.0, v0
        if kind[p] == LINE:
            peak = _fastest(v0, v1, acc[p], jer[p], length[p], most[p])
            at, s = _ramp_phases(p, 0.0, v0, peak, acc[p], jer[p], at, out)
        left = length[p] - s - (_distance(peak, v1, acc[p], jer[p]) if kind[p] == LINE else 0.0)
        out[at, 0], out[at, 1], out[at, 2], out[at, 3], out[at, 4], out[at, 5] = (
            p, s, peak, 0.0, 0.0, left / peak,
        )  # fmt: skip
        at += 1
        if kind[p] == LINE:
            at, s = _ramp_phases(p, s + left, peak, v1, acc[p], jer[p], at, out)
    return out[:at]


@njit(cache=True)
def states(times, begins, phase, kind, origin, x, y, length, radius):
    """Return the positions, velocities and accelerations (m, n) of a jerk-limited motion at times (m,)."""
    m, n = len(times), x.shape[1]
    q, dq, ddq = np.empty((m, n)), np.empty((m, n)), np.empty((m, n))
    k = 0
    for i in range(m):
        while k < len(begins) - 1 and begins[k + 1] <= times[i]:
            k += 1
        p, s, v, a, j = int(phase[k, 0]), phase[k, 1], phase[k, 2], phase[k, 3], phase[k, 4]
        t = times[i] - begins[k]
        s, v, a = s + t * (v + t * (a / 2.0 + t * j / 6.0)), v + t * (a + t * j / 2.0), a + t * j
        ca, cb, da, db, ea, eb = coefficients(kind[p], length[p], radius[p], s)
        for c in range(n):
            q[i, c] = origin[p, c] + ca * x[p, c] + cb * y[p, c]
            first, second = da * x[p, c] + db * y[p, c], ea * x[p, c] + eb * y[p, c]
            dq[i, c], ddq[i, c] = v * first, a * first + v * v * second
    return q, dq, ddq


def jerk_limited(
    path: BlendedPath,
    joint_names: tuple[str, ...],
    velocity: ArrayLike,
    acceleration: ArrayLike,
    jerk: ArrayLike,
    settings: TimingSettings = TimingSettings(),
) -> JointTrajectory:
    """Return a jerk-limited trajectory that follows a path exactly. It keeps the limits of velocity,
    acceleration and jerk.

    The path must have smooth corners. The trajectory has points at the changes of the path jerk and, between
    them, every `settings.sample_time`.

    Args:
        velocity, acceleration, jerk: limits (n,) [rad/s], [rad/s^2], [rad/s^3], already scaled.
    Raises:
        InputError: a limit is not positive and finite; the path has arcs, whose curvature jumps.
    """
    velocity = checked_limits(velocity, "velocity", joint_names)
    acceleration = checked_limits(acceleration, "acceleration", joint_names)
    jerk = checked_limits(jerk, "jerk", joint_names)
    if path.length == 0.0:
        return zero_length_trajectory(path, joint_names)
    if np.isfinite(path.radius).any():
        raise InputError(
            "the path's corners are arcs, on whose ends the jerk has no bound",
            hint="make it with BlendedPath(..., smooth=True)",
        )
    phase = phases(path.kind, path.x, path.y, path.lengths, path.rests, velocity, acceleration, jerk)
    begins = np.concatenate([[0.0], np.cumsum(phase[:, 5])])
    times = _times(begins, settings.sample_time)
    q, v, a = states(times, begins[:-1], phase, *path.arrays)
    q[0], q[-1] = path.points[0], path.points[-1]
    v[0] = v[-1] = a[0] = a[-1] = 0.0
    peak_v, peak_a = peaks(times, q, v, a, velocity, acceleration)
    over = max(peak_v, np.sqrt(peak_a), np.cbrt(_largest_jerk(times, q, v, a, jerk)))
    if over > 1.0:  # rounding, and errors of phases shorter than MIN_GAP
        times, v, a = times * over, v / over, a / over**2
    return JointTrajectory(joint_names, times, q, v, a)


def _times(begins: Array, step: float) -> Array:
    """Return the time stamps for a jerk-limited trajectory: the starts of its phases and a regular grid, at
    least MIN_GAP apart.
    """
    end = begins[-1]
    knots = begins[np.concatenate([[True], np.diff(begins) >= MIN_GAP])]
    knots = np.append(knots[knots <= end - MIN_GAP], end)
    grid = np.arange(step, end, step)
    after = np.searchsorted(knots, grid)
    far = np.minimum(knots[after] - grid, grid - knots[after - 1]) >= step / 4
    return np.sort(np.concatenate([knots, grid[far]]))


def _largest_jerk(times: Array, q: Array, v: Array, a: Array, jerk: Array) -> float:
    """Return the largest ratio of a joint's jerk to its jerk limit in a trajectory with quintic
    interpolation.

    The ratio is computed at the ends of each interval and at the maximum between them.
    """
    h = np.diff(times)[:, None]
    d = np.diff(q, axis=0)
    v0, v1, a0, a1 = v[:-1], v[1:], a[:-1], a[1:]
    middle = 5 * d / h - 2 * (v0 + v1) + h * (a1 - a0) / 4  # of the velocity's Bernstein coefficients
    b1, b2 = 4 / h * (middle - v0 - h * a0 / 4), 4 / h * (v1 - h * a1 / 4 - middle)  # the acceleration's
    return float(np.max(np.abs(np.stack([b1 - a0, b2 - b1, a1 - b2]) * 3 / h) / jerk))
