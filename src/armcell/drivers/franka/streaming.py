"""The 1 kHz setpoints of one Franka arm: smoothing, pace, and rejoining after lost packets."""

from __future__ import annotations

from collections import deque
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

TICK = 0.001  # [s]
WINDOW = 12  # [ms] of the moving average, which turns steps of acceleration into bounded jerk
PACE_TIME = 0.5  # [s] in which the pace changes from 0 to 1
REJOIN = 0.15  # [s] in which a deviation from the plan decays
NOISE = 3e-6  # [rad] difference between sent and reported setpoints by float32
LATEST = 0.3  # [s] after the last streamed point before the stream ends


class Rows:
    """A trajectory in steps of 1 ms, played at a pace.

    Args:
        rows: joint positions (n, 7) [rad].
    """

    def __init__(self, rows: Array):
        self._rows, self.clock = rows, 0.0

    @property
    def ended(self) -> bool:
        return self.clock >= (len(self._rows) - 1) * TICK

    def next(self, pace: float, now: float) -> Array:
        """Advance by 1 ms at a pace (0 to 1); return the positions (7,)."""
        self.clock = min(self.clock + pace * TICK, (len(self._rows) - 1) * TICK)
        at = self.clock / TICK
        i = min(int(at), len(self._rows) - 2)
        return self._rows[i] + (at - i) * (self._rows[i + 1] - self._rows[i])


class Points:
    """Setpoints with due times, interpolated by cubics."""

    clock = 0.0

    def __init__(self) -> None:
        self._points: deque[tuple[float, Array, Array]] = deque(maxlen=64)
        self.ended = False

    def add(self, due: float, q: Array, v: Array) -> None:
        """Add a setpoint: due time [s, monotonic], positions and velocities (7,)."""
        self._points.append((due, q, v))

    def next(self, pace: float, now: float) -> Array:
        """Return the positions (7,) at a time [s, monotonic]; the nearest point's outside the points."""
        points = list(self._points)
        self.ended = now - points[-1][0] > LATEST
        if now <= points[0][0]:
            return points[0][1]
        for (t0, q0, v0), (t1, q1, v1) in pairwise(points):
            if t0 <= now < t1:
                h, x = t1 - t0, (now - t0) / (t1 - t0)
                low, high = (1 + 2 * x) * (1 - x) ** 2, x * x * (3 - 2 * x)
                return low * q0 + high * q1 + h * x * (1 - x) * ((1 - x) * v0 - x * v1)
        return points[-1][1]


class Setpoints:
    """Turns a source of positions into setpoints that the robot accepts, one per millisecond.

    Args:
        source: positions over time.
        pace: initial pace, 0 to 1.
    """

    def __init__(self, source: Rows | Points, pace: float = 1.0):
        self.source = source
        self._pace = pace
        self._window: deque[Array] = deque(maxlen=WINDOW)
        self._plan: deque[Array] = deque(maxlen=3)  # the smoothed plan at the last three milliseconds
        self._sent = np.full(7, np.nan)
        self._away: Array | None = None  # coefficients (6, 7) of the decaying deviation
        self._since = 0.0
        self._started = False
        self._settled = 0

    @property
    def finished(self) -> bool:
        """Whether the source has ended and the setpoints are at rest there."""
        return self._settled > WINDOW and self._away is None

    def start_error(self, q: Array) -> float:
        """Return the distance [rad] of the source's start from positions q (7,)."""
        return float(np.abs(self._first(0.0) - q).max())

    def _first(self, now: float) -> Array:
        if not self._started:
            first = self.source.next(0.0, now)
            self._window.extend([first] * WINDOW)
            self._plan.extend([first] * 3)
            self._started = True
        return self._plan[-1]

    def next(
        self, ticks: int, wanted_pace: float, now: float, q_d: Array, dq_d: Array, ddq_d: Array
    ) -> Array:
        """Return the setpoint (7,) [rad] for the millisecond after a state.

        Args:
            ticks: milliseconds since the last state; above 1 if states were lost.
            q_d, dq_d, ddq_d: setpoint that the robot tracks, from the state.
        """
        self._first(now)
        for left in range(ticks - 1, 0, -1):
            self._advance(wanted_pace, now - left * TICK)
        if not np.abs(q_d - self._sent).max() <= NOISE:  # also before the first setpoint
            self._rejoin(q_d, dq_d, ddq_d)
        elif ticks > 1:
            self._since += (ticks - 1) * TICK
        self._advance(wanted_pace, now)
        self._sent = self._plan[-1] + self._deviation()
        return self._sent

    def _advance(self, wanted_pace: float, now: float) -> None:
        step = TICK / PACE_TIME
        self._pace += min(max(wanted_pace - self._pace, -step), step)
        self._window.append(self.source.next(self._pace, now))
        self._plan.append(np.mean(self._window, axis=0))
        self._settled = self._settled + 1 if self.source.ended else 0

    def _rejoin(self, q_d: Array, dq_d: Array, ddq_d: Array) -> None:
        """Start to decay the robot's deviation from the plan, continuously up to the acceleration."""
        p0, p1, p2 = self._plan
        off = q_d - p2
        rate = dq_d - (p2 - p1) / TICK
        change = ddq_d - (p2 - 2.0 * p1 + p0) / TICK**2
        T = REJOIN
        a = -10 * off - 6 * rate * T - 1.5 * change * T**2
        b = 15 * off + 8 * rate * T + 1.5 * change * T**2
        c = -6 * off - 3 * rate * T - 0.5 * change * T**2
        self._away = np.stack([off, rate * T, 0.5 * change * T**2, a, b, c])
        self._since = 0.0

    def _deviation(self) -> Array:
        if self._away is None:
            return np.zeros(7)
        self._since += TICK
        x = self._since / REJOIN
        if x >= 1.0:
            self._away = None
            return np.zeros(7)
        return np.power(x, np.arange(6)) @ self._away
