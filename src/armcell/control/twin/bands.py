"""How far a real arm may be from its twin: bands learned from motions during which nothing was wrong.

By arm and joint: position, velocity and motor current, each by what is left after the twin's prediction; and
the network's round trip. An arm is a little behind its clock or before it (`lag`), and its currents are the
twin's torques times a factor, plus friction: both are fitted. Currents ripple, so their deviation is the mean
of the last looks; a payload stays.
"""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armcell.control.twin.rehearsal import Rehearsal
from armcell.core import InputError

Array = NDArray[np.float64]

FORMAT = 1
WIDER, WIDER_CURRENT = 1.6, 2.5  # times the largest deviation of clean motions
LEAST_POSITION, LEAST_VELOCITY, LEAST_SHARE = 0.004, 0.04, 0.03
"""[rad], [rad/s], of the largest current: bands are no narrower."""
LATER = 0.015  # [s] that a round trip may take longer than ever in clean motions
LEAST_SAMPLES = 200
LASTING = 3  # looks in a row outside a band until something is done
SMOOTHED = 25  # looks that a current's deviation is the mean of
SETTLED = 0.15  # [s] of a motion after which its currents count: they jump as it starts
LAGS = (-0.05, 0.2)  # [s] between which the lag is
CURRENT_LAGS = tuple(k * 0.004 for k in range(-10, 16))  # [s] that are tried
CREEP = 0.02  # [rad/s] at which a joint's Coulomb friction has come to most of its size


@dataclass(frozen=True, eq=False)
class Seen:
    """One look at a moving arm."""

    clock: float  # [s] along the trajectory
    scaling: float  # 0 to 1, of the speed
    q: Array  # (n,) [rad]
    v: Array  # (n,) [rad/s]
    current: Array  # (n,) [A]
    trip: float  # [s] shortest round trip of the last moments; NaN where not known
    steady: bool = True  # the speed's scaling is not changing


@dataclass(frozen=True, eq=False)
class ArmBands:
    """Of one arm; arrays by joint."""

    lag: float  # [s]
    position: Array  # [rad]
    velocity: Array  # [rad/s]
    current_lag: float  # [s]
    gain: Array  # [A/Nm] current per torque of the twin
    friction: Array  # [A]
    offset: Array  # [A]
    current: Array  # [A]; infinite where the robot tells no current
    trip: float  # [s]
    samples: int

    def current_of(self, effort: Array, velocity: Array) -> Array:
        """Motor currents (n,) [A] that the twin leads to expect."""
        return self.gain * effort + self.friction * np.tanh(velocity / CREEP) + self.offset

    def deviations(
        self, seen: Seen, twin: Rehearsal, columns: Sequence[int], currents: deque[Array]
    ) -> dict[str, Array]:
        """By kind, each joint's deviation in units of its band (n,); above 1 is outside. `timing` is (1,).

        Args:
            columns: the arm's joints in the twin.
            currents: the last looks' current deviations, of this motion; one is added.
        """
        at = list(columns)
        q, v, _ = (row[at] for row in twin.at(seen.clock - self.lag))
        found = {
            "position": np.abs(seen.q - q) / self.position,
            "timing": np.array([0.0 if np.isnan(seen.trip) else seen.trip / self.trip]),
        }
        if not seen.steady:  # speed and currents are behind the scaling that is told
            return found
        found["velocity"] = np.abs(seen.v - v * seen.scaling) / self.velocity
        if np.isfinite(self.current).all():
            # Slower than planned the inertia's share is smaller, by at most what the motion has of it.
            share = (1.0 - seen.scaling**2) * np.abs(self.gain) * np.ptp(twin.efforts[:, at], axis=0) / 2
            if seen.clock >= SETTLED:
                effort = twin.at(seen.clock - self.current_lag)[2][at]
                currents.append(seen.current - self.current_of(effort, v * seen.scaling))
            if len(currents) == SMOOTHED:
                wrong = np.abs(np.mean(currents, axis=0)) - share
                found["current"] = np.maximum(wrong, 0.0) / self.current
        return found


@dataclass(frozen=True, eq=False)
class TwinBands:
    """Of all arms of a cell, and of what they were learned on: other identities make them void."""

    arms: Mapping[str, ArmBands]
    identity: Mapping[str, str]  # by what it is of: robot, physics, real, calibration of each arm

    def save(self, file: Path) -> None:
        """
        Raises:
            InputError: it cannot be written.
        """
        arms = {
            name: {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in asdict(arm).items()}
            for name, arm in self.arms.items()
        }
        data = {"format": FORMAT, "identity": dict(self.identity), "arms": arms}
        try:
            file.write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")
        except OSError as error:
            raise InputError(f"cannot be written: {error.strerror}", file=file) from None

    @staticmethod
    def load(file: Path) -> TwinBands:
        """
        Raises:
            InputError: no such file, or not of this armcell.
        """
        try:
            data = json.loads(file.read_text(encoding="utf-8"))
            if data["format"] != FORMAT:
                raise InputError(f"is of format {data['format']}, this armcell reads {FORMAT}", file=file)
            arms = {name: _arm_of(entry) for name, entry in data["arms"].items()}
            return TwinBands(arms, dict(data["identity"]))
        except InputError:
            raise
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            raise InputError(
                f"holds no twin's bands ({type(error).__name__})", file=file, cure="armcell twin CELL"
            ) from None


def _arm_of(entry: dict[str, Any]) -> ArmBands:
    values: dict[str, Any] = {k: np.array(v, float) if isinstance(v, list) else v for k, v in entry.items()}
    return ArmBands(**values)


def learned(motions: Sequence[tuple[Rehearsal, Sequence[int], Sequence[Seen]]]) -> ArmBands:
    """Bands of one arm.

    Args:
        motions: each with its twin, the arm's columns in it, and what was seen.
    Raises:
        InputError: too little was seen.
    """
    rows = [(twin, list(columns), seen) for twin, columns, looks in motions for seen in looks]
    if len(rows) < LEAST_SAMPLES:
        raise InputError(
            f"only {len(rows)} looks at a moving arm, {LEAST_SAMPLES} are needed", cure="more --motions"
        )
    predicted = [twin.at(seen.clock) for twin, _, seen in rows]
    error = np.array([seen.q - p[0][c] for (_, c, seen), p in zip(rows, predicted)])
    speed = np.array([p[1][c] for (_, c, _), p in zip(rows, predicted)])
    lag = float(np.clip(-np.sum(error * speed) / max(np.sum(speed**2), 1e-9), *LAGS))
    shifted = [twin.at(seen.clock - lag) for twin, _, seen in rows]
    q, v = (np.array([p[k][c] for (_, c, _), p in zip(rows, shifted)]) for k in range(2))
    scaling = np.array([[seen.scaling] for *_, seen in rows])
    lengths = [len(looks) for *_, looks in motions]
    position = _largest_lasting(np.array([seen.q for *_, seen in rows]) - q, lengths)
    velocity = _largest_lasting(np.array([seen.v for *_, seen in rows]) - v * scaling, lengths)
    current = np.array([seen.current for *_, seen in rows])
    under_way = np.array([seen.clock >= SETTLED for *_, seen in rows])
    late = [(twin, c, seen.clock) for twin, c, seen in rows if seen.clock >= SETTLED]

    def fitted(current_lag: float) -> tuple[Array, Array, Array, Array]:
        effort = np.array([twin.at(t - current_lag)[2][c] for twin, c, t in late])
        return _fitted(current[under_way], effort, (v * scaling)[under_way])

    current_lag = min(CURRENT_LAGS, key=lambda each: float(np.sum(fitted(each)[3] ** 2)))
    gain, friction, offset, left = fitted(current_lag)
    smooth = _largest_mean(left, [sum(s.clock >= SETTLED for s in looks) for *_, looks in motions])
    most = np.abs(current).max(axis=0)
    told = bool(most.max() > 1e-6)
    trips = np.array([seen.trip for *_, seen in rows])
    trip = float(np.nanmax(trips)) if not np.isnan(trips).all() else 0.0
    return ArmBands(
        lag,
        np.maximum(WIDER * position, LEAST_POSITION),
        np.maximum(WIDER * velocity, LEAST_VELOCITY),
        current_lag,
        gain,
        friction,
        offset,
        np.maximum(WIDER_CURRENT * smooth, LEAST_SHARE * most.max()) if told else np.full(len(most), np.inf),
        trip + LATER,
        len(rows),
    )


def _fitted(current: Array, effort: Array, speed: Array) -> tuple[Array, Array, Array, Array]:
    """Factor, friction and offset of each joint (n,), and what is left of every look (k, n)."""
    n = current.shape[1]
    out, left = np.zeros((3, n)), np.zeros_like(current)
    for i in range(n):
        A = np.column_stack([effort[:, i], np.tanh(speed[:, i] / CREEP), np.ones(len(effort))])
        x, *_ = np.linalg.lstsq(A, current[:, i], rcond=1e-6)
        out[:, i], left[:, i] = x, current[:, i] - A @ x
    return out[0], out[1], out[2], left


def _largest_lasting(left: Array, lengths: Sequence[int]) -> Array:
    """Largest size that LASTING looks in a row of a motion all had, (n,): one alone slows nothing."""
    largest, first = np.zeros(left.shape[1]), 0
    for length in lengths:
        sizes = np.abs(left[first : first + length])
        if length >= LASTING:
            windows = np.lib.stride_tricks.sliding_window_view(sizes, LASTING, axis=0)
            largest = np.maximum(largest, windows.min(axis=-1).max(axis=0))
        first += length
    return largest


def _largest_mean(left: Array, lengths: Sequence[int]) -> Array:
    """Largest mean of SMOOTHED looks in a row within a motion, (n,)."""
    largest, first = np.zeros(left.shape[1]), 0
    for length in lengths:
        sums = np.cumsum(np.vstack([np.zeros(left.shape[1]), left[first : first + length]]), axis=0)
        if length >= SMOOTHED:
            means = (sums[SMOOTHED:] - sums[:-SMOOTHED]) / SMOOTHED
            largest = np.maximum(largest, np.abs(means).max(axis=0))
        first += length
    return largest
