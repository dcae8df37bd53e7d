"""`armcell bench timing`: speed, result and limit violations of time parameterization."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import typer
from numpy.typing import NDArray
from rich.progress import track
from rich.table import Table

from armcell.cli.console import check_writable, console, errors, write_json
from armcell.core import InputError, JointTrajectory, MissingExtraError

Array = NDArray[np.float64]

PEER_POINTS = 500  # grid points for toppra
REPEAT = 3  # runs per path; the fastest run counts
FINE = 1e-3  # [s] sampling period of the limit check


def timing(
    robot: str = typer.Option(..., metavar="NAME", help="A library name, a robot folder or a URDF."),
    group: str = typer.Option("", help="Planning group; by default the longest chain."),
    waypoints: int = typer.Option(20, min=2, help="Waypoints of each path."),
    count: int = typer.Option(200, min=1, help="Number of random paths."),
    step: float = typer.Option(
        0.15, min=1e-6, help="Spread of each joint's step from waypoint to waypoint [rad or m]."
    ),
    deviation: float = typer.Option(0.05, min=0.0, help="How far a corner may be cut [rad]."),
    keep: str = typer.Option(
        "acceleration",
        help="Limits to keep besides velocity: acceleration, torque (and acceleration), or jerk (and both).",
    ),
    seed: int = typer.Option(0, help="Of the random paths."),
    peer: bool = typer.Option(
        False, "--peer", help=f"Time toppra on the same curves, with {PEER_POINTS} grid points."
    ),
    json_file: Path | None = typer.Option(
        None, "--json", metavar="OUT", help="Write one row per path as JSON."
    ),
) -> int:
    """Benchmark the timing of random paths: CPU time,
    durations compared with those of toppra, and violated limits.

    A path is a random walk of the group's joints with rounded corners. `us` is CPU time of one thread from
    waypoints to trajectory (compiled code, best of three). `of limit` is the largest velocity, acceleration
    or torque along the interpolated trajectory, sampled every millisecond; 1.000 is the limit itself.

    With --peer, toppra gets the same curve and limits. `/ toppra` is the ratio of the durations; `unsmoothed`
    is the ratio without the window of the moving average that smooths armcell's accelerations (toppra does
    not smooth).

    Example: armcell bench timing --robot panda --peer --json timing.json

    Exit status 1 if a limit was broken.
    """
    if json_file is not None:
        check_writable(json_file)
    rows = _rows(robot, group, waypoints, count, step, deviation, keep, seed, peer)
    _show(rows)
    if json_file is not None:
        write_json(json_file, rows)
    return 0 if all(row["worst_of_limit"] <= 1.0 + 1e-6 for row in rows) else 1


def _rows(robot: str, group: str, waypoints: int, count: int, step: float, deviation: float, keep: str,
          seed: int, peer: bool) -> list[dict[str, Any]]:  # fmt: skip
    from armcell.kinematics import InverseDynamics
    from armcell.model import load_robot
    from armcell.timing import BlendedPath, TimingSettings, jerk_limited, parameterize

    if keep not in ("acceleration", "torque", "jerk"):
        raise InputError(f"--keep is {keep!r}, it must be acceleration, torque or jerk")
    model = load_robot(robot)
    if not group and not model.groups:
        raise InputError(f"robot {robot!r} has no planning group")
    chains = [g for g in model.groups.values() if g.tip_link is not None] or list(model.groups.values())
    name = group or max(chains, key=lambda g: len(g.joint_names)).name
    names = model.group(name).joint_names
    columns = model.columns(names)
    velocity, acceleration, jerk = (model.limits(names, k) for k in ("velocity", "acceleration", "jerk"))
    dynamics = InverseDynamics(model, names) if keep == "torque" else None
    settings = TimingSettings(max_deviation=deviation)

    def run(points: Array) -> tuple[BlendedPath, JointTrajectory]:
        path = BlendedPath(points, deviation, smooth=keep == "jerk")
        if keep == "jerk":
            return path, jerk_limited(path, names, velocity, acceleration, jerk, settings)
        return path, parameterize(path, names, velocity, acceleration, settings, dynamics)

    reference = _toppra(velocity, acceleration, dynamics) if peer else None
    rng, rows = np.random.default_rng(seed), []
    home, low, high = model.default_positions()[columns], model.lower[columns], model.upper[columns]
    run(np.vstack([home, home + step, home]))  # compiles, or loads from the cache
    for index in track(
        range(count), "timing", console=errors, disable=not errors.is_terminal, transient=True
    ):
        walk = np.vstack([home, rng.normal(0.0, step, (waypoints - 1, len(names)))])
        points = np.clip(np.cumsum(walk, axis=0), low, high)
        best, (path, trajectory) = _cpu(lambda points=points: run(points))
        window = 0.0 if keep == "jerk" else settings.smoothing
        row: dict[str, Any] = {
            "index": index,
            "waypoints": waypoints,
            "length": path.length,
            "timing_us": best,
            "duration_s": trajectory.duration,
            "smoothing_s": window,
            **_met(trajectory, velocity, acceleration, jerk if keep == "jerk" else None, dynamics),
        }
        if reference is not None:
            row["peer_us"], row["peer_duration_s"] = _cpu(lambda path=path: reference(path))
            other = row["peer_duration_s"]  # None if toppra failed
            row["of_peer"] = trajectory.duration / other if other else None
            row["unsmoothed_of_peer"] = (trajectory.duration - window) / other if other else None
        rows.append(row)
    return rows


def _cpu(function: Callable[[], Any]) -> tuple[float, Any]:
    """Return the least CPU time [us] that a function of the timing
    benchmark takes over several calls, and its last result.
    """
    best, result = np.inf, None
    for _ in range(REPEAT):
        began = time.thread_time()
        result = function()
        best = min(best, time.thread_time() - began)
    return best * 1e6, result


def _met(trajectory: JointTrajectory, velocity: Array, acceleration: Array, jerk: Array | None,
         dynamics: Any) -> dict[str, float]:  # fmt: skip
    """Return the peak velocity, acceleration, jerk and torque of an interpolated trajectory as fractions of
    their limits, for the timing benchmark.
    """
    from scipy.interpolate import BPoly

    t = trajectory
    assert t.velocities is not None and t.accelerations is not None
    curve = BPoly.from_derivatives(t.times, np.stack([t.positions, t.velocities, t.accelerations], axis=1))
    at = np.linspace(0.0, t.duration, max(int(t.duration / FINE), 2))
    q, v, a = curve(at), curve(at, 1), curve(at, 2)
    met = {
        "velocity_of_limit": float(np.max(np.abs(v) / velocity)),
        "acceleration_of_limit": float(np.max(np.abs(a) / acceleration)),
    }
    if jerk is not None:
        met["jerk_of_limit"] = float(np.max(np.abs(curve(at, 3)) / jerk))
    if dynamics is not None:
        met["torque_of_limit"] = float(np.max(np.abs(dynamics.torques(q, v, a)) / dynamics.limits))
    return {**met, "worst_of_limit": max(met.values())}


def _toppra(velocity: Array, acceleration: Array, dynamics: Any) -> Callable[[Any], float | None]:
    """Return a function for the timing benchmark that computes toppra's duration [s] for a `BlendedPath`.

    The function returns None if toppra fails.
    """
    try:
        import toppra
        from toppra import algorithm, constraint
        from toppra.interpolator import AbstractGeometricPath
    except ImportError:
        raise MissingExtraError("toppra", "dev") from None
    toppra.setup_logging("ERROR")

    class Curve(AbstractGeometricPath):
        """Path in the form that toppra requires, for the timing benchmark. It evaluates a `BlendedPath`."""

        def __init__(self, path: Any):
            self.path = path

        dof = property(lambda self: self.path.points.shape[1])
        path_interval = property(lambda self: np.array([0.0, self.path.length]))
        waypoints = property(lambda self: (np.array([0.0, self.path.length]), None))

        def __call__(self, s: Any, order: int = 0) -> Array:
            value = self.path.at(s)[order]
            return value if np.ndim(s) else value[0]

    scheme = constraint.DiscretizationType.Interpolation
    limits = [
        constraint.JointVelocityConstraint(np.c_[-velocity, velocity]),
        constraint.JointAccelerationConstraint(
            np.c_[-acceleration, acceleration], discretization_scheme=scheme
        ),
    ]
    if dynamics is not None:
        bound = np.c_[-dynamics.limits, dynamics.limits]
        inverse = lambda q, v, a: dynamics.torques(q, v, a)[0]  # noqa: E731
        none = np.zeros(len(velocity))
        limits.append(constraint.JointTorqueConstraint(inverse, bound, none, discretization_scheme=scheme))

    def duration(path: Any) -> float | None:
        grid = np.unique(np.concatenate([np.linspace(0.0, path.length, PEER_POINTS), path.starts]))
        grid = grid[np.concatenate([[True], np.diff(grid) > 1e-9])]
        grid[-1] = path.length
        solver = algorithm.TOPPRA(limits, Curve(path), gridpoints=grid, solver_wrapper="seidel")
        speed = solver.compute_parameterization(0.0, 0.0)[1]
        return None if speed is None else float(np.sum(2 * np.diff(grid) / (speed[1:] + speed[:-1])))

    return duration


def _show(rows: list[dict[str, Any]]) -> None:
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("")
    titles = {
        "us": "timing_us", "duration s": "duration_s", "velocity of limit": "velocity_of_limit",
        "acceleration": "acceleration_of_limit", "jerk": "jerk_of_limit", "torque": "torque_of_limit",
        "toppra us": "peer_us", "/ toppra": "of_peer", "unsmoothed": "unsmoothed_of_peer",
    }  # fmt: skip
    shown = {title: key for title, key in titles.items() if key in rows[0]}
    for title in shown:
        table.add_column(title, justify="right")
    for label, pick in (
        ("median", np.median),
        ("p95", lambda values: np.percentile(values, 95)),
        ("largest", np.max),
    ):
        cells = (
            f"{pick([r[k] for r in rows if r[k] is not None] or [np.nan]):.{0 if k.endswith('_us') else 4}f}"
            for k in shown.values()
        )
        table.add_row(label, *cells)
    console.print(table)
