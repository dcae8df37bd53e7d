"""Residual thresholds of a digital twin, learned from motions without faults.

The thresholds ("bands") apply by arm and joint to position, velocity and motor current, each as the residual
after the twin's prediction, and by arm to the flange mass that explains the currents best and to the network
round trip. The fit includes each arm's time offset from its clock (`lag`). It models currents as a factor
times the twin's torques plus Coulomb and viscous friction. Because currents ripple, their residual is a mean
over the last samples, in which a payload error persists.
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

from armcell.core import InputError
from armcell.core.checks import float_array
from armcell.twin.dry_run import DryRun, estimate_load

Array = NDArray[np.float64]

FORMAT = 2
WIDER, WIDER_VELOCITY, WIDER_CURRENT, WIDER_LOAD = 1.6, 2.0, 2.5, 2.0
LEAST_POSITION, LEAST_VELOCITY, LEAST_SHARE = 0.004, 0.05, 0.06
"""Lower limits of the bands: [rad], [rad/s], and a fraction of the largest current."""
LEAST_LOAD, LEAST_SPREAD = 0.7, 0.015
"""Lower limits: load band [kg], and a joint's current spread as a fraction of the largest current."""
LATER = 0.015  # [s] margin over the longest round trip of fault-free motions
LEAST_SAMPLES = 200
LASTING = 3  # consecutive samples outside a band before the guard reacts
SMOOTHED = 25  # samples in the mean current residual and in the load estimate
FEWEST = 10  # samples in the load estimate at the start of a motion
EXPLAINED = 0.75  # fraction of the squared current residual that a reported load must explain
SLOWED = 0.3  # uncertainty of a slowed arm's effort, as a fraction of the largest acceleration effort
SETTLED = 0.15  # [s] after the start of a motion: speeds and currents jump before
LAGS = (-0.05, 0.2)  # [s] limits of the lag
CURRENT_LAGS = tuple(k * 0.004 for k in range(-10, 16))  # [s] candidates
LATE_TRIED = np.linspace(-1.0, 1.0, 9)  # candidate clock errors, as fractions of `Seen.late`
LEAST_EFFORT, TOLD_APART = 10.0, 0.006
"""Limits of the current fit: the smallest effort [Nm] by which a joint's samples are scaled, and the relative
singular-value cutoff of the least squares (a wrist's torque is almost entirely viscous)."""
CREEP = 0.02  # [rad/s] at which Coulomb friction reaches 76 % of its final value (tanh)


@dataclass(frozen=True, eq=False)
class TwinSample:
    """Measured sample of a moving real arm, from which residual thresholds are learned: joint positions,
    velocities and motor currents at one time of the trajectory.
    """

    clock: float  # [s] time on the trajectory
    scaling: float  # speed fraction, 0 to 1
    q: Array  # (n,) [rad]
    v: Array  # (n,) [rad/s]
    current: Array  # (n,) [A]
    trip: float  # [s] shortest recent network round trip; NaN if unknown
    steady: bool = True  # the speed scaling is constant
    late: float = 0.0  # [s] largest error of the clock, in both directions


@dataclass(frozen=True, eq=False)
class ArmResidualThresholds:
    """Thresholds for the residuals between one real arm and its simulated twin, for each joint, and the
    fitted model that predicts the arm's motor currents.
    """

    lag: float  # [s]
    position: Array  # [rad]
    velocity: Array  # [rad/s]
    current_lag: float  # [s]
    gain: Array  # [A/Nm] current per simulated torque
    friction: Array  # [A]
    viscous: Array  # [A s/rad]
    offset: Array  # [A]
    current: Array  # [A]; infinite if the robot reports no current
    spread: Array  # [A] standard deviation of the current residual of single samples
    load: float  # [kg]; infinite if the robot reports no current
    trip: float  # [s]
    samples: int

    def current_of(self, effort: Array, velocity: Array) -> Array:
        """Predict the motor currents (n,) [A] of a real arm, for the current residuals, from the joint
        torques and velocities of its simulated twin.

        Args:
            effort: simulated joint torques (n,) [Nm].
            velocity: joint velocities (n,) [rad/s].
        Raises:
            InputError: wrong shape, or not finite.
        """
        effort = float_array(effort, self.gain.shape, "effort")
        velocity = float_array(velocity, self.gain.shape, "velocity")
        rubbing = self.friction * np.tanh(velocity / CREEP) + self.viscous * velocity
        return self.gain * effort + rubbing + self.offset

    def residuals(
        self, seen: TwinSample, twin: DryRun, columns: Sequence[int], currents: deque[Array]
    ) -> dict[str, Array]:
        """Return the residuals between an arm and its simulated twin, by kind such as "position". Each
        residual is divided by its threshold: a value above 1 is a violation.

        `timing` and `load` have shape (1,); a negative load means that the arm carries less than the model
        says.

        Args:
            seen: measured sample.
            columns: indices of the arm's joints in the twin.
            currents: last samples of this motion, each (2, n): current residual [A], and current per
                additional kilogram [A/kg]. The method appends one sample.
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
        if not seen.steady or seen.clock < SETTLED:  # speeds and currents lag behind the reported scaling
            return found
        found["velocity"] = np.abs(seen.v - v * seen.scaling) / self.velocity
        if np.isfinite(self.current).all():
            effort, kilo = (
                row[at] for row in twin.efforts_at(seen.clock - self.current_lag * seen.scaling, seen.scaling)
            )
            off = seen.current - self.current_of(effort, v * seen.scaling)
            currents.append(np.stack([off, self.gain * kilo]))
            # At reduced speed, acceleration needs less torque; for held objects and rotors the model
            # does not know by how much.
            swing = np.abs(twin.demand.swing[:, at]).max(axis=0)
            found |= self._of_currents(currents, (1.0 - seen.scaling**2) * SLOWED * np.abs(self.gain) * swing)
        return found

    def _of_currents(self, looks: Sequence[Array], doubt: Array) -> dict[str, Array]:
        """Divide the residuals of a real arm's motor currents and load by their residual thresholds, and
        return the quotients. Residuals without enough samples are omitted.

        Args:
            looks: recent samples (2, n) of current residual [A] and current per kilogram [A/kg].
            doubt: uncertainty of the predicted currents (n,) [A].
        """
        found: dict[str, Array] = {}
        if len(looks) == SMOOTHED:
            wrong = np.abs(np.mean(looks, axis=0)[0]) - doubt
            found["current"] = np.maximum(wrong, 0.0) / self.current
        if len(looks) >= FEWEST:
            off, kilo = np.array(looks).swapaxes(0, 1)
            load = estimate_load(off, kilo, self.spread)
            doubted = estimate_load(np.broadcast_to(doubt, off.shape), np.abs(kilo), self.spread)
            mean, left = (np.sum((np.mean(x, axis=0) / self.spread) ** 2) for x in (off, off - load * kilo))
            explained = left <= (1.0 - EXPLAINED) * mean  # else a contact, a brake or another cause
            sure = np.sign(load) * max(abs(load) - doubted, 0.0) if explained else 0.0
            found["load"] = np.array([sure / self.load])
        return found


@dataclass(frozen=True, eq=False)
class ResidualThresholds:
    """Residual thresholds for comparing all real arms of a cell with the simulated twin. They are valid only
    for the recorded robot, physics and calibration.
    """

    arms: Mapping[str, ArmResidualThresholds]
    identity: Mapping[str, str]  # keys: robot, physics, real, calibration of each arm

    def save(self, file: Path) -> None:
        """Write the residual thresholds of a cell's real arms and their simulated twin to a JSON file.

        Raises:
            InputError: the file cannot be written.
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
    def load(file: Path) -> ResidualThresholds:
        """Read the residual thresholds of a cell's real arms and their simulated twin from a JSON file.

        Raises:
            InputError: the file does not exist, or its format is not the current one.
        """
        try:
            data = json.loads(file.read_text(encoding="utf-8"))
            if data["format"] != FORMAT:
                raise InputError(
                    f"is of format {data['format']}, this armcell reads {FORMAT}", file=file,
                    hint="learn them again: armcell twin CELL",
                )  # fmt: skip
            arms = {name: _arm_of(entry) for name, entry in data["arms"].items()}
            return ResidualThresholds(arms, dict(data["identity"]))
        except InputError:
            raise
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            raise InputError(
                f"holds no twin's bands ({type(error).__name__})", file=file, hint="armcell twin CELL"
            ) from None


def _arm_of(entry: dict[str, Any]) -> ArmResidualThresholds:
    values: dict[str, Any] = {k: np.array(v, float) if isinstance(v, list) else v for k, v in entry.items()}
    return ArmResidualThresholds(**values)


def fit_thresholds(
    motions: Sequence[tuple[DryRun, Sequence[int], Sequence[TwinSample]]],
) -> ArmResidualThresholds:
    """Learn the residual thresholds for comparing one real arm with its simulated twin, from samples of
    motions without faults.

    Args:
        motions: for each motion its dry run, the arm's columns in the dry run, and the measured samples.
    Raises:
        InputError: there are fewer than `LEAST_SAMPLES` samples.
    """
    rows = [(twin, list(columns), seen) for twin, columns, looks in motions for seen in looks]
    if len(rows) < LEAST_SAMPLES:
        raise InputError(
            f"only {len(rows)} looks at a moving arm, {LEAST_SAMPLES} are needed", hint="more --motions"
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
    known = bool(most.max() > 1e-6)
    spread = np.maximum(np.sqrt(np.mean(left**2, axis=0)), LEAST_SPREAD * most.max() if known else 1.0)
    load = _largest_load(left, gain * kilo, spread, counts)
    trips = np.array([seen.trip for *_, seen in rows])
    trip = float(np.nanmax(trips)) if not np.isnan(trips).all() else 0.0
    return ArmResidualThresholds(
        lag,
        np.maximum(WIDER * position, LEAST_POSITION),
        np.maximum(WIDER_VELOCITY * velocity, LEAST_VELOCITY),
        current_lag,
        gain,
        friction,
        viscous,
        offset,
        np.maximum(WIDER_CURRENT * smooth, LEAST_SHARE * most.max()) if known else np.full(len(most), np.inf),
        spread,
        max(WIDER_LOAD * load, LEAST_LOAD) if known else np.inf,
        trip + LATER,
        len(rows),
    )


def _fitted(current: Array, effort: Array, speed: Array) -> tuple[Array, Array]:
    """Fit a linear model of the motor current to the samples of each joint by least squares. The residual of
    the current is the difference between a real arm's current and this model's prediction.

    Args:
        current, effort, speed: samples (k, n) in [A], [Nm], [rad/s].
    Returns:
        Parameters (4, n): torque factor, Coulomb friction, viscous friction, offset; residuals (k, n) [A].
    """
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
    """Return for each joint the largest residual (n,) that persists for `LASTING` consecutive samples of a
    motion. Thresholds for comparing an arm with its twin are derived from it.

    A shorter peak does not count, because it would not slow the arm either.
    """
    largest, first = np.zeros(left.shape[1]), 0
    for length in lengths:
        sizes = np.abs(left[first : first + length])
        if length >= LASTING:
            windows = np.lib.stride_tricks.sliding_window_view(sizes, LASTING, axis=0)
            largest = np.maximum(largest, windows.min(axis=-1).max(axis=0))
        first += length
    return largest


def _largest_mean(left: Array, lengths: Sequence[int]) -> Array:
    """Return the largest magnitude (n,) of each joint's mean residual over `SMOOTHED` consecutive samples of
    a motion. The current thresholds for comparing an arm with its twin are derived from it.
    """
    largest, first = np.zeros(left.shape[1]), 0
    for length in lengths:
        sums = np.cumsum(np.vstack([np.zeros(left.shape[1]), left[first : first + length]]), axis=0)
        if length >= SMOOTHED:
            means = (sums[SMOOTHED:] - sums[:-SMOOTHED]) / SMOOTHED
            largest = np.maximum(largest, np.abs(means).max(axis=0))
        first += length
    return largest


def _largest_load(left: Array, kilo: Array, spread: Array, lengths: Sequence[int]) -> float:
    """Estimate the additional mass at the flange [kg] in each time window from the residuals of the motor
    currents, and return the largest magnitude of this mass over all windows.

    The load threshold for the comparison of an arm with its twin is derived from the result.
    A window contains the last SMOOTHED samples; at the start of a motion, at least FEWEST.
    """
    largest, first = 0.0, 0
    for length in lengths:
        for end in range(first + FEWEST, first + length + 1):
            window = slice(max(first, end - SMOOTHED), end)
            largest = max(largest, abs(estimate_load(left[window], kilo[window], spread)))
        first += length
    return largest
