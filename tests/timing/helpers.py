"""Random paths and toppra's answer on the very same curve."""

from __future__ import annotations

import itertools

import numpy as np
import toppra
import toppra.algorithm
import toppra.constraint
from toppra.interpolator import AbstractGeometricPath

from armcell.core import JointTrajectory
from armcell.timing import BlendedPath

toppra.setup_logging("ERROR")
NAMES = tuple(f"j{i}" for i in range(7))
PANDA_V = np.array([2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61])
PANDA_A = np.array([15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0])


def random_waypoints(seed: int, joints: int = 7) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.uniform(-1.5, 1.5, (int(rng.integers(2, 9)), joints))


class Curve(AbstractGeometricPath):
    """A BlendedPath as toppra sees paths."""

    def __init__(self, path: BlendedPath):
        self.path = path

    dof = property(lambda self: self.path.points.shape[1])
    path_interval = property(lambda self: np.array([0.0, self.path.length]))
    waypoints = property(lambda self: (np.array([0.0, self.path.length]), None))

    def __call__(self, s, order=0):
        value = self.path.at(s)[order]
        return value if np.ndim(s) else value[0]


def toppra_duration(
    path: BlendedPath, v: np.ndarray, a: np.ndarray, points: int = 1500, torque=None, torque_limit=None
) -> float:
    """Duration of the fastest motion by toppra [s], grid points where the curvature jumps included.

    torque(q, dq, ddq) -> (n,) and torque_limit (n,) add a torque constraint.
    """
    grid = np.unique(np.r_[np.linspace(0, path.length, points), path.starts])
    grid = np.r_[0.0, grid[1:-1][np.diff(grid)[:-1] > 1e-9], path.length]
    scheme = toppra.constraint.DiscretizationType.Interpolation
    limits = [
        toppra.constraint.JointVelocityConstraint(np.c_[-v, v]),
        toppra.constraint.JointAccelerationConstraint(np.c_[-a, a], discretization_scheme=scheme),
    ]
    if torque is not None:
        bounds = np.c_[-torque_limit, torque_limit]
        limits.append(
            toppra.constraint.JointTorqueConstraint(
                torque, bounds, np.zeros(len(v)), discretization_scheme=scheme
            )
        )
    solver = toppra.algorithm.TOPPRA(limits, Curve(path), gridpoints=grid, solver_wrapper="seidel")
    _, speed, _ = solver.compute_parameterization(0.0, 0.0)
    return float(np.sum(2 * np.diff(grid) / (speed[1:] + speed[:-1])))


def random_walk(seed: int, count: int = 20, step: float = 0.15, joints: int = 7) -> np.ndarray:
    return np.cumsum(np.random.default_rng(seed).normal(0.0, step, (count, joints)), axis=0)


def sampled(trajectory: JointTrajectory, step: float = 1e-3):
    """Positions, velocities and accelerations (k, n) every `step` [s]."""
    times = np.append(np.arange(0.0, trajectory.duration, step), trajectory.duration)
    return [np.array(x) for x in zip(*(trajectory.sample(t) for t in times), strict=True)]


def distance_to_polyline(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Euclidean distance of each point (m, n) to the polyline through corners (k, n)."""
    best = np.full(len(points), np.inf)
    for a, b in itertools.pairwise(corners):
        t = np.clip((points - a) @ (b - a) / max(float((b - a) @ (b - a)), 1e-18), 0.0, 1.0)
        best = np.minimum(best, np.linalg.norm(points - a - t[:, None] * (b - a), axis=1))
    return best
