"""The 1 kHz setpoints of one Franka arm: smoothing, pace, and rejoining after lost packets."""

from __future__ import annotations

from collections import deque
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

Point = tuple[float, Array, Array]
"""Due time [s, monotonic], positions and velocities, each (7,)."""

TICK = 0.001  # [s]
WINDOW = 12  # [ms] of the moving average, which turns steps of acceleration into bounded jerk
PACE_TIME = 0.5  # [s] in which the pace changes from 0 to 1
REJOIN = 0.15  # [s] in which a deviation from the plan decays
NOISE = 4e-7  # [rad] difference between sent and reported setpoints by float32
INSIDE = 1e-9  # [rad] from a joint limit: rounding must not carry a setpoint beyond it
COAST = 5.0  # [rad/s^2] deceleration after the last streamed point
LATEST = 0.3  # [s] after the last streamed point before the stream ends
GAP = 0.1  # [s] without points in which the arm decelerates instead of following a cubic
MAX_POINTS = 512  # streamed points; 2 s at 4 ms
FOLLOW = 5.0  # [1/s] gain with which the time of streamed points follows the wall time
EVEN = 0.1  # [s] time constant of the rate of that time
CATCH_UP = 0.4  # largest deviation of that rate from 1


class SampledTrajectory:
    """Trajectory for a Franka arm with one setpoint per millisecond, which is streamed at an adjustable pace.

    Args:
        rows: joint positions (n, 7) [rad].
    """

    def __init__(self, rows: Array):
        self._rows, self.clock = rows, 0.0

    @property
    def is_finished(self) -> bool:
        return self.clock >= (len(self._rows) - 1) * TICK

    @property
    def start(self) -> Array:
        return self._rows[0]

    def next(self, pace: float, now: float) -> Array:
        """Advance a streamed Franka trajectory by 1 ms at a given pace (0 to 1),
        and return the positions (7,).
        """
        self.clock = min(self.clock + pace * TICK, (len(self._rows) - 1) * TICK)
        at = self.clock / TICK
        i = min(int(at), len(self._rows) - 2)
        return self._rows[i] + (at - i) * (self._rows[i + 1] - self._rows[i])


class DecayingDeviation:
    """Deviation of the streamed Franka setpoints from the plan, which decays smoothly to zero.

    Args:
        off, rate, change: deviation (7,) [rad] and its first two derivatives.
        duration: duration of the decay [s].
    """

    def __init__(self, off: Array, rate: Array, change: Array, duration: float = REJOIN):
        T = self._duration = duration
        a = -10 * off - 6 * rate * T - 1.5 * change * T**2
        b = 15 * off + 8 * rate * T + 1.5 * change * T**2
        c = -6 * off - 3 * rate * T - 0.5 * change * T**2
        self._coefficients = np.stack([off, rate * T, 0.5 * change * T**2, a, b, c])

    def at(self, t: float) -> Array | None:
        """Return the deviation (7,) [rad] of the streamed Franka setpoints from the planned motion, t seconds
        after the deviation began to decay, or None when it has decayed to zero.
        """
        x = t / self._duration
        return None if x >= 1.0 else np.power(x, np.arange(6)) @ self._coefficients


class TimedSetpoints:
    """Setpoints that are streamed to a Franka arm, each with the time when it is due,
    and interpolated by cubic polynomials.

    The setpoints' time follows the wall time, but at an even rate: states arrive with jitter, which would
    turn into steps of speed.
    """

    clock = 0.0

    def __init__(self) -> None:
        self._points: deque[Point] = deque(maxlen=MAX_POINTS)
        self.is_finished = False
        self._time: float | None = None
        self._rate = 1.0
        self._coast: Point | None = None  # last point, which the arm has passed
        self._away: tuple[float, DecayingDeviation] | None = None

    @property
    def start(self) -> Array:
        return self._points[0][1]

    def add(self, due: float, q: Array, v: Array) -> None:
        """Add a streamed setpoint for a Franka arm: the time [s, monotonic] when it is due,
        and positions and velocities (7,).
        """
        self._points.append((due, q, v))

    def next(self, pace: float, now: float) -> Array:
        """Advance the streamed Franka setpoints to a time [s, monotonic],
        and return the positions (7,) at that time.

        After the last point, the arm decelerates from the point's speed. A point that comes later is joined
        without a jump.
        """
        return self._at(self._follow(now))

    def _follow(self, now: float) -> float:
        if self._time is None:
            self._time = now
        else:
            wanted = 1.0 + float(np.clip(FOLLOW * (now - self._time), -CATCH_UP, CATCH_UP))
            self._rate += (wanted - self._rate) * TICK / EVEN
            self._time += self._rate * TICK
        return self._time

    def _at(self, now: float) -> Array:
        while len(self._points) > 2 and self._points[1][0] <= now:
            self._points.popleft()
        points = list(self._points)
        last, _, v = points[-1]
        self.is_finished = now - last > LATEST + float(np.abs(v).max()) / COAST
        passed = _coasts_from(points, now)
        if passed is not None:
            self._coast = passed
            return _coasted(passed, now)[0] + self._deviation(now)
        position = _between(points, now)
        if self._coast is not None:
            q_coast, v_coast = _coasted(self._coast, now)
            off = q_coast + self._deviation(now) - position
            rate = v_coast + self._deviation_rate(now) - (_between(points, now + TICK) - position) / TICK
            gentle = max(np.sqrt(6 * np.abs(off).max() / COAST), 6 * np.abs(rate).max() / COAST, REJOIN)
            self._away, self._coast = (now, DecayingDeviation(off, rate, np.zeros(7), float(gentle))), None
        return position + self._deviation(now)

    def _deviation(self, now: float) -> Array:
        """Return the deviation (7,) of the streamed Franka setpoints from the plan at a given time.
        The deviation decays to zero.
        """
        off = None if self._away is None else self._away[1].at(now - self._away[0])
        return np.zeros(7) if off is None else off

    def _deviation_rate(self, now: float) -> Array:
        return (self._deviation(now + TICK) - self._deviation(now)) / TICK


def _coasts_from(points: list[Point], now: float) -> Point | None:
    """Return the most recent setpoint of the stream to a Franka arm if no further setpoint follows it within
    `GAP`, so that the arm must decelerate. Otherwise return None.
    """
    passed = [point for point in points if point[0] <= now]
    coming = points[len(passed) :]
    if not passed or (coming and coming[0][0] - passed[-1][0] < GAP):
        return None
    return passed[-1]


def _coasted(point: Point, now: float) -> tuple[Array, Array]:
    """Compute the positions and velocities (7,) of a Franka arm at the time `now`, if the arm decelerates
    from a streamed setpoint because the stream has a gap.
    """
    last, q, v = point
    passed = np.minimum(now - last, np.abs(v) / COAST)
    return q + passed * (v - 0.5 * COAST * np.sign(v) * passed), v - COAST * np.sign(v) * passed


def _between(points: list[Point], now: float) -> Array:
    """Interpolate the joint positions (7,) [rad] at a given time between streamed Franka setpoints. Outside
    their time range, return the positions of the nearest setpoint.
    """
    if now <= points[0][0]:
        return points[0][1]
    for (t0, q0, v0), (t1, q1, v1) in pairwise(points):
        if t0 <= now < t1:
            h, x = t1 - t0, (now - t0) / (t1 - t0)
            low, high = (1 + 2 * x) * (1 - x) ** 2, x * x * (3 - 2 * x)
            return low * q0 + high * q1 + h * x * (1 - x) * ((1 - x) * v0 - x * v1)
    return points[-1][1]


class SetpointStream:
    """Stream of setpoints for a Franka arm, which converts a source
    of positions into one setpoint per millisecond.

    Args:
        source: positions over time.
        pace: initial pace, 0 to 1.
        limits: lowest and highest joint positions (2, 7) [rad] of the setpoints.
    """

    def __init__(
        self, source: SampledTrajectory | TimedSetpoints, pace: float = 1.0, limits: ArrayLike | None = None
    ):
        self.source = source
        self._low, self._high = (-np.inf, np.inf) if limits is None else np.asarray(limits, dtype=float)
        self._pace = pace
        self._window: deque[Array] = deque(maxlen=WINDOW)
        self._plan: deque[Array] = deque(maxlen=3)  # the smoothed plan at the last three milliseconds
        self._sent = np.full(7, np.nan)
        self._away: DecayingDeviation | None = None
        self._since = 0.0
        self._settled = 0

    @property
    def finished(self) -> bool:
        """Return whether the stream of Franka setpoints has reached the end of the motion and is at rest."""
        return self._settled > WINDOW and self._away is None

    def start_error(self, q: Array) -> float:
        """Return the largest difference [rad] between the joint positions q (7,) and the start of the motion
        that will be streamed to the Franka arm.
        """
        return float(np.abs(self.source.start - q).max())

    def next(
        self, ticks: int, wanted_pace: float, now: float, q_d: Array, dq_d: Array, ddq_d: Array
    ) -> Array:
        """Return the next setpoint (7,) [rad] to stream to the Franka arm after the robot has sent a state.

        Args:
            ticks: milliseconds since the last state; above 1 if states were lost.
            q_d, dq_d, ddq_d: setpoint that the robot tracks, from the state.
        """
        if not self._plan:
            self._window.extend([self.source.start] * WINDOW)
            self._plan.extend([self.source.start] * 3)
        for left in range(ticks - 1, 0, -1):
            self._advance(wanted_pace, now - left * TICK)
        if not np.abs(q_d - self._sent).max() <= NOISE:  # also before the first setpoint
            self._rejoin(q_d, dq_d, ddq_d)
        elif ticks > 1:
            self._since += (ticks - 1) * TICK
        self._advance(wanted_pace, now)
        wanted = self._plan[-1] + self._deviation()
        self._sent = np.clip(wanted, self._low + INSIDE, self._high - INSIDE)
        return self._sent

    def _advance(self, wanted_pace: float, now: float) -> None:
        step = TICK / PACE_TIME
        self._pace += min(max(wanted_pace - self._pace, -step), step)
        self._window.append(self.source.next(self._pace, now))
        self._plan.append(np.mean(self._window, axis=0))
        self._settled = self._settled + 1 if self.source.is_finished else 0

    def _rejoin(self, q_d: Array, dq_d: Array, ddq_d: Array) -> None:
        """Lead the streamed Franka setpoints back to the planned motion: their deviation from the plan decays
        with smooth acceleration.
        """
        p0, p1, p2 = self._plan
        off = q_d - p2
        rate = dq_d - (p2 - p1) / TICK
        change = ddq_d - (p2 - 2.0 * p1 + p0) / TICK**2
        self._away = DecayingDeviation(off, rate, change)
        self._since = 0.0

    def _deviation(self) -> Array:
        if self._away is None:
            return np.zeros(7)
        self._since += TICK
        off = self._away.at(self._since)
        if off is None:
            self._away = None
            return np.zeros(7)
        return off
