"""How far a real arm may be from its twin: bands learned from motions during which nothing was wrong.

By arm and joint: position, velocity and motor current, each by what is left after the twin's prediction; by
arm the mass on the flange that explains the currents best, and the network's round trip. An arm is a little
behind its clock or before it (`lag`), and its currents are the twin's torques times a factor, plus friction,
dry and viscous: all fitted. Currents ripple, so their deviation is the mean of the last looks; payloads stay.
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

from armcell.control.twin.load import explaining
from armcell.control.twin.rehearsal import Rehearsal
from armcell.core import InputError

Array = NDArray[np.float64]

FORMAT = 2
WIDER, WIDER_VELOCITY, WIDER_CURRENT, WIDER_LOAD = 1.6, 2.0, 2.5, 2.0
LEAST_POSITION, LEAST_VELOCITY, LEAST_SHARE = 0.004, 0.05, 0.06
"""[rad], [rad/s], of the largest current: bands are no narrower."""
LEAST_LOAD, LEAST_SPREAD = 0.7, 0.015
"""[kg] that the load's band is at least; of the largest current: a joint's spread counts as no less."""
LATER = 0.015  # [s] that a round trip may take longer than ever in clean motions
LEAST_SAMPLES = 200
LASTING = 3  # looks in a row outside a band until something is done
SMOOTHED = 25  # looks that a current's deviation is the mean of, and a load is reckoned from
FEWEST = 10  # looks that a load is reckoned from as a motion begins
EXPLAINED = 0.75  # of the currents' squared deviation, by a load that is claimed
SLOWED = 0.3  # of the acceleration's largest effort that a slowed arm's may be wrong by
SETTLED = 0.15  # [s] of a motion after which its speeds and currents count: they jump as it starts
LAGS = (-0.05, 0.2)  # [s] between which the lag is
CURRENT_LAGS = tuple(k * 0.004 for k in range(-10, 16))  # [s] that are tried
LATE_TRIED = np.linspace(-1.0, 1.0, 9)  # shares of `Seen.late`
LEAST_EFFORT, TOLD_APART = 10.0, 0.006
"""[Nm] below which a joint's efforts tell little of its factor; of the largest singular value: what tells the
parts of the currents apart less than that (a wrist's torque is almost all viscous) is not used."""
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
    late: float = 0.0  # [s] by which the clock may be wrong, either way


@dataclass(frozen=True, eq=False)
class ArmBands:
    """Of one arm; arrays by joint."""

    lag: float  # [s]
    position: Array  # [rad]
    velocity: Array  # [rad/s]
    current_lag: float  # [s]
    gain: Array  # [A/Nm] current per torque of the twin
    friction: Array  # [A]
    viscous: Array  # [A s/rad]
    offset: Array  # [A]
    current: Array  # [A]; infinite where the robot tells no current
    spread: Array  # [A] of what is left of single looks' currents
    load: float  # [kg]; infinite where the robot tells no current
    trip: float  # [s]
    samples: int

    def current_of(self, effort: Array, velocity: Array) -> Array:
        """Motor currents (n,) [A] that the twin leads to expect."""
        rubbing = self.friction * np.tanh(velocity / CREEP) + self.viscous * velocity
        return self.gain * effort + rubbing + self.offset

    def deviations(
        self, seen: Seen, twin: Rehearsal, columns: Sequence[int], currents: deque[Array]
    ) -> dict[str, Array]:
        """By kind, each joint's deviation in units of its band (n,); above 1 is outside. `timing` and `load`
        are (1,), a load is negative where the arm carries less than its model says.

        Args:
            columns: the arm's joints in the twin.
            currents: (2, n) of the last looks of this motion, how far currents were off [A] and what a
                kilogram adds [A/kg]; one is added.
        """
        at = list(columns)
        clocks = (
            seen.clock
            - self.lag * seen.scaling
            + seen.late * np.array([0.0] if seen.late == 0.0 else LATE_TRIED)
        )
        rows = [twin.at(clock) for clock in clocks]
        k = int(np.argmin([np.max(np.abs(seen.q - q[at]) / self.position) for q, *_ in rows]))
        q, v, _ = (row[at] for row in rows[k])
        found = {
            "position": np.abs(seen.q - q) / self.position,
            "timing": np.array([0.0 if np.isnan(seen.trip) else seen.trip / self.trip]),
        }
        if not seen.steady or seen.clock < SETTLED:  # speeds and currents are behind the scaling that is told
            return found
        found["velocity"] = np.abs(seen.v - v * seen.scaling) / self.velocity
        if np.isfinite(self.current).all():
            effort, kilo = (
                row[at] for row in twin.efforts_at(seen.clock - self.current_lag * seen.scaling, seen.scaling)
            )
            off = seen.current - self.current_of(effort, v * seen.scaling)
            currents.append(np.stack([off, self.gain * kilo]))
            # Slower than planned, acceleration takes less; of what is held, and of rotors, that is not known.
            swing = np.abs(twin.demand.swing[:, at]).max(axis=0)
            found |= self._of_currents(currents, (1.0 - seen.scaling**2) * SLOWED * np.abs(self.gain) * swing)
        return found

    def _of_currents(self, looks: Sequence[Array], doubt: Array) -> dict[str, Array]:
        """Kinds `current` and `load`, as far as the looks suffice. Expected currents: in doubt (n,) [A]."""
        found: dict[str, Array] = {}
        if len(looks) == SMOOTHED:
            wrong = np.abs(np.mean(looks, axis=0)[0]) - doubt
            found["current"] = np.maximum(wrong, 0.0) / self.current
        if len(looks) >= FEWEST:
            off, kilo = np.array(looks).swapaxes(0, 1)
            load = explaining(off, kilo, self.spread)
            doubted = explaining(np.broadcast_to(doubt, off.shape), np.abs(kilo), self.spread)
            mean, left = (np.sum((np.mean(x, axis=0) / self.spread) ** 2) for x in (off, off - load * kilo))
            explained = left <= (1.0 - EXPLAINED) * mean  # else it is a touch, a brake, anything
            sure = np.sign(load) * max(abs(load) - doubted, 0.0) if explained else 0.0
            found["load"] = np.array([sure / self.load])
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
                raise InputError(
                    f"is of format {data['format']}, this armcell reads {FORMAT}", file=file,
                    cure="learn them anew: armcell twin CELL",
                )  # fmt: skip
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
    shifted = [twin.at(seen.clock - lag * seen.scaling) for twin, _, seen in rows]
    q, v = (np.array([p[k][c] for (_, c, _), p in zip(rows, shifted)]) for k in range(2))
    scaling = np.array([[seen.scaling] for *_, seen in rows])
    lengths = [len(looks) for *_, looks in motions]
    position = _largest_lasting(np.array([seen.q for *_, seen in rows]) - q, lengths)
    velocity = _largest_lasting(np.array([seen.v for *_, seen in rows]) - v * scaling, lengths)
    current = np.array([seen.current for *_, seen in rows])
    under_way = np.array([seen.clock >= SETTLED for *_, seen in rows])
    late = [(twin, c, seen) for twin, c, seen in rows if seen.clock >= SETTLED]

    def fitted(current_lag: float) -> tuple[Array, Array, Array]:
        rows = [twin.efforts_at(s.clock - current_lag * s.scaling, s.scaling) for twin, _, s in late]
        effort, kilo = (np.array([row[k][c] for row, (_, c, _) in zip(rows, late)]) for k in range(2))
        return *_fitted(current[under_way], effort, (v * scaling)[under_way]), kilo

    current_lag = min(CURRENT_LAGS, key=lambda each: float(np.sum(fitted(each)[1] ** 2)))
    (gain, friction, viscous, offset), left, kilo = fitted(current_lag)
    counts = [sum(s.clock >= SETTLED for s in looks) for *_, looks in motions]
    smooth = _largest_mean(left, counts)
    most = np.abs(current).max(axis=0)
    told = bool(most.max() > 1e-6)
    spread = np.maximum(np.sqrt(np.mean(left**2, axis=0)), LEAST_SPREAD * most.max() if told else 1.0)
    load = _largest_load(left, gain * kilo, spread, counts)
    trips = np.array([seen.trip for *_, seen in rows])
    trip = float(np.nanmax(trips)) if not np.isnan(trips).all() else 0.0
    return ArmBands(
        lag,
        np.maximum(WIDER * position, LEAST_POSITION),
        np.maximum(WIDER_VELOCITY * velocity, LEAST_VELOCITY),
        current_lag,
        gain,
        friction,
        viscous,
        offset,
        np.maximum(WIDER_CURRENT * smooth, LEAST_SHARE * most.max()) if told else np.full(len(most), np.inf),
        spread,
        max(WIDER_LOAD * load, LEAST_LOAD) if told else np.inf,
        trip + LATER,
        len(rows),
    )


def _fitted(current: Array, effort: Array, speed: Array) -> tuple[Array, Array]:
    """Factor, dry and viscous friction, offset of each joint (4, n); what is left of every look (k, n)."""
    n = current.shape[1]
    out, left = np.zeros((4, n)), np.zeros_like(current)
    for i in range(n):
        u, unit = speed[:, i], max(float(np.abs(effort[:, i]).max()), LEAST_EFFORT)
        A = np.column_stack([effort[:, i] / unit, np.tanh(u / CREEP), u, np.ones(len(effort))])
        x, *_ = np.linalg.lstsq(A, current[:, i], rcond=TOLD_APART)
        out[:, i], left[:, i] = x, current[:, i] - A @ x
        out[0, i] /= unit
    return out, left


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


def _largest_load(left: Array, kilo: Array, spread: Array, lengths: Sequence[int]) -> float:
    """Largest mass [kg] that explains SMOOTHED looks in a row within a motion, or the first of it."""
    largest, first = 0.0, 0
    for length in lengths:
        for end in range(first + FEWEST, first + length + 1):
            window = slice(max(first, end - SMOOTHED), end)
            largest = max(largest, abs(explaining(left[window], kilo[window], spread)))
        first += length
    return largest
