"""Joint controllers of the emulated Franka arm: joint and Cartesian impedance, and stops."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from armcell.emulators.franka.kinematics import JOINTS, rotation_log
from armcell.emulators.franka.motion_generators import EndEffectorKinematics, Reference
from armcell.emulators.franka.plant import PERIOD, FrankaPlant

Array = NDArray[np.float64]

JOINT_STIFFNESS = (3000.0, 3000.0, 3000.0, 2500.0, 2500.0, 2000.0, 2000.0)  # [Nm/rad] Franka's default
CARTESIAN_STIFFNESS = (3000.0, 3000.0, 3000.0, 300.0, 300.0, 300.0)  # [N/m], [Nm/rad] Franka's default
CARTESIAN_DAMPING = (160.0, 160.0, 160.0, 9.0, 9.0, 9.0)  # [N s/m], [Nm s/rad] at the default stiffness
NULLSPACE_STIFFNESS = 50.0  # [Nm/rad] of the elbow under Cartesian impedance
DAMPING_RATIO = 1.0


@dataclass
class Impedance:
    """Stiffness and damping for the impedance control of the emulated Franka arm."""

    joint: Array = field(default_factory=lambda: np.array(JOINT_STIFFNESS))
    cartesian: Array = field(default_factory=lambda: np.array(CARTESIAN_STIFFNESS))
    damping: Array = field(default_factory=lambda: np.full(JOINTS, 50.0))

    def set_stiffness(self, joint: bool, stiffness: Array) -> bool:
        """Set the stiffness for the joint (7,) or Cartesian (6,) impedance control of the emulated Franka
        arm. Return False and change nothing if Franka does not allow the values.
        """
        top = np.full(JOINTS, 14250.0) if joint else np.array([3000.0] * 3 + [300.0] * 3)
        low = np.zeros(JOINTS) if joint else np.array([10.0] * 3 + [1.0] * 3)
        if np.any(stiffness < low) or np.any(stiffness > top):
            return False
        if joint:
            self.joint = stiffness
        else:
            self.cartesian = stiffness
        return True

    def fit(self, inertia: Array) -> None:
        """Set the damping for the joint impedance control of the emulated Franka arm so that it suits an
        inertia (7,) [kg m^2].
        """
        self.damping = 2.0 * DAMPING_RATIO * np.sqrt(self.joint * inertia)


def joint_impedance(plant: FrankaPlant, reference: Reference, impedance: Impedance) -> Array:
    """Return the torques (7,) [Nm] with which joint impedance control
    pulls the emulated Franka arm toward the reference.
    """
    q, dq = plant.read()
    spring = impedance.joint * (reference.q - q) + impedance.damping * (reference.dq - dq)
    return spring + plant.inertial_torque(reference.ddq) + plant.coriolis()


def cartesian_impedance(
    plant: FrankaPlant, frames: EndEffectorKinematics, reference: Reference, impedance: Impedance
) -> Array:
    """Return the torques (7,) [Nm] with which Cartesian impedance control
    pulls the emulated Franka arm toward the reference.
    """
    q, dq = plant.read()
    wanted = frames.pose(reference.q)
    T, J = frames.pose_and_jacobian(q)
    off = np.concatenate([wanted[:3, 3] - T[:3, 3], rotation_log(wanted[:3, :3] @ T[:3, :3].T)])
    slip = J @ (reference.dq - dq)
    damping = np.array(CARTESIAN_DAMPING) * np.sqrt(impedance.cartesian / np.array(CARTESIAN_STIFFNESS))
    wrench = impedance.cartesian * off + damping * slip
    elbow = NULLSPACE_STIFFNESS * (reference.q - q) + 10.0 * (reference.dq - dq)
    elbow = elbow - J.T @ np.linalg.solve(J @ J.T + 1e-9 * np.eye(6), J @ elbow)
    return J.T @ wrench + elbow + plant.inertial_torque(reference.ddq) + plant.coriolis()


class Brake:
    """Braking motion under impedance control of the emulated Franka arm. It brings the arm's joint reference
    to rest.

    All joints stop at the same time.
    """

    def __init__(self, reference: Reference, deceleration: Array):
        self._reference = reference
        self._dq = reference.dq.copy()
        duration = float((np.abs(self._dq) / deceleration).max())
        self._left, self._duration = duration, duration

    def step(self) -> bool:
        """Advance the braking of the impedance-controlled emulated Franka arm by 1 ms, and return whether the
        arm's reference is at rest.
        """
        r = self._reference
        self._left = max(self._left - PERIOD, 0.0)
        if self._left == 0.0 or self._duration == 0.0:
            r.rest(r.q)
            return True
        r.dq = self._dq * (self._left / self._duration)
        r.ddq = -self._dq / self._duration
        r.q = r.q + r.dq * PERIOD
        return False
