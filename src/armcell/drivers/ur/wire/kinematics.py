"""Forward and inverse kinematics of a UR arm from DH parameters, in the controller's base."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.core import SE3, SO3
from armcell.drivers.ur.wire.primary import Kinematics

Array = NDArray[np.float64]


def frames_of(dh: Kinematics, q: ArrayLike) -> Array:
    """Return T_base_i (7, 4, 4) of the base and the six DH frames."""
    T, all_frames = np.eye(4), [np.eye(4)]
    for theta, a, d, alpha, position in zip(dh.theta, dh.a, dh.d, dh.alpha, np.asarray(q), strict=True):
        c, s, ca, sa = np.cos(theta + position), np.sin(theta + position), np.cos(alpha), np.sin(alpha)
        T = T @ np.array(
            [[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1.0]]
        )
        all_frames.append(T)
    return np.array(all_frames)


def jacobian(dh: Kinematics, q: ArrayLike, tip: ArrayLike | None = None) -> Array:
    """Return the geometric Jacobian (6, 6) of the flange or of a point fixed to it, base frame.

    Args:
        tip: the point (3,) [m, base frame]; None: the flange's origin.
    """
    frames = frames_of(dh, q)
    point = frames[6, :3, 3] if tip is None else np.asarray(tip)
    axes = frames[:6, :3, 2]
    return np.vstack((np.cross(axes, point - frames[:6, :3, 3]).T, axes.T))


def pose_of(T: Array) -> list[float]:
    """Return a transform (4, 4) as a UR pose: x, y, z [m] and rotation vector [rad]."""
    return [*T[:3, 3], *SE3.from_matrix(T).rotation.log()]


def matrix_of(pose: ArrayLike) -> Array:
    """Return the transform (4, 4) of a UR pose (x, y, z [m], rotation vector [rad])."""
    values = np.asarray(pose, dtype=float)
    return SE3(SO3.exp(values[3:6]), values[:3]).matrix


def forward(dh: Kinematics, q: ArrayLike, tcp: ArrayLike) -> Array:
    """Return T_base_tcp (4, 4) for a TCP given as a UR pose in the flange frame."""
    return frames_of(dh, q)[6] @ matrix_of(tcp)


def inverse(dh: Kinematics, T_base_tcp: Array, q_near: ArrayLike, tcp: ArrayLike,
            iterations: int = 50, tolerance: float = 1e-7) -> Array | None:  # fmt: skip
    """Return joint positions (6,) [rad] that reach a TCP pose, by damped Newton steps.

    Args:
        T_base_tcp: target (4, 4).
        q_near: start of the iteration (6,) [rad]; the solution is usually near it.
        tcp: UR pose of the TCP in the flange frame.
        tolerance: largest pose error [m, rad].
    Returns:
        Joint positions (6,), or None if the iteration does not converge.
    """
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
