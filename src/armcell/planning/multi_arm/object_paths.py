"""Paths of a carried object between poses, and the time law along them."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from armcell.core import SE3, SO3

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

Array = NDArray[np.float64]

KNOT = 0.02  # [s] between points of the trajectory
PEAK_SPEED = 1.875  # peak speed of the quintic from rest to rest, relative to its mean
GRID = 1200  # intervals of a rounded path for computing its speed
SHARED = 0.5  # share of the acceleration limits for bends; the rest is for speed changes
SOFT = 0.2  # [s] window of the two moving averages that round the speed's corners


class ObjectPath(Protocol):
    """Interface (`typing.Protocol`) for the path of a carried object: it returns the object pose at each
    traveled fraction of the path (0 to 1).

    Attributes:
        meters, radians: length and total rotation.
        rate: largest motion per unit of the share [m].
    """

    meters: float
    radians: float
    rate: float

    def poses(self, shares: Array) -> list[SE3]: ...


class StraightObjectPath:
    """Path on which a carried object moves straight and rotates evenly from one pose to another."""

    def __init__(self, a: SE3, b: SE3):
        self.a, self.b = a, b
        self.meters, self.radians = a.distance_to(b)
        self.rate = self.meters

    def poses(self, shares: Array) -> list[SE3]:
        return self.a.interpolated(self.b, shares.tolist())


class RoundedObjectPath:
    """Smooth path of a carried object that passes near given poses and cuts the corners: a uniform cubic
    B-spline.

    The control poses are on the straight pieces. Positions are a B-spline in space, rotations the
    cumulative B-spline (Kim, Kim and Shin, "A general construction scheme for unit quaternion curves with
    simple high order derivatives", SIGGRAPH 1995). Velocity and acceleration are continuous; pieces longer
    than four spacings are straight in the middle.

    Args:
        spacing: distance between control poses [m]; a rotation counts as the motion of a point at the
            distance `radius` [m].
    """

    def __init__(self, through: Sequence[SE3], spacing: float, radius: float):
        self.first, self.last = through[0], through[-1]
        controls = _evenly(through, spacing, radius)
        self.count = len(controls) - 1
        # An added control pose in line before the first and after the last pose makes the spline start and
        # end at these poses, in a straight line.
        x = np.array([T.translation for T in controls])
        self.x = np.vstack([2 * x[0] - x[1], x, 2 * x[-1] - x[-2]])
        turns = [(a.rotation.inverse() @ b.rotation).log() for a, b in pairwise(controls)]
        self.turns = np.array([turns[0], *turns, turns[-1]])  # between neighbors, in the first one's frame
        begin = controls[0].rotation @ SO3.exp(-turns[0])
        self.rotations = [begin, *(T.rotation for T in controls)]
        moved = np.linalg.norm(np.diff(x, axis=0), axis=1)
        self.meters, self.radians = float(moved.sum()), float(np.linalg.norm(turns, axis=1).sum())
        self.rate = float(moved.max()) * self.count  # a B-spline is nowhere faster than its control points

    def poses(self, shares: Array) -> list[SE3]:
        return [self._pose(float(s)) for s in shares]

    def _pose(self, share: float) -> SE3:
        if share <= 0.0 or share >= 1.0:
            return self.first if share <= 0.0 else self.last
        i = min(int(share * self.count), self.count - 1)
        u = share * self.count - i
        late = u**3 / 6
        middle = (1 + 3 * u + 3 * u**2 - 2 * u**3) / 6
        early = (5 + 3 * u - 3 * u**2 + u**3) / 6
        weights = np.array([1 - early, early - middle, middle - late, late])
        rotation = self.rotations[i]
        for share_of, turn in zip((early, middle, late), self.turns[i : i + 3], strict=True):
            rotation = rotation @ SO3.exp(share_of * turn)
        return SE3(rotation, weights @ self.x[i : i + 4])


def length(a: SE3, b: SE3, radius: float) -> float:
    """Return the distance [m] between two poses on the path of an object, including the rotation between
    them.

    A rotation counts as the motion of a point at the distance `radius` [m].
    """
    meters, radians = a.distance_to(b)
    return meters + radius * radians


def _evenly(through: Sequence[SE3], spacing: float, radius: float) -> list[SE3]:
    """Place object poses at even distances on the straight pieces of a carried object's path."""
    ends = np.concatenate([[0.0], np.cumsum([length(a, b, radius) for a, b in pairwise(through)])])
    count = max(int(np.ceil(ends[-1] / spacing)), 3)
    out = []
    for at in np.linspace(0.0, ends[-1], count + 1):
        i = min(int(np.searchsorted(ends, at, side="right")) - 1, len(through) - 2)
        out.append(through[i].interpolate(through[i + 1], float((at - ends[i]) / (ends[i + 1] - ends[i]))))
    return out


def time_law(
    path: Array, way: ObjectPath, velocity: Array, acceleration: Array, max_speed: float
) -> tuple[Array, Array]:
    """Compute the time parameterization (time law) of a carried object's path, within the joint limits and
    the object's speed limit.

    Return times (m,) and shares (m,) of the path. The time law is one quintic from rest to rest; a rounded
    path is slower at its bends.

    Args:
        path: joints (k, n) at even shares of the object path. velocity, acceleration: joint limits (n,).
        max_speed: speed limit of the object [m/s].
    """
    if isinstance(way, RoundedObjectPath):
        return _paced(path, way, velocity, acceleration, max_speed)
    s = np.linspace(0, 1, len(path))
    spline = cubic_spline(s, path)
    first, second = spline(s, 1), spline(s, 2)
    # On the unit clock: rate and bend over time; the path's derivatives at the same shares.
    at, rate, bend = _quintic(np.linspace(0, 1, 201))
    d1 = np.column_stack([np.interp(at, s, c) for c in first.T])
    d2 = np.column_stack([np.interp(at, s, c) for c in second.T])
    speed = np.max(np.abs(d1 * rate[:, None]) / velocity)
    accel = np.max(np.abs(d2 * rate[:, None] ** 2 + d1 * bend[:, None]) / acceleration)
    duration = max(speed, np.sqrt(accel), PEAK_SPEED * way.rate / max_speed, 0.1)
    count = max(int(np.ceil(duration / KNOT)), 5)
    times = np.linspace(0, duration, count + 1)
    return times, _quintic(times / duration)[0]


def _paced(
    path: Array, way: ObjectPath, velocity: Array, acceleration: Array, max_speed: float
) -> tuple[Array, Array]:
    """Compute how fast an object can be carried along a rounded path (time law); the motion slows down at
    bends.

    Bends and speed changes share the acceleration limits. A moving average over time then makes the
    acceleration continuous; the object stays exactly on its path.
    """
    spline = cubic_spline(np.linspace(0, 1, len(path)), path)
    s = np.linspace(0, 1, GRID + 1)
    first, second = np.abs(spline(s, 1)) + 1e-9, np.abs(spline(s, 2)) + 1e-9
    fastest = np.minimum(velocity / first, np.sqrt(SHARED * acceleration / second)).min(axis=1)
    squared = np.minimum(fastest, max_speed / max(way.rate, 1e-9)) ** 2  # of the share's rate [1/s^2]
    squared[0] = squared[-1] = 0.0
    change = ((1 - SHARED) * acceleration / first).min(axis=1)
    gain = 2 / GRID * np.minimum(change[:-1], change[1:])
    for i in range(GRID):
        squared[i + 1] = min(squared[i + 1], squared[i] + gain[i])
    for i in range(GRID - 1, -1, -1):
        squared[i] = min(squared[i], squared[i + 1] + gain[i])
    rate = np.sqrt(squared)
    clock = np.concatenate([[0.0], np.cumsum(2 / GRID / (rate[:-1] + rate[1:]))])
    fine, half = KNOT / 10, round(SOFT / KNOT * 5)  # points; half a window
    even = np.arange(-2 * half, int(np.ceil(clock[-1] / fine / 10)) * 10 + 2 * half + 1) * fine
    share = np.interp(even, clock, s)
    for _ in range(2):
        sums = np.cumsum(np.concatenate([np.zeros(half + 1), share, np.ones(half)]))
        share = (sums[2 * half + 1 :] - sums[: -2 * half - 1]) / (2 * half + 1)
    share = share[::10].clip(0.0, 1.0)
    share[0], share[-1] = 0.0, 1.0
    times: Array = np.arange(len(share), dtype=np.float64) * KNOT
    return times, share


def _quintic(x: Array) -> tuple[Array, Array, Array]:
    """Evaluate the quintic time law of an object path, which rises from 0 to 1 and starts and ends at rest.
    Return its value and its first and second derivatives.
    """
    return (
        x**3 * (10 - 15 * x + 6 * x**2),
        30 * x**2 * (1 - x) ** 2,
        60 * x * (1 - x) * (1 - 2 * x),
    )


def cubic_spline(x: Array, y: Array, **options: Any) -> CubicSpline:
    """Return SciPy's cubic spline through points (m, n) of an object path."""
    from scipy.interpolate import CubicSpline  # a third of a second, which other plans need not wait for

    return CubicSpline(x, y, **options)


def derivatives(times: Array, q: Array) -> tuple[Array, Array]:
    """Compute the velocities and accelerations of the spline through the joint positions (m, n) along an
    object path.
    """
    spline = cubic_spline(times, q, bc_type="clamped")
    v, a = spline(times, 1), spline(times, 2)
    v[0] = v[-1] = a[0] = a[-1] = 0.0
    return v, a
