"""Forward and inverse kinematics of a UR arm from DH parameters, in the controller's base."""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.core import SE3, SO3
from armcell.drivers.ur.wire.primary import Kinematics

Array = NDArray[np.float64]


def frames_of(dh: Kinematics, q: ArrayLike) -> Array:
    """Return T_base_i (7, 4, 4) of the base and the six DH frames in the kinematics of a UR arm.
    The array is read-only.
    """
    return _frames_of(dh, np.asarray(q, dtype=float).tobytes())


# A controller computes about ten outputs from the same positions in each control step.
@lru_cache(maxsize=64)
def _frames_of(dh: Kinematics, q: bytes) -> Array:
    angle = np.frombuffer(q) + dh.theta
    c, s, ca, sa = np.cos(angle), np.sin(angle), np.cos(dh.alpha), np.sin(dh.alpha)
    steps = np.zeros((6, 4, 4))
    steps[:, 0] = np.stack((c, -s * ca, s * sa, dh.a * c), axis=1)
    steps[:, 1] = np.stack((s, c * ca, -c * sa, dh.a * s), axis=1)
    steps[:, 2, 1:] = np.stack((sa, ca, dh.d), axis=1)
    steps[:, 3, 3] = 1.0
    frames = np.empty((7, 4, 4))
    frames[0] = np.eye(4)
    for i in range(6):
        np.matmul(frames[i], steps[i], out=frames[i + 1])
    frames.flags.writeable = False
    return frames


def jacobian(dh: Kinematics, q: ArrayLike, tip: ArrayLike | None = None) -> Array:
    """Return the Jacobian (6, 6) in the kinematics of a UR arm, for the flange or for a point fixed to it.

    The base frame is the reference.

    Args:
        tip: the point (3,) [m, base frame]; None: the flange's origin.
    """
    frames = frames_of(dh, q)
    point = frames[6, :3, 3] if tip is None else np.asarray(tip)
    J = np.empty((6, 6))
    J[3:] = frames[:6, :3, 2].T
    ax, ay, az = J[3:]
    x, y, z = point[:, None] - frames[:6, :3, 3].T
    J[0], J[1], J[2] = ay * z - az * y, az * x - ax * z, ax * y - ay * x
    return J


def cross(a: Iterable[float], b: Iterable[float]) -> Array:
    """Return the cross product of two vectors (3,) for the kinematics of UR arms,
    ten times faster than `numpy.cross`.
    """
    (ax, ay, az), (bx, by, bz) = a, b
    return np.array((ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx))


def pose_of(T: Array) -> list[float]:
    """Convert a transform (4, 4) in the kinematics of a UR arm to a UR pose:
    x, y, z [m] and rotation vector [rad].
    """
    return [*T[:3, 3].tolist(), *SO3(T[:3, :3]).log().tolist()]


def matrix_of(pose: ArrayLike) -> Array:
    """Convert a UR pose (x, y, z [m], rotation vector [rad]) to a transform (4, 4),
    for the kinematics of a UR arm.
    """
    return _matrix_of(np.asarray(pose, dtype=float).tobytes()).copy()


@lru_cache(maxsize=64)
def _matrix_of(pose: bytes) -> Array:
    values = np.frombuffer(pose)
    return SE3(SO3.exp(values[3:6]), values[:3]).matrix


def forward(dh: Kinematics, q: ArrayLike, tcp: ArrayLike) -> Array:
    """Return T_base_tcp (4, 4) by the forward kinematics of a UR arm,
    with the TCP given in the flange frame.
    """
    return _forward(dh, np.asarray(q, dtype=float).tobytes(), np.asarray(tcp, dtype=float).tobytes()).copy()


@lru_cache(maxsize=64)
def _forward(dh: Kinematics, q: bytes, tcp: bytes) -> Array:
    return _frames_of(dh, q)[6] @ _matrix_of(tcp)


def inverse(dh: Kinematics, T_base_tcp: Array, q_near: ArrayLike, tcp: ArrayLike,
            iterations: int = 50, tolerance: float = 1e-7) -> Array | None:  # fmt: skip
    """Solve the inverse kinematics of a UR arm by damped Newton steps,
    and return the joint positions (6,) [rad].

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
