"""Rigid-body dynamics of a UR arm: mass matrix, Coriolis torques, rate of the Jacobian.

Links are point masses at their published centers of mass, with a rotor inertia per joint.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.drivers.ur.wire.kinematics import forward, frames_of, jacobian
from armcell.drivers.ur.wire.models import UrModel
from armcell.drivers.ur.wire.primary import Kinematics

Array = NDArray[np.float64]

ROTOR = 0.1  # [kg m^2] approximate inertia of motor and gear, at the gear's output
STEP = 1e-6  # [s] step of the finite differences in time


class ArmDynamics:
    """Rigid-body dynamics of one UR arm with its payload.

    Args:
        payload: mass [kg] at the flange.
        cog: center of mass of the payload [m, flange frame].
    """

    def __init__(self, model: UrModel, dh: Kinematics, payload: float = 0.0, cog: ArrayLike = (0.0,) * 3):
        self._dh = dh
        self._masses = np.append(model.link_masses, payload)
        self._centers = np.vstack((model.link_centers, np.asarray(cog, dtype=float)))

    def _jacobians(self, q: Array) -> Array:
        """Return the Jacobians (7, 3, 6) of the link masses and the payload in the base frame,
        for the dynamics of a UR arm.
        """
        frames = frames_of(self._dh, q)
        axes, origins = frames[:6, :3, 2], frames[:6, :3, 3]
        links = np.vstack((frames[1:], frames[6:]))  # frame i moves with link i, the payload with link 6
        centers = np.einsum("nij,nj->ni", links[:, :3, :3], self._centers) + links[:, :3, 3]
        J: Array = np.asarray(
            np.cross(axes[None], centers[:, None] - origins[None]), dtype=float
        )  # (7, 6, 3)
        moved_by = np.tril(np.ones((6, 6)))
        return (J * np.vstack((moved_by, np.ones(6)))[:, :, None]).transpose(0, 2, 1)

    def mass_matrix(self, q: ArrayLike) -> Array:
        """Return the mass matrix (6, 6) [kg m^2] in the dynamics of a
        UR arm at joint positions q (6,) [rad].
        """
        J = self._jacobians(np.asarray(q, dtype=float))
        return np.einsum("n,nki,nkj->ij", self._masses, J, J) + ROTOR * np.eye(6)

    def velocity_torques(self, q: ArrayLike, v: ArrayLike) -> Array:
        """Return the Coriolis and centrifugal torques (6,) [Nm] in the dynamics of a UR arm.

        The sum of m J^T (dJ/dt) v over the point masses, at positions q (6,) [rad] and speeds v (6,) [rad/s].
        """
        q, v = np.asarray(q, dtype=float), np.asarray(v, dtype=float)
        J = self._jacobians(q)
        rate = (self._jacobians(q + v * STEP) - J) / STEP
        return np.einsum("n,nki,nk->i", self._masses, J, rate @ v)


def tool_jacobian(dh: Kinematics, q: ArrayLike, tcp: ArrayLike) -> Array:
    """Return the geometric Jacobian (6, 6) of the TCP in the base frame, for the dynamics of a UR arm."""
    return jacobian(dh, q, forward(dh, q, tcp)[:3, 3])


def jacobian_rate(dh: Kinematics, q: ArrayLike, v: ArrayLike, tcp: ArrayLike) -> Array:
    """Return the rate of change (6, 6) of the TCP Jacobian for the
    dynamics of a UR arm at joint speeds v (6,) [rad/s].
    """
    q, v = np.asarray(q, dtype=float), np.asarray(v, dtype=float)
    return (tool_jacobian(dh, q + v * STEP, tcp) - tool_jacobian(dh, q - v * STEP, tcp)) / (2.0 * STEP)
