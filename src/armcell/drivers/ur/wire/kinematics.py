"""Kinematics and rigid-body dynamics of a UR arm: forward, inverse, Jacobian, mass matrix, Coriolis.

Kinematics use DH parameters and the controller's base.

Links are point masses at their published centers of mass, with a rotor inertia per joint.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from armcell.core import SE3, SO3
from armcell.drivers.ur.wire.models import UrModel
from armcell.drivers.ur.wire.primary import Kinematics

F64 = NDArray[np.float64]
ROTOR = 0.1  # [kg m^2] approximate inertia of motor and gear, at the gear's output
STEP = 1e-6  # [s] step of the finite differences in time


def frames_of(dh: Kinematics, q: ArrayLike) -> F64:
    """Return T_base_i (7, 4, 4) of the base and the six DH frames in the kinematics of a UR arm.
    The array is read-only.
    """
    return _frames_of(dh, np.asarray(q, dtype=float).tobytes())


# A controller computes about ten outputs from the same positions in each control step.
@lru_cache(maxsize=64)
def _frames_of(dh: Kinematics, q: bytes) -> F64:
    frames = np.empty((7, 4, 4))
    _chain(np.frombuffer(q) + dh.theta, np.array((dh.a, dh.d, dh.alpha)), frames)
    frames.flags.writeable = False
    return frames


@njit("void(f8[::1], f8[:,::1], f8[:,:,::1])", cache=True)
def _chain(angles, dh, frames):
    """Compute the DH kinematics of a UR arm: write the frames T_base_i (7, 4, 4) to `frames`. `dh` (3, 6) are
    a, d and alpha.
    """
    frames[:] = np.eye(4)
    step = np.eye(4)
    for i in range(6):
        angle, a, alpha = angles[i], dh[0, i], dh[2, i]
        c, s, ca, sa = np.cos(angle), np.sin(angle), np.cos(alpha), np.sin(alpha)
        step[0, 0], step[0, 1], step[0, 2], step[0, 3] = c, -s * ca, s * sa, a * c
        step[1, 0], step[1, 1], step[1, 2], step[1, 3] = s, c * ca, -c * sa, a * s
        step[2, 1], step[2, 2], step[2, 3] = sa, ca, dh[1, i]
        for r in range(3):
            for k in range(4):
                total = 0.0
                for m in range(4):
                    total += frames[i, r, m] * step[m, k]
                frames[i + 1, r, k] = total


def jacobian(dh: Kinematics, q: ArrayLike, tip: ArrayLike | None = None) -> F64:
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


def cross(a: Iterable[float], b: Iterable[float]) -> F64:
    """Return the cross product of two vectors (3,) for the kinematics of UR arms,
    ten times faster than `numpy.cross`.
    """
    (ax, ay, az), (bx, by, bz) = a, b
    return np.array((ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx))


def pose_of(T: F64) -> list[float]:
    """Convert a transform (4, 4) in the kinematics of a UR arm to a UR pose:
    x, y, z [m] and rotation vector [rad].
    """
    return [*T[:3, 3].tolist(), *SO3(T[:3, :3]).log().tolist()]


def matrix_of(pose: ArrayLike) -> F64:
    """Convert a UR pose (x, y, z [m], rotation vector [rad]) to a transform (4, 4),
    for the kinematics of a UR arm.
    """
    return _matrix_of(np.asarray(pose, dtype=float).tobytes()).copy()


@lru_cache(maxsize=64)
def _matrix_of(pose: bytes) -> F64:
    values = np.frombuffer(pose)
    return SE3(SO3.exp(values[3:6]), values[:3]).matrix


def forward(dh: Kinematics, q: ArrayLike, tcp: ArrayLike) -> F64:
    """Return T_base_tcp (4, 4) by the forward kinematics of a UR arm,
    with the TCP given in the flange frame.
    """
    return _forward(dh, np.asarray(q, dtype=float).tobytes(), np.asarray(tcp, dtype=float).tobytes()).copy()


@lru_cache(maxsize=64)
def _forward(dh: Kinematics, q: bytes, tcp: bytes) -> F64:
    return _frames_of(dh, q)[6] @ _matrix_of(tcp)


def inverse(dh: Kinematics, T_base_tcp: F64, q_near: ArrayLike, tcp: ArrayLike,
            iterations: int = 50, tolerance: float = 1e-7) -> F64 | None:  # fmt: skip
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


def _rotation(R: F64) -> F64:
    T = np.eye(4)
    T[:3, :3] = R
    return T


class ArmDynamics:
    """Rigid-body dynamics of one UR arm with its payload, computed from the arm's DH kinematics.

    Args:
        payload: mass [kg] at the flange.
        cog: center of mass of the payload [m, flange frame].
    """

    def __init__(self, model: UrModel, dh: Kinematics, payload: float = 0.0, cog: ArrayLike = (0.0,) * 3):
        self._dh = dh
        self._masses = np.append(model.link_masses, payload)
        self._centers = np.vstack((model.link_centers, np.asarray(cog, dtype=float)))

    def _jacobians(self, q: F64) -> F64:
        """Return the Jacobians (7, 3, 6) of the link masses and the payload in the base frame, from the DH
        kinematics of a UR arm.
        """
        frames = frames_of(self._dh, q)
        axes, origins = frames[:6, :3, 2], frames[:6, :3, 3]
        links = np.vstack((frames[1:], frames[6:]))  # frame i moves with link i, the payload with link 6
        centers = np.einsum("nij,nj->ni", links[:, :3, :3], self._centers) + links[:, :3, 3]
        J: F64 = np.asarray(np.cross(axes[None], centers[:, None] - origins[None]), dtype=float)  # (7, 6, 3)
        moved_by = np.tril(np.ones((6, 6)))
        return (J * np.vstack((moved_by, np.ones(6)))[:, :, None]).transpose(0, 2, 1)

    def mass_matrix(self, q: ArrayLike) -> F64:
        """Return the mass matrix (6, 6) [kg m^2] of a UR arm at joint positions q (6,) [rad], from the arm's
        DH kinematics and link masses.
        """
        J = self._jacobians(np.asarray(q, dtype=float))
        return np.einsum("n,nki,nkj->ij", self._masses, J, J) + ROTOR * np.eye(6)

    def velocity_torques(self, q: ArrayLike, v: ArrayLike) -> F64:
        """Return the Coriolis and centrifugal torques (6,) [Nm] of a UR arm, from the arm's DH kinematics and
        link masses.

        The sum of m J^T (dJ/dt) v over the point masses, at positions q (6,) [rad] and speeds v (6,) [rad/s].
        """
        q, v = np.asarray(q, dtype=float), np.asarray(v, dtype=float)
        J = self._jacobians(q)
        rate = (self._jacobians(q + v * STEP) - J) / STEP
        return np.einsum("n,nki,nk->i", self._masses, J, rate @ v)


def tool_jacobian(dh: Kinematics, q: ArrayLike, tcp: ArrayLike) -> F64:
    """Return the geometric Jacobian (6, 6) of the TCP in the base frame, from the DH kinematics of a UR
    arm.
    """
    return jacobian(dh, q, forward(dh, q, tcp)[:3, 3])


def jacobian_rate(dh: Kinematics, q: ArrayLike, v: ArrayLike, tcp: ArrayLike) -> F64:
    """Return the rate of change (6, 6) of the TCP Jacobian at joint speeds v (6,) [rad/s], from the DH
    kinematics of a UR arm.
    """
    q, v = np.asarray(q, dtype=float), np.asarray(v, dtype=float)
    return (tool_jacobian(dh, q + v * STEP, tcp) - tool_jacobian(dh, q - v * STEP, tcp)) / (2.0 * STEP)
