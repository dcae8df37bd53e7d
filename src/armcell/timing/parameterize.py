"""From a path to a trajectory: the fastest one within velocity and acceleration limits."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.core import InputError, JointTrajectory
from armcell.timing.blend import BlendedPath
from armcell.timing.topp import speeds

Array = NDArray[np.float64]

FINE_TIME = 1e-3  # [s] step of the internal sampling
MIN_ARC_INTERVALS = 8
ACCELERATION_SHARE = 0.985
"""Share of the acceleration limit that is planned with: between grid points and between trajectory
points (quintic interpolation) up to 1.2 % more was measured."""


@dataclass(frozen=True)
class TimingSettings:
    """Settings of the time parameterisation."""

    max_deviation: float = 0.05  # [rad] how far corners may be cut
    grid_step: float = 0.01  # [rad] of path length
    min_grid: int = 100  # intervals
    sample_time: float = 0.01  # [s] between trajectory points
    smoothing: float = 0.04  # [s] window of the moving average that rounds acceleration steps


def check_scaling(value: float, what: str) -> float:
    """A velocity or acceleration scaling factor in (0, 1].

    Raises:
        InputError: outside.
    """
    if not np.isfinite(value) or not 0.0 < value <= 1.0:
        raise InputError(f"{what} is {value:g}, it must be in (0, 1]")
    return float(value)


def parameterize(
    path: BlendedPath,
    joint_names: tuple[str, ...],
    velocity: ArrayLike,
    acceleration: ArrayLike,
    settings: TimingSettings = TimingSettings(),
) -> JointTrajectory:
    """The fastest trajectory along a path, at rest at both ends and at the path's sharp corners.

    Args:
        velocity, acceleration: limits (n,) [rad/s], [rad/s^2], already scaled.
    Raises:
        InputError: a limit is not positive and finite.
    """
    velocity, acceleration = np.asarray(velocity, float), np.asarray(acceleration, float)
    for label, limit in (("velocity", velocity), ("acceleration", acceleration)):
        bad = [n for n, v in zip(joint_names, limit, strict=True) if not np.isfinite(v) or v <= 0]
        if bad:
            raise InputError(
                f"joint {bad[0]!r} has no {label} limit", cure="give one in the robot's joint_limits.yaml"
            )
    if not path.pieces:
        return JointTrajectory(joint_names, np.zeros(1), path.points[:1], np.zeros((1, len(joint_names))),
                               np.zeros((1, len(joint_names))))  # fmt: skip
    s, tangent, right, left, stop = _grid(path, settings)
    x = speeds(s, tangent, right, left, stop, velocity, ACCELERATION_SHARE * acceleration)
    return _sampled(path, joint_names, s, x, settings)


def _grid(path: BlendedPath, settings: TimingSettings):
    """Grid points with the derivatives on both sides; piece ends are always grid points."""
    step = min(settings.grid_step, path.length / settings.min_grid)
    index, local, first = [], [], []
    for i, piece in enumerate(path.pieces):
        fewest = MIN_ARC_INTERVALS if np.isfinite(piece.radius) else 2
        count = max(int(np.ceil(piece.length / step)), fewest)
        first.append(len(index))
        index += [i] * (count + 1)
        local += [piece.length * k / count for k in range(count + 1)]
    piece_of, s_local = np.array(index), np.array(local)
    _, tangent, curvature = path.evaluate(piece_of, s_local)
    s = path.starts[piece_of] + s_local
    # Where two pieces meet there are two entries: the left piece's end and the right piece's start.
    joint = np.array(first[1:], dtype=np.int64)
    right = curvature.copy()
    right[joint - 1] = curvature[joint]
    keep = np.ones(len(s), dtype=bool)
    keep[joint] = False
    s, tangent, right, left = s[keep], tangent[keep], right[keep], curvature[keep]
    stop = np.zeros(len(s), dtype=bool)
    for at in path.stops:
        stop[int(np.argmin(np.abs(s - at)))] = True
    return s, tangent, right, left, stop


def _sampled(
    path: BlendedPath, names: tuple[str, ...], s: Array, x: Array, settings: TimingSettings
) -> JointTrajectory:
    """The motion averaged over a short window and sampled.

    The fastest motion switches its acceleration at once. A moving average over `smoothing` seconds keeps
    every velocity and acceleration limit (an average of values within a limit is within it), bounds the
    jerk by 2 a / smoothing, and leaves the path by at most a smoothing^2 / 24.
    """
    v = np.sqrt(x)
    ds = np.diff(s)
    dt = 2 * ds / np.maximum(v[:-1] + v[1:], 1e-9)
    u = (x[1:] - x[:-1]) / (2 * ds)
    t = np.concatenate([[0.0], np.cumsum(dt)])
    half = max(round(settings.smoothing / FINE_TIME / 2), 1)
    steps = int(np.ceil(t[-1] / FINE_TIME)) + 4 * half
    stride = max(round(settings.sample_time / FINE_TIME), 1)
    steps += -steps % stride
    fine = (np.arange(steps + 1) - 2 * half) * FINE_TIME + (t[-1] - (steps - 4 * half) * FINE_TIME) / 2
    inside = np.clip(fine, 0.0, t[-1])
    interval = np.clip(np.searchsorted(t, inside, side="right") - 1, 0, len(dt) - 1)
    tau = inside - t[interval]
    P, D, _ = path.at(
        np.minimum(s[interval] + v[interval] * tau + 0.5 * u[interval] * tau**2, s[interval + 1])
    )
    V = D * (v[interval] + u[interval] * tau)[:, None]
    V[(fine <= 0.0) | (fine >= t[-1])] = 0.0
    window = 2 * half * FINE_TIME
    integral = np.vstack([np.zeros(P.shape[1]), np.cumsum((P[1:] + P[:-1]) / 2, axis=0)]) * FINE_TIME
    at = np.arange(half, len(fine) - half, stride)
    at = at if at[-1] == len(fine) - half - 1 else np.append(at, len(fine) - half - 1)
    positions = (integral[at + half] - integral[at - half]) / window
    velocities = (P[at + half] - P[at - half]) / window
    accelerations = (V[at + half] - V[at - half]) / window
    positions[0], positions[-1] = path.points[0], path.points[-1]
    velocities[0] = velocities[-1] = accelerations[0] = accelerations[-1] = 0.0
    return JointTrajectory(names, (at - at[0]) * FINE_TIME, positions, velocities, accelerations)


def stretched(trajectory: JointTrajectory, factor: float) -> JointTrajectory:
    """The same motion slowed by a factor >= 1.

    Raises:
        InputError: factor below 1 (limits might be broken) or not finite.
    """
    if not np.isfinite(factor) or factor < 1.0:
        raise InputError(f"stretch factor is {factor:g}, it must be at least 1")
    v, a = trajectory.velocities, trajectory.accelerations
    return replace(
        trajectory,
        times=trajectory.times * factor,
        velocities=None if v is None else v / factor,
        accelerations=None if a is None else a / factor**2,
    )


def reversed_in_time(trajectory: JointTrajectory) -> JointTrajectory:
    """The same motion from its end to its start; it keeps every symmetric limit."""
    v, a = trajectory.velocities, trajectory.accelerations
    return replace(
        trajectory,
        times=trajectory.times[-1] - trajectory.times[::-1],
        positions=trajectory.positions[::-1],
        velocities=None if v is None else -v[::-1],
        accelerations=None if a is None else a[::-1],
    )
