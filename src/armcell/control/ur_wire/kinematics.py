"""Forward and inverse kinematics of a UR arm from its DH parameters, in the controller's base frame."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.control.ur_wire.primary import Kinematics
from armcell.core import SE3, SO3

Array = NDArray[np.float64]


def frames_of(dh: Kinematics, q: ArrayLike) -> Array:
    """T_base_i (7, 4, 4) of the base and the six DH frames."""
    T, all_frames = np.eye(4), [np.eye(4)]
    for theta, a, d, alpha, position in zip(dh.theta, dh.a, dh.d, dh.alpha, np.asarray(q), strict=True):
        c, s, ca, sa = np.cos(theta + position), np.sin(theta + position), np.cos(alpha), np.sin(alpha)
        T = T @ np.array(
            [[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1.0]]
        )
        all_frames.append(T)
    return np.array(all_frames)


def jacobian(dh: Kinematics, q: ArrayLike, tip: ArrayLike | None = None) -> Array:
    """Geometric Jacobian (6, 6) of the flange, or of a point fixed to it [m, base frame]."""
    frames = frames_of(dh, q)
    point = frames[6, :3, 3] if tip is None else np.asarray(tip)
    axes = frames[:6, :3, 2]
    return np.vstack((np.cross(axes, point - frames[:6, :3, 3]).T, axes.T))


def pose_of(T: Array) -> list[float]:
    """UR's pose: x, y, z [m] and rotation vector [rad]."""
    return [*T[:3, 3], *SE3.from_matrix(T).rotation.log()]


def matrix_of(pose: ArrayLike) -> Array:
    """The matrix (4, 4) of a UR pose."""
    values = np.asarray(pose, dtype=float)
    return SE3(SO3.exp(values[3:6]), values[:3]).matrix


def forward(dh: Kinematics, q: ArrayLike, tcp: ArrayLike) -> Array:
    """T_base_tcp (4, 4) with the tool's pose on the flange."""
    return frames_of(dh, q)[6] @ matrix_of(tcp)


def inverse(dh: Kinematics, T_base_tcp: Array, q_near: ArrayLike, tcp: ArrayLike,
            iterations: int = 50, tolerance: float = 1e-7) -> Array | None:  # fmt: skip
    """Joint positions (6,) near others, by damped Newton steps; None if it does not get there."""
    T_flange = T_base_tcp @ np.linalg.inv(matrix_of(tcp))
    q = np.array(q_near, dtype=float)
    for _ in range(iterations):
        T = frames_of(dh, q)[6]
        error = np.concatenate(
            (
                T_flange[:3, 3] - T[:3, 3],
                SE3.from_matrix(_rotation(T_flange[:3, :3] @ T[:3, :3].T)).rotation.log(),
            )
        )
        if np.abs(error).max() < tolerance:
            return q
        J = jacobian(dh, q)
        step = np.linalg.solve(J.T @ J + 1e-8 * np.eye(6), J.T @ error)
        q += np.clip(step, -0.3, 0.3)
    return None


def _rotation(R: Array) -> Array:
    T = np.eye(4)
    T[:3, :3] = R
    return T
