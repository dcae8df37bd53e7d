"""Computation of the grip force from mass, friction, softness and position of the weight."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from armcell.model import Gripper
from armcell.scene import CollisionObject

Array = NDArray[np.float64]

SAFETY = 3.0
MIN_FORCE = 5.0  # [N] per finger
LIFT_ACCELERATION = 3.0  # [m/s^2] assumed acceleration of the held object, in addition to gravity


def holding_factor(friction: float, torsional_friction: float, lever: Array, patch: Array) -> Array:
    """Return the factor by which the grip force must grow because the weight does not act on the line through
    the contacts.

    A soft finger pressed with F holds a force f along the surface and a torque t about its normal while
    (f / (mu F))^2 + (t / (g F))^2 <= 1 (Howe and Cutkosky 1996), with g = mu r + the torsional coefficient
    [m] for a patch of radius r.

    Args:
        lever: [m] lever arm of the weight about the line through the contacts.
        patch: [m] radius of the smaller patch.
    """
    g = friction * patch + max(torsional_friction, 1e-4)
    return np.sqrt(1 + (friction * lever / g) ** 2)


def pair_friction(item: CollisionObject, support: CollisionObject) -> float:
    """Return the friction coefficient between an object and its support
    as MuJoCo combines it, to compute a grip force.

    MuJoCo takes the material of the geom with the higher priority, and the larger coefficient if priorities
    are equal ("Contact parameters" in its XML reference). Movable objects have the higher priority.
    """
    mu = item.material.friction
    return max(mu, support.material.friction) if support.movable else mu


def needed_force(item: CollisionObject) -> float:
    """Return the minimum grip force per finger [N] that holds an object gripped at its center of mass.

    Coulomb friction: m (g + a) / (2 mu).
    """
    return item.mass_kg * (9.81 + LIFT_ACCELERATION) / (2 * max(item.material.friction, 0.05))


def firm_force(needed: float, gripper: Gripper) -> float:
    """Return a grip force per finger [N] that includes a safety factor and does not exceed the gripper's
    maximum.
    """
    return float(np.clip(needed * SAFETY, MIN_FORCE, gripper.max_force))


def grip_force(item: CollisionObject, gripper: Gripper) -> float:
    """Return the grip force per finger [N] for an object that is gripped at its center."""
    return firm_force(needed_force(item), gripper)
