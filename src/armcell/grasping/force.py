"""How hard to grip: from mass, friction, the material's softness and where the weight hangs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from armcell.model import Gripper
from armcell.scene import CollisionObject

Array = NDArray[np.float64]

SAFETY = 3.0
MIN_FORCE = 5.0  # [N] per finger
LIFT_ACCELERATION = 3.0  # [m/s^2] the held object must stand besides gravity


def holding_factor(friction: float, torsional_friction: float, lever: Array, patch: Array) -> Array:
    """How many times the force of `needed_force` it takes where the weight hangs beside the contacts.

    A soft finger pressed by F holds a force f along the surface and a torque t about its normal while
    (f / (mu F))^2 + (t / (g F))^2 <= 1 (Howe and Cutkosky 1996), with g = mu r + the torsional coefficient
    [m] for a patch of radius r.

    Args:
        lever: [m] of the weight about the line through the contacts.
        patch: [m] radius of the smaller patch.
    """
    g = friction * patch + max(torsional_friction, 1e-4)
    return np.sqrt(1 + (friction * lever / g) ** 2)


def pair_friction(item: CollisionObject, support: CollisionObject) -> float:
    """Sliding coefficient between an object and what it is put on, as in our physics.

    MuJoCo takes the material of the geom with the higher priority, and the larger coefficient of two with the
    same ("Contact parameters" in its XML reference). What can move has the higher one.
    """
    mu = item.material.friction
    return max(mu, support.material.friction) if support.movable else mu


def needed_force(item: CollisionObject) -> float:
    """Force per finger [N] that just holds the object at its centre: m (g + a) / (2 mu) by Coulomb."""
    return item.mass_kg * (9.81 + LIFT_ACCELERATION) / (2 * max(item.material.friction, 0.05))


def firm_force(needed: float, gripper: Gripper) -> float:
    """Force per finger [N] to grip with: what is needed with a safety factor, if the gripper has it."""
    return float(np.clip(needed * SAFETY, MIN_FORCE, gripper.max_force))


def grip_force(item: CollisionObject, gripper: Gripper) -> float:
    """Force per finger [N] to grip an object with at its middle."""
    return firm_force(needed_force(item), gripper)
