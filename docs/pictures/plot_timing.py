"""The picture of docs/timing.md: one path timed three ways. Run: python docs/pictures/plot_timing.py"""

from __future__ import annotations

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from armcell.core import JointTrajectory
from armcell.timing import BlendedPath, TimingSettings, jerk_limited, parameterize
from armcell.timing.parameterize import fastest_motion

JOINTS = ("a", "b")
CORNERS = np.array([[0.0, 0.0], [0.8, 0.1], [0.9, 0.9], [1.6, 1.0]])
VELOCITY, ACCELERATION, JERK = np.array([2.0, 2.0]), np.array([8.0, 8.0]), np.array([150.0, 150.0])
DEVIATION = 0.1


def sharp(path: BlendedPath) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, velocities and accelerations before the smoothing."""
    piece, s, v, u, t = fastest_motion(path, JOINTS, VELOCITY, ACCELERATION, TimingSettings())
    times = np.linspace(0.0, t[-1], 3000)
    k = np.clip(np.searchsorted(t, times, side="right") - 1, 0, len(u) - 1)
    e = times - t[k]
    speed = v[k] + u[k] * e
    _, first, second = path.evaluate(piece[k], s[k] + v[k] * e + u[k] * e**2 / 2)
    return times, first * speed[:, None], first * u[k][:, None] + second * speed[:, None] ** 2


def sampled(trajectory: JointTrajectory) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    times = np.linspace(0.0, trajectory.duration, 3000)
    states = [trajectory.sample(t) for t in times]
    return times, np.array([s[1] for s in states]), np.array([s[2] for s in states])


def main() -> None:
    arcs, splines = BlendedPath(CORNERS, DEVIATION), BlendedPath(CORNERS, DEVIATION, smooth=True)
    curves = {
        "fastest, sharp": sharp(arcs),
        "fastest, smoothed (the default)": sampled(parameterize(arcs, JOINTS, VELOCITY, ACCELERATION)),
        "jerk-limited": sampled(jerk_limited(splines, JOINTS, VELOCITY, ACCELERATION, JERK)),
    }
    figure, axes = plt.subplots(1, 3, figsize=(11, 3.4), width_ratios=[1, 1.4, 1.4])
    axes[0].plot(*CORNERS.T, "o:", color="0.6", label="waypoints")
    for path, color in ((arcs, "C1"), (splines, "C2")):
        points = path.at(np.linspace(0.0, path.length, 800))[0]
        axes[0].plot(*points.T, color=color, label="splines" if path.smooth else "arcs")
    axes[0].set(xlabel="joint a [rad]", ylabel="joint b [rad]", title="the path")
    axes[0].legend(fontsize=8)
    for (label, (times, v, a)), color in zip(curves.items(), ("0.6", "C1", "C2"), strict=True):
        axes[1].plot(times, v[:, 0], color=color, label=f"{label}: {times[-1]:.2f} s")
        axes[2].plot(times, a[:, 0], color=color)
    axes[1].set(xlabel="time [s]", title="velocity of joint a [rad/s]", ylim=(-0.4, 3.1))
    axes[1].axhline(VELOCITY[0], color="C3", lw=0.8)
    axes[1].legend(fontsize=8)
    axes[2].set(xlabel="time [s]", title="acceleration of joint a [rad/s²]")
    for limit in (-ACCELERATION[0], ACCELERATION[0]):
        axes[2].axhline(limit, color="C3", lw=0.8)
    figure.tight_layout()
    figure.savefig(Path(__file__).with_name("timing.png"), dpi=90)


if __name__ == "__main__":
    main()
